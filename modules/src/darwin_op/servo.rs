//! The state of one servo, and how it is brought into service.

use super::bus::{Bus, Exchange, ExpectedStatus, Outcome};
use super::driver::Counted;
use super::protocol::{Id, Instruction, StatusError};
use super::reading::{ServoReading, for_each_status};
use super::tables::mx28;
use downbeat_executor::Time;

/// How fast a servo that was just brought into service approaches its command, in ticks per cycle: about 2
/// rad/s.
const CATCH_UP_TICKS: u16 = 10;

/// Whether a servo is in service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Service {
    /// Not polled yet.
    Unknown,
    /// Read and driven in every cycle.
    Active,
    /// Does not answer. Polled again at `retry_at`.
    Silent { retry_at: Time },
    /// Answers, but cannot be used. Polled again at `retry_at`.
    Unsuitable { reason: String, retry_at: Time },
}

/// One servo.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Servo {
    pub(super) service: Service,
    /// Its last reading.
    pub(super) last: Option<ServoReading>,
    /// The number of consecutive missing answers.
    pub(super) misses: u32,
    /// How many times it stopped answering.
    pub(super) outages: Counted,
    /// The total number of missing answers.
    pub(super) missed: u64,
    /// The goal that is written to it.
    goal: u16,
    /// The commanded position, if any.
    wanted: Option<u16>,
    /// Whether it has reached its command since it came into service.
    has_caught_up: bool,
}

impl Servo {
    pub(super) fn new() -> Self {
        Self {
            service: Service::Unknown,
            last: None,
            misses: 0,
            outages: Counted::default(),
            missed: 0,
            goal: 0,
            wanted: None,
            has_caught_up: false,
        }
    }

    pub(super) fn is_active(&self) -> bool {
        self.service == Service::Active
    }

    /// Returns whether its reading is stale: it is not in service, or missed its last answers.
    pub(super) fn is_stale(&self) -> bool {
        !self.is_active() || self.misses >= 2
    }

    /// When to poll it again, if it is out of service.
    pub(super) fn retry_at(&self) -> Option<Time> {
        match self.service {
            Service::Unknown | Service::Active => None,
            Service::Silent { retry_at } | Service::Unsuitable { retry_at, .. } => Some(retry_at),
        }
    }

    /// Sets the commanded position.
    pub(super) fn want(&mut self, ticks: u16) {
        self.wanted = Some(ticks);
    }

    /// Brings it into service at this position, without a jump.
    pub(super) fn join(&mut self, position: u16) {
        self.service = Service::Active;
        self.misses = 0;
        self.goal = position;
        self.has_caught_up = false;
    }

    /// The goal of the next cycle.
    pub(super) fn next_goal(&mut self) -> u16 {
        if let Some(wanted) = self.wanted {
            let slowly = wanted.clamp(self.goal.saturating_sub(CATCH_UP_TICKS), self.goal + CATCH_UP_TICKS);
            self.goal = if self.has_caught_up { wanted } else { slowly };
            self.has_caught_up |= slowly == wanted;
        }
        self.goal
    }

    /// The errors that it reports.
    pub(super) fn alarms(&self) -> StatusError {
        self.last.map_or(StatusError::NONE, |last| last.error)
    }
}

/// Why a servo could not be taken into service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum PrepareError {
    Trouble(Trouble),
    Unsuitable(String),
}

impl From<Trouble> for PrepareError {
    fn from(trouble: Trouble) -> Self {
        match trouble {
            Trouble::Refused(error) => Self::Unsuitable(format!("it rejects its settings: {error}")),
            trouble => Self::Trouble(trouble),
        }
    }
}

/// Checks a servo and configures it for the cycle: no return delay, answers to all instructions, these gains,
/// no speed limit, torque enabled, and its present position as goal. Returns its position.
///
/// Persistent settings are written only if they differ, since that memory wears out.
pub(super) fn prepare(line: &mut Line<'_>, id: Id, gains: [u8; 3]) -> Result<u16, PrepareError> {
    let end = mx28::STATUS_RETURN_LEVEL.end();
    let settings = line.read(id, 0, end)?;
    let setting = |field: &super::tables::Field| field.value_in(&settings, 0).unwrap_or(0);
    let (model, firmware) = (setting(&mx28::MODEL_NUMBER), setting(&mx28::FIRMWARE_VERSION));
    if model != mx28::MODEL {
        return Err(PrepareError::Unsuitable(format!("it is model {model}, not an MX-28 ({})", mx28::MODEL)));
    }
    if firmware < mx28::OLDEST_FIRMWARE {
        let oldest = mx28::OLDEST_FIRMWARE;
        return Err(PrepareError::Unsuitable(format!(
            "its firmware is {firmware}; update it to {oldest} or later"
        )));
    }
    if setting(&mx28::STATUS_RETURN_LEVEL) != 2 {
        line.write_unanswered(id, mx28::STATUS_RETURN_LEVEL.address, &[2])?;
    }
    if setting(&mx28::RETURN_DELAY) != 0 {
        line.write(id, mx28::RETURN_DELAY.address, &[0])?;
    }
    let position = line.read(id, mx28::PRESENT_POSITION.address, mx28::PRESENT_POSITION.size)?;
    let position = mx28::PRESENT_POSITION.value_in(&position, mx28::PRESENT_POSITION.address).unwrap_or(0);
    let goal = position.min(mx28::GOAL_POSITION.max).to_le_bytes();
    let [d, i, p] = gains;
    // D, I, P, an unused byte, goal, no speed limit.
    line.write(id, mx28::D_GAIN.address, &[d, i, p, 0, goal[0], goal[1], 0, 0])?;
    line.write(id, mx28::TORQUE_ENABLE.address, &[1])?;
    Ok(u16::from_le_bytes(goal))
}

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
    fn write_unanswered(&mut self, id: Id, address: u8, data: &[u8]) -> Result<(), Trouble> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_servo_stays_at_its_position_until_it_is_commanded() {
        let mut servo = Servo::new();
        servo.join(2000);
        assert_eq!([servo.next_goal(), servo.next_goal()], [2000, 2000]);
    }

    #[test]
    fn a_servo_that_comes_back_approaches_its_command_slowly_and_then_follows_at_once() {
        let mut servo = Servo::new();
        servo.want(2025);
        servo.join(2000);
        let goals: Vec<u16> = (0..4).map(|_| servo.next_goal()).collect();
        assert_eq!(goals, [2010, 2020, 2025, 2025]);
        servo.want(1000);
        assert_eq!(servo.next_goal(), 1000);
    }
}
