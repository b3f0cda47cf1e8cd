//! Faults and their textual form.

use super::random::Random;
use crate::servo_bus::protocol::Id;
use std::fmt;
use std::str::FromStr;
use std::time::Duration;

/// Something that goes wrong for a while.
///
/// Written as its kind, `@`, and its time span, relative to the start of the emulator or to the injection:
///
/// | text | meaning |
/// | --- | --- |
/// | `dead-servo:5@3s..6s` | servo 5 has no power from second 3 to second 6 |
/// | `drop:0.01` | each answer is lost with a probability of 1 %, all the time |
/// | `drop:3x@500ms..` | the first three answers after half a second are lost |
/// | `flip:0.001@10s..20s` | in each byte of an answer a bit is flipped with a probability of 0.1 % |
/// | `flip:1x` | in the next answer one bit is flipped |
/// | `close-port@8s..9s` | the port is closed, and another one opened a second later |
/// | `twin:5` | a second servo has the id 5 |
/// | `supply:12.1` | the servos are supplied with 12.1 V |
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fault {
    /// The kind of fault.
    pub kind: FaultKind,
    /// When it starts.
    pub from: Duration,
    /// When it ends; `None` if never.
    pub to: Option<Duration>,
}

/// The kinds of faults.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultKind {
    /// A servo without power, as if its cable were disconnected. It loses its settings and must be configured
    /// again.
    DeadServo(Id),
    /// Answers are lost. In a bulk read, those after a lost one are missing as well.
    Drop(Rate),
    /// Bits of answers are flipped: with a probability for each byte, or one bit in each of some answers.
    Flip(Rate),
    /// The port is closed, as if it were unplugged.
    ClosePort,
    /// A second servo with this id, in another position and with another delay before it answers: both answer
    /// at the same time, to whatever they are asked, and neither is understood.
    Twin(Id),
    /// The servos are supplied with this voltage, in V.
    Supply(f64),
}

/// How often something happens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rate {
    /// Each time with this probability.
    Probability(f64),
    /// This many times.
    Next(u32),
}

impl Fault {
    /// A fault that starts at once and does not end.
    #[must_use]
    pub const fn always(kind: FaultKind) -> Self {
        Self { kind, from: Duration::ZERO, to: None }
    }

    /// A fault that starts at once and ends after this time.
    #[must_use]
    pub const fn lasting(kind: FaultKind, time: Duration) -> Self {
        Self { kind, from: Duration::ZERO, to: Some(time) }
    }
}

impl Fault {
    /// Checks that a dead servo is one of the robot.
    ///
    /// # Errors
    /// Returns an error with the id of a servo that the robot does not have.
    pub fn check(self, mut has: impl FnMut(Id) -> bool) -> Result<Self, FaultParseError> {
        match self.kind {
            FaultKind::DeadServo(id) | FaultKind::Twin(id) if !has(id) => {
                Err(FaultParseError::Servo { found: id.to_string() })
            }
            _ => Ok(self),
        }
    }
}

/// Why a text is not a fault.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FaultParseError {
    /// No fault has this name.
    #[error(
        "unknown fault {found:?}; available are dead-servo:ID, drop:RATE, flip:RATE, close-port, twin:ID and supply:VOLTS, each with @FROM..TO"
    )]
    Kind {
        /// The given text.
        found: String,
    },
    /// Not a servo.
    #[error("no servo has the id {found:?}; name one of the robot, as in dead-servo:5@3s..6s")]
    Servo {
        /// The given text.
        found: String,
    },
    /// Only servos that a description names have it.
    #[error("the fault {found:?} is emulated for servos of a description only, not for this robot")]
    Elsewhere {
        /// The fault.
        found: String,
    },
    /// Not a rate.
    #[error(
        "{found:?} is not a rate; a rate is a probability from 0 to 1 such as 0.01, or a count such as 3x"
    )]
    Rate {
        /// The given text.
        found: String,
    },
    /// Not a voltage.
    #[error("{found:?} is not a voltage; a voltage is from 0 to 100, in V")]
    Voltage {
        /// The given text.
        found: String,
    },
    /// Not a time.
    #[error("{found:?} is not a time; a time is written 3s, 1.5s or 500ms, a span of it 3s..6s or 3s..")]
    Time {
        /// The given text.
        found: String,
    },
    /// It would end before it starts.
    #[error("the fault {found:?} ends before it starts")]
    Empty {
        /// The given text.
        found: String,
    },
}

impl FromStr for Fault {
    type Err = FaultParseError;

    fn from_str(text: &str) -> Result<Self, FaultParseError> {
        let (kind, span) = text.split_once('@').map_or((text, None), |(kind, span)| (kind, Some(span)));
        let kind = parse_kind(kind.trim())?;
        let Some(span) = span else { return Ok(Self::always(kind)) };
        let (from, to) = span.split_once("..").unwrap_or((span, ""));
        let from = parse_time(from)?;
        let to = if to.trim().is_empty() { None } else { Some(parse_time(to)?) };
        if to.is_some_and(|to| to <= from) {
            return Err(FaultParseError::Empty { found: text.to_owned() });
        }
        Ok(Self { kind, from, to })
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.kind {
            FaultKind::DeadServo(id) => write!(formatter, "dead-servo:{id}"),
            FaultKind::Drop(rate) => write!(formatter, "drop:{rate}"),
            FaultKind::Flip(rate) => write!(formatter, "flip:{rate}"),
            FaultKind::ClosePort => formatter.write_str("close-port"),
            FaultKind::Twin(id) => write!(formatter, "twin:{id}"),
            FaultKind::Supply(volts) => write!(formatter, "supply:{volts}"),
        }?;
        match (self.from, self.to) {
            (Duration::ZERO, None) => Ok(()),
            (from, None) => write!(formatter, "@{}s..", from.as_secs_f64()),
            (from, Some(to)) => write!(formatter, "@{}s..{}s", from.as_secs_f64(), to.as_secs_f64()),
        }
    }
}

impl fmt::Display for Rate {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Probability(probability) => probability.fmt(formatter),
            Self::Next(count) => write!(formatter, "{count}x"),
        }
    }
}

fn parse_kind(text: &str) -> Result<FaultKind, FaultParseError> {
    let (name, value) = text.split_once(':').unwrap_or((text, ""));
    match (name, value) {
        ("dead-servo", id) => Ok(FaultKind::DeadServo(parse_servo(id)?)),
        ("drop", rate) => Ok(FaultKind::Drop(parse_rate(rate)?)),
        ("flip", rate) => Ok(FaultKind::Flip(parse_rate(rate)?)),
        ("close-port", "") => Ok(FaultKind::ClosePort),
        ("twin", id) => Ok(FaultKind::Twin(parse_servo(id)?)),
        ("supply", volts) => Ok(FaultKind::Supply(parse_voltage(volts)?)),
        _ => Err(FaultParseError::Kind { found: text.to_owned() }),
    }
}

fn parse_servo(text: &str) -> Result<Id, FaultParseError> {
    let id = text.parse().ok().and_then(Id::new);
    id.filter(|id| !id.is_broadcast()).ok_or_else(|| FaultParseError::Servo { found: text.to_owned() })
}

fn parse_rate(text: &str) -> Result<Rate, FaultParseError> {
    let rate = match text.strip_suffix('x') {
        Some(count) => count.parse().ok().map(Rate::Next),
        None => text.parse().ok().filter(|p| (0.0..=1.0).contains(p)).map(Rate::Probability),
    };
    rate.ok_or_else(|| FaultParseError::Rate { found: text.to_owned() })
}

fn parse_voltage(text: &str) -> Result<f64, FaultParseError> {
    let volts = text.parse().ok().filter(|volts| (0.0..=100.0).contains(volts));
    volts.ok_or_else(|| FaultParseError::Voltage { found: text.to_owned() })
}

fn parse_time(text: &str) -> Result<Duration, FaultParseError> {
    downbeat_files::duration::parse(text).map_err(|_| FaultParseError::Time { found: text.trim().to_owned() })
}

/// What disturbs servos other than a loss of their power.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Disturbance {
    /// The ids that two servos have.
    pub twins: Vec<Id>,
    /// The voltage of the supply, if it is not that of the model.
    pub supply_v: Option<f64>,
}

/// The faults of a run. Times are those of the emulator.
pub struct FaultSchedule {
    faults: Vec<Fault>,
    random: Random,
}

impl FaultSchedule {
    /// The faults of a run; the same seed repeats them.
    #[must_use]
    pub fn new(faults: Vec<Fault>, seed: u64) -> Self {
        Self { faults, random: Random::new(seed, 4) }
    }

    /// Adds a fault with times relative to `now`, and removes those that are over.
    pub fn inject(&mut self, fault: Fault, now: Duration) {
        self.faults.retain(|fault| fault.to.is_none_or(|to| now < to) && !is_used_up(fault));
        self.faults.push(Fault { from: now + fault.from, to: fault.to.map(|to| now + to), ..fault });
    }

    /// Returns whether this servo has no power.
    #[must_use]
    pub fn is_dead(&self, id: Id, now: Duration) -> bool {
        self.on(now).any(|fault| fault.kind == FaultKind::DeadServo(id))
    }

    /// What disturbs the servos.
    #[must_use]
    pub fn disturbance(&self, now: Duration) -> Disturbance {
        let mut disturbance = Disturbance::default();
        for fault in self.on(now) {
            match fault.kind {
                FaultKind::Twin(id) => disturbance.twins.push(id),
                FaultKind::Supply(volts) => disturbance.supply_v = Some(volts),
                _ => {}
            }
        }
        disturbance
    }

    /// Returns whether the port is closed.
    #[must_use]
    pub fn is_port_closed(&self, now: Duration) -> bool {
        self.on(now).any(|fault| fault.kind == FaultKind::ClosePort)
    }

    /// Returns whether the answer that is about to be sent is lost.
    pub fn loses_answer(&mut self, now: Duration) -> bool {
        let random = &mut self.random;
        let mut is_lost = false;
        for fault in self.faults.iter_mut().filter(|fault| is_on(fault, now)) {
            if let FaultKind::Drop(rate) = &mut fault.kind {
                is_lost |= happens(rate, random);
            }
        }
        is_lost
    }

    /// Flips bits of an answer. Returns their number.
    pub fn flip(&mut self, packet: &mut [u8], now: Duration) -> u64 {
        let random = &mut self.random;
        let mut flipped = 0;
        for fault in self.faults.iter_mut().filter(|fault| is_on(fault, now)) {
            let FaultKind::Flip(rate) = &mut fault.kind else { continue };
            match rate {
                Rate::Probability(probability) => {
                    for byte in packet.iter_mut() {
                        if random.unit() < *probability {
                            *byte ^= 1 << (random.next_u64() % 8);
                            flipped += 1;
                        }
                    }
                }
                Rate::Next(_) => {
                    if happens(rate, random) {
                        let index = random.next_u64() as usize % packet.len().max(1);
                        if let Some(byte) = packet.get_mut(index) {
                            *byte ^= 1 << (random.next_u64() % 8);
                            flipped += 1;
                        }
                    }
                }
            }
        }
        flipped
    }

    fn on(&self, now: Duration) -> impl Iterator<Item = &Fault> {
        self.faults.iter().filter(move |fault| is_on(fault, now))
    }
}

fn is_on(fault: &Fault, now: Duration) -> bool {
    fault.from <= now && fault.to.is_none_or(|to| now < to)
}

fn is_used_up(fault: &Fault) -> bool {
    matches!(fault.kind, FaultKind::Drop(Rate::Next(0)) | FaultKind::Flip(Rate::Next(0)))
}

fn happens(rate: &mut Rate, random: &mut Random) -> bool {
    match rate {
        Rate::Probability(probability) => random.unit() < *probability,
        Rate::Next(0) => false,
        Rate::Next(count) => {
            *count -= 1;
            true
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn faults_are_parsed_as_documented() {
        let (ms, id) = (Duration::from_millis, Id::new(5).unwrap());
        let read = |text: &str| text.parse::<Fault>().unwrap();
        let dead = FaultKind::DeadServo(id);
        assert_eq!(read("dead-servo:5@3s..6s"), Fault { kind: dead, from: ms(3000), to: Some(ms(6000)) });
        assert_eq!(read("drop:0.01"), Fault::always(FaultKind::Drop(Rate::Probability(0.01))));
        let drop = FaultKind::Drop(Rate::Next(3));
        assert_eq!(read("drop:3x@500ms.."), Fault { kind: drop, from: ms(500), to: None });
        assert_eq!(read("flip:1x"), Fault::always(FaultKind::Flip(Rate::Next(1))));
        assert_eq!(
            read("close-port@8s..9s"),
            Fault { kind: FaultKind::ClosePort, from: ms(8000), to: Some(ms(9000)) }
        );
    }

    #[test]
    fn a_fault_round_trips_as_text() {
        for text in [
            "dead-servo:5@3s..6s",
            "drop:0.01",
            "drop:3x@0.5s..",
            "flip:0.001@10s..20s",
            "close-port@8s..9s",
            "twin:3",
            "supply:12.1",
        ] {
            assert_eq!(text.parse::<Fault>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn invalid_faults_are_reported_with_the_reason() {
        let error = |text: &str| text.parse::<Fault>().unwrap_err().to_string();
        assert!(error("dead-serve:5").contains("unknown fault \"dead-serve:5\""));
        assert!(error("close-port:3").contains("unknown fault"));
        assert!(error("dead-servo:254").contains("no servo has the id"));
        assert!(error("twin:254").contains("no servo has the id"));
        assert!(error("supply:12V").contains("\"12V\" is not a voltage"));
        assert!(error("drop:1.5").contains("\"1.5\" is not a rate"));
        assert!(error("flip:-1x").contains("is not a rate"));
        assert!(error("drop:0.1@3").contains("\"3\" is not a time"));
        assert!(error("drop:0.1@-3s").contains("is not a time"));
        assert!(error("close-port@9s..8s").contains("ends before it starts"));
    }

    fn schedule(faults: &[&str]) -> FaultSchedule {
        FaultSchedule::new(faults.iter().map(|text| text.parse().unwrap()).collect(), 1)
    }

    #[test]
    fn a_fault_is_active_in_its_time_only() {
        let schedule = schedule(&["dead-servo:5@3s..6s", "close-port@8s.."]);
        let dead = |ms| schedule.is_dead(Id::new(5).unwrap(), Duration::from_millis(ms));
        assert_eq!([2999, 3000, 5999, 6000].map(dead), [false, true, true, false]);
        assert!(!schedule.is_dead(Id::new(6).unwrap(), Duration::from_secs(4)));
        assert!(
            !schedule.is_port_closed(Duration::from_secs(7))
                && schedule.is_port_closed(Duration::from_secs(9))
        );
    }

    #[test]
    fn the_times_of_an_injected_fault_are_relative_to_the_injection() {
        let mut schedule = schedule(&[]);
        schedule.inject("close-port@1s..2s".parse().unwrap(), Duration::from_secs(10));
        let closed = |s| schedule.is_port_closed(Duration::from_secs(s));
        assert_eq!([1, 10, 11, 12].map(closed), [false, false, true, false]);
    }

    #[test]
    fn a_count_is_used_up() {
        let mut schedule = schedule(&["drop:2x"]);
        let lost: Vec<bool> = (0..4).map(|_| schedule.loses_answer(Duration::ZERO)).collect();
        assert_eq!(lost, [true, true, false, false]);
    }

    #[test]
    fn a_probability_is_approximately_met() {
        let mut schedule = schedule(&["drop:0.25"]);
        let lost = (0..10_000).filter(|_| schedule.loses_answer(Duration::ZERO)).count();
        assert!((2300..2700).contains(&lost), "{lost} of 10000");
    }

    #[test]
    fn one_flip_changes_one_bit_of_one_answer() {
        let mut schedule = schedule(&["flip:1x"]);
        let mut packet = [0_u8; 14];
        assert_eq!(schedule.flip(&mut packet, Duration::ZERO), 1);
        assert_eq!(packet.iter().map(|byte| byte.count_ones()).sum::<u32>(), 1);
        assert_eq!(schedule.flip(&mut packet, Duration::ZERO), 0);
    }
}
