//! The cycle of the hardware: opens the port, brings the servos into service, then writes goals and reads all
//! devices.
//!
//! It does one step per call and only waits for answers. Its behaviour depends only on the given time, its
//! settings, the wanted joint positions, and the answers from the bus.

use super::bus::{Bus, Exchange, LATE, Outcome};
use super::protocol::{Id, Instruction, SyncWriteBlock};
use super::reading::{BoardReading, Reading, request, understand};
use super::servo::{Line, PrepareError, Service, Servo, Trouble, prepare};
use super::settings::Settings;
use super::tables::joints::{COUNT, JOINTS};
use super::tables::{cm730, mx28};
use downbeat_executor::Time;
use std::time::Duration;

/// The number of attempts to reach a servo before the cycle starts.
const ATTEMPTS_TO_PREPARE: u32 = 3;

/// The time from power on until servos answer.
const POWER_ON: Duration = Duration::from_millis(300);
/// The time between attempts to reach a servo out of service. Polling a silent one takes 5 ms, more than the
/// idle time of a cycle.
const RETRY_SERVO: Duration = Duration::from_secs(1);
/// At most one servo out of service is polled in this time, however many there are.
const RETRY_ANY: Duration = Duration::from_millis(250);
/// The time between attempts to reach a silent board.
const RETRY_BOARD: Duration = Duration::from_millis(500);
/// The first and the longest time between attempts to open a failed port.
const RETRY_PORT: [Duration; 2] = [Duration::from_millis(100), Duration::from_secs(2)];
/// The number of consecutive missing answers before a servo is taken out of service.
const MISSES_OF_A_SERVO: u32 = 2;
/// The same for corrupt answers: the connection is bad, but other servos are not affected.
const CORRUPT_OF_A_SERVO: u32 = 10;
/// The number of cycles without answers from the board before the port is reopened.
const MISSES_OF_THE_BOARD: u32 = 10;

/// The phase of the driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// The port is closed and will be opened at `retry_at`.
    Closed { retry_at: Time },
    /// The port is open, the servos have no power. The board will be instructed to switch them on at
    /// `retry_at`.
    Open { retry_at: Time },
    /// The servos have power and are starting up.
    PowerOn { until: Time },
    /// The servos are being brought into service; `next` is the next one.
    Preparing { next: usize },
    /// All servos that answer are in service.
    Running,
}

/// Counts of faults.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Troubles {
    /// Exchanges with a missing or corrupt answer.
    pub(super) timeouts: Counted,
    /// Answers that arrived after their time-out.
    pub(super) late: Counted,
    /// How often the port was lost.
    pub(super) lost_ports: Counted,
    /// How often it could not be opened.
    pub(super) refused_ports: Counted,
    /// How often the board did not answer.
    pub(super) silent_board: Counted,
}

/// The state of the cycle.
pub(super) struct Driver {
    pub(super) phase: Phase,
    pub(super) servos: [Servo; COUNT],
    pub(super) board: Option<BoardReading>,
    pub(super) troubles: Troubles,
    /// The number of exchanges.
    pub(super) exchanges: u64,
    /// When an answer was last missing or corrupt.
    pub(super) last_timeout_at: Option<Time>,
    /// When an answer was last late.
    pub(super) last_late_at: Option<Time>,
    board_misses: u32,
    port_wait: Duration,
    retry_any_at: Time,
    /// The gains of the servos in service.
    gains: [u8; 3],
}

impl Driver {
    pub(super) fn new() -> Self {
        Self {
            phase: Phase::Closed { retry_at: Time::ZERO },
            servos: std::array::from_fn(|_| Servo::new()),
            board: None,
            troubles: Troubles::default(),
            exchanges: 0,
            last_timeout_at: None,
            last_late_at: None,
            board_misses: 0,
            port_wait: RETRY_PORT[0],
            retry_any_at: Time::ZERO,
            gains: [0; 3],
        }
    }

    /// Does one step. Returns the reading if the robot is running.
    pub(super) fn step(
        &mut self,
        now: Time,
        settings: &Settings,
        bus: &mut dyn Bus,
        exchanges: &mut Vec<Exchange>,
    ) -> Option<Reading> {
        bus.begin_step(now);
        let before = exchanges.len();
        let mut line = Line { bus, exchanges };
        let done = match self.phase {
            Phase::Closed { retry_at } if now >= retry_at => {
                self.open(now, settings, &mut line).map(|()| None)
            }
            Phase::Open { retry_at } if now >= retry_at => self.power_on(now, &mut line).map(|()| None),
            Phase::PowerOn { until } if now >= until => {
                self.phase = Phase::Preparing { next: 0 };
                Ok(None)
            }
            Phase::Preparing { next } => self.prepare_next(next, now, settings, &mut line).map(|()| None),
            Phase::Running => self.cycle(now, settings, &mut line).map(Some),
            Phase::Closed { .. } | Phase::Open { .. } | Phase::PowerOn { .. } => Ok(None),
        };
        let reading = done.unwrap_or_else(|PortFailed| {
            self.lose_port(now, &mut line);
            None
        });
        self.count(now, &exchanges[before..]);
        reading
    }

    /// Closes the port. The servos hold their position: without torque the robot would collapse.
    ///
    /// The head light turns green, as in the manufacturer's framework.
    pub(super) fn stop(&mut self, now: Time, bus: &mut dyn Bus, exchanges: &mut Vec<Exchange>) {
        if matches!(self.phase, Phase::Closed { .. }) {
            return;
        }
        bus.begin_step(now);
        let mut line = Line { bus, exchanges };
        // Ignores whether the light changes.
        let _ = line.write(Id::CM730, cm730::LED_HEAD.address, &GREEN.to_le_bytes());
        line.close();
        self.phase = Phase::Closed { retry_at: Time::MAX };
    }

    fn open(&mut self, now: Time, settings: &Settings, line: &mut Line<'_>) -> Result<(), PortFailed> {
        if line.open(&settings.port) {
            return self.power_on(now, line);
        }
        if self.troubles.refused_ports.is_worth_a_line() {
            let count = self.troubles.refused_ports.count();
            let error = line.exchanges.last().map_or("", |exchange| &exchange.error);
            tracing::warn!("{error} (failed {count} times so far, retrying)");
        }
        self.wait_for_port(now);
        Ok(())
    }

    fn power_on(&mut self, now: Time, line: &mut Line<'_>) -> Result<(), PortFailed> {
        match line.write(Id::CM730, cm730::DXL_POWER.address, &[1]) {
            Ok(()) => self.phase = Phase::PowerOn { until: now + POWER_ON },
            Err(Trouble::PortFailed) => return Err(PortFailed),
            Err(Trouble::Silent | Trouble::Refused(_)) => {
                if self.troubles.silent_board.is_worth_a_line() {
                    let count = self.troubles.silent_board.count();
                    tracing::warn!(
                        "the CM-730 did not switch the servos on ({count} times so far); is it on?"
                    );
                }
                self.phase = Phase::Open { retry_at: now + RETRY_BOARD };
            }
        }
        Ok(())
    }

    fn prepare_next(
        &mut self,
        next: usize,
        now: Time,
        settings: &Settings,
        line: &mut Line<'_>,
    ) -> Result<(), PortFailed> {
        self.gains = settings.gains;
        self.prepare(next, now, line)?;
        self.phase = if next + 1 < COUNT { Phase::Preparing { next: next + 1 } } else { Phase::Running };
        Ok(())
    }

    fn prepare(&mut self, index: usize, now: Time, line: &mut Line<'_>) -> Result<(), PortFailed> {
        let (servo, joint) = (&mut self.servos[index], &JOINTS[index]);
        let was_out = servo.retry_at().is_some();
        let mut prepared = prepare(line, joint.id, self.gains);
        if matches!(self.phase, Phase::Preparing { .. }) {
            // No cycle is waiting yet, and a servo left out now joins a second later.
            for _ in 1..ATTEMPTS_TO_PREPARE {
                if prepared != Err(PrepareError::Trouble(Trouble::Silent)) {
                    break;
                }
                prepared = prepare(line, joint.id, self.gains);
            }
        }
        match prepared {
            Ok(position) => {
                if was_out {
                    let missed = servo.missed;
                    tracing::info!(
                        "servo {} ({}) is back; it missed {missed} answers so far",
                        joint.id,
                        joint.name
                    );
                }
                servo.join(position);
            }
            Err(PrepareError::Trouble(Trouble::PortFailed)) => return Err(PortFailed),
            Err(PrepareError::Trouble(_)) => silence(servo, index, now),
            Err(PrepareError::Unsuitable(reason)) => {
                if !was_out {
                    tracing::warn!("servo {} ({}) cannot be used: {reason}", joint.id, joint.name);
                }
                servo.service = Service::Unsuitable { reason, retry_at: now + RETRY_SERVO };
            }
        }
        Ok(())
    }

    fn cycle(&mut self, now: Time, settings: &Settings, line: &mut Line<'_>) -> Result<Reading, PortFailed> {
        if self.gains != settings.gains {
            self.gains = settings.gains;
            let gains = self.gains;
            self.write_all(line, mx28::D_GAIN.address, |_| gains)?;
        }
        self.write_all(line, mx28::GOAL_POSITION.address, |servo| servo.next_goal().to_le_bytes())?;
        let reading = self.read_all(now, line)?;
        self.take(&reading, now);
        self.retry_one(now, line)?;
        Ok(reading)
    }

    /// Writes to all servos in service at once. Devices do not acknowledge, so goals are written in every
    /// cycle.
    ///
    /// Goals alone take 68 bytes for 20 servos. That fits into the 143 byte buffer of a servo, and leaves the
    /// cycle 0.8 ms more than writing the gains along with them would.
    fn write_all<const N: usize>(
        &mut self,
        line: &mut Line<'_>,
        address: u8,
        mut data: impl FnMut(&mut Servo) -> [u8; N],
    ) -> Result<(), PortFailed> {
        let mut bytes = Vec::with_capacity(COUNT * (1 + N));
        for (servo, joint) in self.servos.iter_mut().zip(&JOINTS).filter(|(servo, _)| servo.is_active()) {
            bytes.push(joint.id.raw());
            bytes.extend_from_slice(&data(servo));
        }
        let Some(block) = SyncWriteBlock::new(N as u8, &bytes).filter(|_| !bytes.is_empty()) else {
            return Ok(());
        };
        match line.exchange(&Instruction::SyncWrite { address, block }.to_bytes(), &[]).outcome {
            Outcome::Failed => Err(PortFailed),
            Outcome::Ok | Outcome::Timeout => Ok(()),
        }
    }

    fn read_all(&mut self, now: Time, line: &mut Line<'_>) -> Result<Reading, PortFailed> {
        let joints: Vec<usize> = (0..COUNT).filter(|joint| self.servos[*joint].is_active()).collect();
        let (instruction, expected) = request(&joints);
        let exchange = line.exchange(&instruction, &expected);
        if exchange.outcome == Outcome::Failed {
            return Err(PortFailed);
        }
        let reading = understand(exchange, &joints);
        self.blame(&reading, &joints, now);
        if self.board_misses > MISSES_OF_THE_BOARD {
            if self.troubles.silent_board.is_worth_a_line() {
                let count = self.troubles.silent_board.count();
                tracing::warn!("the CM-730 does not answer ({count} times so far), reopening the port");
            }
            return Err(PortFailed);
        }
        Ok(reading)
    }

    /// Determines which device caused missing answers. After a silent device no other answers a bulk read, so
    /// only the first missing one is at fault; if others answered after it, its answer was corrupt.
    fn blame(&mut self, reading: &Reading, joints: &[usize], now: Time) {
        let is_silent = reading.first_missing.is_some() && !reading.chain_went_on;
        self.board_misses = if reading.board.is_none() && is_silent { self.board_misses + 1 } else { 0 };
        for (position, &joint) in joints.iter().enumerate() {
            let servo = &mut self.servos[joint];
            if reading.servos[joint].is_some() {
                servo.misses = 0;
                continue;
            }
            servo.missed += 1;
            // The board is first.
            let is_first = reading.first_missing == Some(position + 1);
            if is_first || reading.chain_went_on {
                servo.misses += 1;
                let limit = if is_silent { MISSES_OF_A_SERVO } else { CORRUPT_OF_A_SERVO };
                if servo.misses >= limit {
                    silence(servo, joint, now);
                }
            }
        }
    }

    fn take(&mut self, reading: &Reading, now: Time) {
        for (servo, read) in self.servos.iter_mut().zip(&reading.servos) {
            servo.last = read.or(servo.last);
        }
        let Some(board) = reading.board else { return };
        self.port_wait = RETRY_PORT[0];
        self.board = Some(board);
        if !board.gives_power {
            tracing::warn!("the CM-730 has switched the servos off, switching them on again");
            self.forget_servos();
            self.phase = Phase::Open { retry_at: now };
        }
    }

    /// Polls one of the servos out of service.
    fn retry_one(&mut self, now: Time, line: &mut Line<'_>) -> Result<(), PortFailed> {
        if now < self.retry_any_at || self.phase != Phase::Running {
            return Ok(());
        }
        let waiting =
            self.servos.iter().enumerate().filter_map(|(index, servo)| Some((servo.retry_at()?, index)));
        match waiting.min() {
            Some((retry_at, index)) if retry_at <= now => {
                self.retry_any_at = now + RETRY_ANY;
                self.prepare(index, now, line)
            }
            _ => Ok(()),
        }
    }

    fn lose_port(&mut self, now: Time, line: &mut Line<'_>) {
        if self.troubles.lost_ports.is_worth_a_line() {
            let count = self.troubles.lost_ports.count();
            let error = line.exchanges.last().map_or("", |exchange| &exchange.error);
            tracing::warn!("lost the serial port ({count} times so far), opening it again: {error}");
        }
        line.close();
        self.forget_servos();
        self.board_misses = 0;
        self.wait_for_port(now);
    }

    fn wait_for_port(&mut self, now: Time) {
        self.phase = Phase::Closed { retry_at: now + self.port_wait };
        self.port_wait = (self.port_wait * 2).min(RETRY_PORT[1]);
    }

    fn forget_servos(&mut self) {
        for servo in &mut self.servos {
            servo.service = Service::Unknown;
        }
    }

    fn count(&mut self, now: Time, exchanges: &[Exchange]) {
        self.exchanges += exchanges.len() as u64;
        for _ in exchanges.iter().filter(|exchange| exchange.error.contains(LATE)) {
            self.last_late_at = Some(now);
            if self.troubles.late.is_worth_a_line() {
                let count = self.troubles.late.count();
                tracing::warn!(
                    "this machine is too busy: an answer on the bus arrived after its time-out ({count} times so far)"
                );
            }
        }
        for exchange in exchanges.iter().filter(|exchange| exchange.outcome == Outcome::Timeout) {
            self.last_timeout_at = Some(now);
            if self.troubles.timeouts.is_worth_a_line() {
                let count = self.troubles.timeouts.count();
                tracing::warn!("the bus: {} ({count} times so far)", exchange.error);
            }
        }
    }
}

/// LED colour.
const GREEN: u16 = 0x1F << 5;

/// The port does not work; the exchange contains the reason.
struct PortFailed;

fn silence(servo: &mut Servo, index: usize, now: Time) {
    if servo.retry_at().is_none() && servo.outages.is_worth_a_line() {
        let (joint, count) = (&JOINTS[index], servo.outages.count());
        tracing::warn!(
            "servo {} ({}) does not answer ({count} times so far), others continue",
            joint.id,
            joint.name
        );
    }
    servo.service = Service::Silent { retry_at: now + RETRY_SERVO };
}

/// Counts a fault, and decides when to log it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Counted(u64);

impl Counted {
    /// Counts one occurrence. Returns true the 1st, 10th, 100th, … time.
    pub(super) fn is_worth_a_line(&mut self) -> bool {
        self.0 += 1;
        10_u64.pow(self.0.ilog10()) == self.0
    }

    /// The number of occurrences.
    pub(super) fn count(self) -> u64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_of_ten_are_logged() {
        let mut counted = Counted::default();
        let lines: Vec<u64> = (1..=250).filter(|_| counted.is_worth_a_line()).collect();
        assert_eq!(lines, [1, 10, 100]);
        assert_eq!(counted.count(), 250);
    }
}
