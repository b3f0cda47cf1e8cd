//! Instructions to single devices, one after the other.

use super::bus::{Bus, Exchange, ExpectedStatus, Outcome};
use super::protocol::{Id, Instruction, StatusError};
use super::reading::for_each_status;

/// The bus during one step, and the exchanges of the step.
pub(super) struct Line<'a> {
    pub(super) bus: &'a mut dyn Bus,
    pub(super) exchanges: &'a mut Vec<Exchange>,
}

/// Why a device did not execute an instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Trouble {
    /// The port does not work.
    PortFailed,
    /// No answer, or a corrupt one.
    Silent,
    /// It answered with an error.
    Refused(StatusError),
}

/// Error bits that mean an instruction was not executed. The others concern the device's state.
const REFUSALS: [StatusError; 4] =
    [StatusError::ANGLE_LIMIT, StatusError::RANGE, StatusError::CHECKSUM, StatusError::INSTRUCTION];

impl Line<'_> {
    /// Opens the port. Returns true if it works.
    pub(super) fn open(&mut self, port: &str) -> bool {
        let exchange = self.bus.open(port);
        let is_open = exchange.outcome == Outcome::Ok;
        self.exchanges.push(exchange);
        is_open
    }

    /// Closes the port.
    pub(super) fn close(&mut self) {
        let exchange = self.bus.close();
        self.exchanges.push(exchange);
    }

    /// Sends an instruction and records the exchange.
    pub(super) fn exchange(&mut self, instruction: &[u8], expected: &[ExpectedStatus]) -> &Exchange {
        let exchange = self.bus.exchange(instruction, expected);
        self.exchanges.push(exchange);
        &self.exchanges[self.exchanges.len() - 1]
    }

    /// Reads part of a device's control table.
    pub(super) fn read(&mut self, id: Id, address: u8, length: u8) -> Result<Vec<u8>, Trouble> {
        self.ask(Instruction::Read { id, address, length }, length)
    }

    /// Writes to a device's control table, and waits for the acknowledgement.
    pub(super) fn write(&mut self, id: Id, address: u8, data: &[u8]) -> Result<(), Trouble> {
        self.ask(Instruction::Write { id, address, data }, 0).map(|_| ())
    }

    /// Writes to the control table of a device that does not answer writes.
    pub(super) fn write_unanswered(&mut self, id: Id, address: u8, data: &[u8]) -> Result<(), Trouble> {
        let instruction = Instruction::Write { id, address, data }.to_bytes();
        match self.exchange(&instruction, &[]).outcome {
            Outcome::Failed => Err(Trouble::PortFailed),
            Outcome::Ok | Outcome::Timeout => Ok(()),
        }
    }

    fn ask(&mut self, instruction: Instruction<'_>, parameters: u8) -> Result<Vec<u8>, Trouble> {
        let id = instruction.id();
        let exchange = self.exchange(&instruction.to_bytes(), &[ExpectedStatus { id, parameters }]);
        if exchange.outcome == Outcome::Failed {
            return Err(Trouble::PortFailed);
        }
        let mut answer = None;
        for_each_status(&exchange.reply, |status| {
            if status.id == id {
                answer.get_or_insert_with(|| (status.error, status.parameters.to_vec()));
            }
        });
        let Some((error, answered)) = answer else { return Err(Trouble::Silent) };
        if REFUSALS.iter().any(|refusal| error.contains(*refusal)) {
            return Err(Trouble::Refused(error));
        }
        if answered.len() == usize::from(parameters) { Ok(answered) } else { Err(Trouble::Silent) }
    }
}
