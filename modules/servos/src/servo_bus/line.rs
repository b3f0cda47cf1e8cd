//! The bus as devices are spoken to: one instruction, and what became of it.

use super::bus::{Bus, Exchange, ExpectedStatus, Outcome};
use super::joint::Joint;
use super::protocol::{Id, Instruction, Protocol, Receiver, Status, StatusError, echo_end};

/// The bus during one step, and the exchanges of the step.
pub(crate) struct Line<'a> {
    pub(crate) bus: &'a mut dyn Bus,
    pub(crate) protocol: Protocol,
    pub(crate) exchanges: &'a mut Vec<Exchange>,
}

/// Why a device did not execute an instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Trouble {
    /// The port does not work.
    PortFailed,
    /// No answer, or a corrupt one.
    Silent,
    /// It answered with an error.
    Refused(StatusError),
    /// The adapter sent the instruction back.
    Echo,
}

/// What an adapter that echoes does, and the remedy.
pub(crate) const ECHO: &str = "the adapter echoes what is sent, so instructions come back as if they were answers; switch its echo off, \
     or take an adapter that does not receive while it sends";

impl Line<'_> {
    /// Opens the port. Returns true if it works.
    pub(crate) fn open(&mut self, port: &str) -> bool {
        let exchange = self.bus.open(port);
        let is_open = exchange.outcome == Outcome::Ok;
        self.exchanges.push(exchange);
        is_open
    }

    /// Closes the port.
    pub(crate) fn close(&mut self) {
        let exchange = self.bus.close();
        self.exchanges.push(exchange);
    }

    /// Sends an instruction and records the exchange. An instruction that the protocol cannot express is not
    /// sent, and gets no answer.
    pub(crate) fn exchange(
        &mut self,
        instruction: &Instruction,
        expected: &[ExpectedStatus],
    ) -> Result<&Exchange, Trouble> {
        let bytes = instruction.to_bytes(self.protocol).map_err(|error| {
            tracing::error!("{error}");
            Trouble::Silent
        })?;
        let exchange = self.bus.exchange(&bytes, expected);
        self.exchanges.push(exchange);
        let exchange = &self.exchanges[self.exchanges.len() - 1];
        if exchange.outcome == Outcome::Failed { Err(Trouble::PortFailed) } else { Ok(exchange) }
    }

    /// Reads part of a device's control table.
    pub(crate) fn read(&mut self, id: Id, address: u16, length: u16) -> Result<Vec<u8>, Trouble> {
        self.ask(&Instruction::Read { id, address, length }, length)
    }

    /// Reads the present position of a servo. The errors beside it are those that do not refuse the read.
    pub(crate) fn read_position(&mut self, joint: &Joint) -> Result<(i64, StatusError), Trouble> {
        let (position, protocol) = (&joint.registers.position, self.protocol);
        let (id, address, length) = (joint.id, position.address, position.size);
        let status = self.status(&Instruction::Read { id, address, length }, length)?;
        let raw = position.raw_in(protocol, &status.parameters, address).ok_or(Trouble::Silent)?;
        Ok((raw, status.error))
    }

    /// Writes to a device's control table, and waits for the acknowledgement.
    pub(crate) fn write(&mut self, id: Id, address: u16, data: &[u8]) -> Result<(), Trouble> {
        self.ask(&Instruction::Write { id, address, data: data.to_vec() }, 0).map(|_| ())
    }

    /// Writes to the control table of a device that does not answer writes.
    pub(crate) fn write_unanswered(&mut self, id: Id, address: u16, data: &[u8]) -> Result<(), Trouble> {
        self.exchange(&Instruction::Write { id, address, data: data.to_vec() }, &[]).map(|_| ())
    }

    /// Sends an instruction to one device and returns the data of its answer.
    pub(crate) fn ask(&mut self, instruction: &Instruction, parameters: u16) -> Result<Vec<u8>, Trouble> {
        self.status(instruction, parameters).map(|status| status.parameters)
    }

    /// Sends an instruction to one device and returns its answer.
    fn status(&mut self, instruction: &Instruction, parameters: u16) -> Result<Status, Trouble> {
        let (id, protocol) = (instruction.id(), self.protocol);
        let exchange = self.exchange(instruction, &[ExpectedStatus { id, parameters }])?;
        if echo_end(protocol, &exchange.instruction, &exchange.reply).is_some() {
            return Err(Trouble::Echo);
        }
        let mut answer = None;
        for_each_status(protocol, &exchange.reply, |status| {
            if status.id == id {
                answer.get_or_insert(status);
            }
        });
        let status = answer.ok_or(Trouble::Silent)?;
        if status.error.intersects(StatusError::REFUSALS) {
            return Err(Trouble::Refused(status.error));
        }
        if status.parameters.len() == usize::from(parameters) { Ok(status) } else { Err(Trouble::Silent) }
    }
}

/// Visits all valid answers of single devices in these bytes.
pub(crate) fn for_each_status(protocol: Protocol, bytes: &[u8], mut visit: impl FnMut(Status)) {
    let mut receiver = Receiver::new(protocol);
    receiver.push(bytes);
    receiver.end();
    while let Some(packet) = receiver.next_packet() {
        if let Ok(status) = Status::parse(&packet) {
            visit(status);
        }
    }
}
