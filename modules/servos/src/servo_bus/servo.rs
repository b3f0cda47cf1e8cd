//! The state of one servo.

use super::joint::{Drive, Joint, Measurement, Protection};
use super::limp::{Limp, Reach};
use super::preparation::{Prepared, Softness};
use super::protocol::StatusError;
use downbeat_device::counted::Counted;
use downbeat_executor::Time;
use std::time::Duration;

/// How long a measurement must be beyond a threshold of the guard, or back, before that takes effect.
const GUARD_DELAY: Duration = Duration::from_secs(1);
/// How often the end of the torque is written: nobody acknowledges it.
const TORQUE_WRITES: u8 = 3;
/// The time between attempts to give a servo its torque.
const RETRY_TORQUE: Duration = Duration::from_secs(1);

/// The number of consecutive reads without an answer after which data is stale: a device behind a silent one
/// in a read of several misses two until the silent one is left out.
const UNHEARD: u32 = 3;

/// Whether a device is in service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Service {
    /// Not polled yet.
    Unknown,
    /// Read and driven in every cycle.
    Active,
    /// Does not answer. Polled again at `retry_at`.
    Silent { retry_at: Time },
    /// Answers, but cannot be used. Polled again at `retry_at`.
    Unsuitable { reason: String, retry_at: Time },
}

/// The connection to one device.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Link {
    pub(crate) service: Service,
    /// The number of consecutive missing answers of which it is the cause.
    pub(crate) misses: u32,
    /// The number of consecutive reads without its answer, whatever the cause; [`UNHEARD`] before the first
    /// answer.
    pub(crate) unheard: u32,
    /// How many times it stopped answering.
    pub(crate) outages: Counted,
    /// The total number of missing answers.
    pub(crate) missed: u64,
    /// The errors in its last answer.
    pub(crate) error: StatusError,
}

impl Link {
    pub(crate) fn new() -> Self {
        let (outages, error) = (Counted::default(), StatusError::NONE);
        Self { service: Service::Unknown, misses: 0, unheard: UNHEARD, outages, missed: 0, error }
    }

    pub(crate) fn is_active(&self) -> bool {
        self.service == Service::Active
    }

    /// Returns whether its data is stale: it is not in service, missed its last answers, or has not answered
    /// since it came into service.
    pub(crate) fn is_stale(&self) -> bool {
        !self.is_active() || self.misses >= 2 || self.unheard >= UNHEARD
    }

    /// When to poll it again, if it is out of service.
    pub(crate) fn retry_at(&self) -> Option<Time> {
        match self.service {
            Service::Unknown | Service::Active => None,
            Service::Silent { retry_at } | Service::Unsuitable { retry_at, .. } => Some(retry_at),
        }
    }

    pub(crate) fn join(&mut self) {
        self.service = Service::Active;
        (self.misses, self.unheard) = (0, UNHEARD);
    }
}

/// One servo.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Servo {
    pub(crate) link: Link,
    /// Its last measurement.
    pub(crate) last: Option<Measurement>,
    /// Why it is not the declared model, if that was found at the start.
    pub(crate) misfit: Option<String>,
    /// What its guard demands.
    pub(crate) protection: Protection,
    /// A change of the protection that begins to take effect, and since when.
    pending: Option<(Protection, Time)>,
    /// Since when it has rested after it switched itself off, and how often it did.
    resting_since: Option<Time>,
    shutdowns: Counted,
    /// Whether torque is commanded.
    is_torque_commanded: bool,
    /// The commanded share of its largest torque.
    commanded_share: f64,
    /// Whether its torque is enabled, and how often its end is still to be written.
    torque: (bool, u8),
    /// When to try next to give it its torque.
    engage_at: Time,
    /// Where its goals may be, and the position that it last answered with the errors beside it.
    reach: Reach,
    answered: Option<(i64, StatusError)>,
    /// Whether it was reported that it stays limp.
    is_limp_reported: bool,
    /// The gains and the share of the torque that were last written.
    pub(crate) written: Softness,
    /// The goal that is written to it.
    goal: i64,
    /// The commanded goal, if any.
    wanted: Option<i64>,
    /// When that was commanded.
    wanted_at: Time,
    /// Whether it has reached its command since it came into service.
    has_caught_up: bool,
}

impl Servo {
    pub(crate) fn new() -> Self {
        Self {
            link: Link::new(),
            last: None,
            misfit: None,
            protection: Protection::None,
            pending: None,
            resting_since: None,
            shutdowns: Counted::default(),
            is_torque_commanded: true,
            commanded_share: 1.0,
            torque: (false, 0),
            engage_at: Time::ZERO,
            reach: Reach::default(),
            answered: None,
            is_limp_reported: false,
            written: Softness::default(),
            goal: 0,
            wanted: None,
            wanted_at: Time::ZERO,
            has_caught_up: false,
        }
    }

    /// Sets the commanded goal.
    pub(crate) fn want(&mut self, raw: i64, now: Time) {
        (self.wanted, self.wanted_at) = (Some(raw), now);
    }

    /// Commands a share of the largest torque, from 0 to 1; 0 is none. A new command ends the protection that
    /// switched the torque off, until the guard demands it again.
    pub(crate) fn command_torque(&mut self, share: f64) {
        self.is_torque_commanded = share > 0.0;
        if self.is_torque_commanded {
            self.commanded_share = share.min(1.0);
            if self.protection == Protection::Off {
                (self.protection, self.pending) = (Protection::Soften, None);
            }
            if self.rests() {
                self.try_again();
            }
        } else {
            self.wanted = None;
        }
    }

    /// Lets a servo that has switched itself off try again after the rest that its guard grants.
    pub(crate) fn rest(&mut self, joint: &Joint, now: Time) {
        // What a servo reports before its torque is written again is old.
        if !self.wants_torque() || self.torque != (true, 0) {
            return;
        }
        let error = self.link.error;
        let is_hot = error.contains(StatusError::OVERHEATING);
        if error.contains(StatusError::OVERLOAD) || is_hot {
            if self.resting_since.is_none() && self.shutdowns.is_worth_a_line() {
                let count = self.shutdowns.count();
                tracing::warn!(
                    "{} switches its torque off, if its shutdown is set so: {error} ({count})",
                    joint.name
                );
            }
            self.resting_since = self.resting_since.filter(|_| !is_hot).or(Some(now));
        }
        let rest = joint.guard.shutdown_rest_s.map(Duration::from_secs_f64);
        if self.resting_since.zip(rest).is_some_and(|(since, rest)| since + rest <= now) {
            self.try_again();
        }
    }

    /// Whether it has probably no torque, since it switched itself off.
    pub(crate) fn rests(&self) -> bool {
        self.resting_since.is_some()
    }

    /// Gives it torque and torque limit once more: a shutdown sets one of them to 0, which one depends on the
    /// firmware.
    fn try_again(&mut self) {
        self.resting_since = None;
        (self.torque, self.engage_at) = ((false, TORQUE_WRITES), Time::ZERO);
        self.written.torque_limit = Some(0);
    }

    /// Returns whether it is to have torque.
    pub(crate) fn wants_torque(&self) -> bool {
        self.is_torque_commanded && self.protection != Protection::Off
    }

    /// Returns whether it has torque, and therefore a goal.
    pub(crate) fn has_torque(&self) -> bool {
        self.torque.0
    }

    /// Ends its torque, if it should have none any more. Returns true if that must be written.
    pub(crate) fn ends_torque(&mut self) -> bool {
        if self.has_torque() && !self.wants_torque() {
            self.torque = (false, TORQUE_WRITES);
        }
        let is_due = self.torque.1 > 0;
        self.torque.1 = self.torque.1.saturating_sub(1);
        is_due
    }

    /// Returns whether it is to get its torque now.
    pub(crate) fn is_to_engage(&self, now: Time) -> bool {
        let is_heard = self.link.is_active() && self.link.misses == 0;
        is_heard && self.wants_torque() && !self.has_torque() && self.engage_at <= now
    }

    /// An attempt to give it its torque begins: the next one comes later.
    pub(crate) fn begin_to_engage(&mut self, now: Time) {
        self.engage_at = now + RETRY_TORQUE;
    }

    /// It has torque, with its present position as goal.
    pub(crate) fn engage(&mut self, position: i64) {
        (self.goal, self.has_caught_up) = (position, false);
        (self.torque, self.engage_at) = ((true, 0), Time::ZERO);
    }

    /// Takes the position that it answered, with the errors beside it.
    pub(crate) fn note_position(&mut self, position: i64, error: StatusError) {
        self.answered = Some((position, error));
    }

    /// Why it gets no torque, whether that is wanted or not; `None` while it has torque.
    pub(crate) fn limp(&self, joint: &Joint) -> Option<Limp> {
        let (position, error) = self.answered.filter(|_| self.link.is_active() && !self.has_torque())?;
        Limp::of(joint, self.reach, position, error)
    }

    /// Says once that it stays limp though its torque is wanted, and that this is over.
    pub(crate) fn report_limp(&mut self, joint: &Joint) {
        let limp = self.limp(joint).filter(|_| self.wants_torque());
        match limp {
            Some(limp) if !self.is_limp_reported => tracing::error!("{}", limp.words(joint)),
            None if self.is_limp_reported && self.link.is_active() => {
                tracing::info!("servo {} ({}) need not stay limp any more", joint.id, joint.name);
            }
            _ => {}
        }
        self.is_limp_reported = limp.is_some() || (self.is_limp_reported && !self.link.is_active());
    }

    /// Brings it into service at this position, without a jump.
    pub(crate) fn join(&mut self, prepared: &Prepared, written: Softness) {
        self.link.join();
        self.resting_since = None;
        self.goal = prepared.position;
        self.has_caught_up = false;
        (self.reach, self.answered) = (prepared.reach, Some((prepared.position, prepared.error)));
        (self.torque, self.engage_at) = ((prepared.has_torque, 0), Time::ZERO);
        self.written = written;
    }

    /// The goal of the next cycle while nothing may move. Forgets the command.
    pub(crate) fn hold(&mut self) -> i64 {
        self.wanted = None;
        self.goal
    }

    /// The velocity or effort of the next cycle: 0 without a recent command, and beyond a limit.
    pub(crate) fn next_driven_goal(&mut self, joint: &Joint, drive: &Drive, now: Time) -> i64 {
        let is_recent = now < self.wanted_at + drive.timeout;
        let wanted = self.wanted.filter(|_| is_recent).unwrap_or(0);
        let position = self.last.filter(|_| !self.link.is_stale()).map(|last| last.position);
        let is_safe = match position {
            Some(position) => !joint.leads_out(wanted, position),
            None => joint.min_rad == f64::NEG_INFINITY && joint.max_rad == f64::INFINITY,
        };
        if is_safe { wanted } else { 0 }
    }

    /// The goal of the next cycle.
    pub(crate) fn next_goal(&mut self, approach_steps: i64) -> i64 {
        if let Some(wanted) = self.wanted {
            let slowly = wanted.clamp(self.goal - approach_steps, self.goal + approach_steps);
            self.goal = if self.has_caught_up { wanted } else { slowly };
            self.has_caught_up |= slowly == wanted;
        }
        self.goal
    }

    /// How hard it is to pull now.
    pub(crate) fn softness(&self, joint: &Joint) -> Softness {
        let is_soft = self.protection == Protection::Soften;
        let registers = &joint.registers;
        let is_limited = joint.max_torque.is_some() || self.commanded_share < 1.0 || joint.guard.softens();
        let torque_limit =
            registers.torque_limit.as_ref().filter(|_| is_limited || self.written.torque_limit.is_some());
        let share = joint.max_torque.unwrap_or(1.0) * self.commanded_share * if is_soft { 0.5 } else { 1.0 };
        let mut gains = joint.gains;
        if is_soft && registers.torque_limit.is_none() {
            // The P gain of a model without torque limit; the gain must be known to be restored.
            gains[2] = gains[2].map(|gain| gain / 2);
        }
        let torque_limit = torque_limit.map(|register| (register.max as f64 * share).round() as i64);
        Softness { gains, torque_limit }
    }

    /// Takes a measurement, and lets the guard decide.
    pub(crate) fn take(&mut self, measurement: Measurement, joint: &Joint, now: Time) {
        self.last = Some(measurement);
        self.note_position(measurement.position, self.link.error);
        self.report_limp(joint);
        let demanded = joint.guard.demand(&measurement);
        if demanded == self.protection || self.protection == Protection::Off {
            self.pending = None;
            return;
        }
        // The least of what was demanded since the change began.
        let (least, since) = self
            .pending
            .filter(|(pending, _)| (*pending > self.protection) == (demanded > self.protection))
            .unwrap_or((demanded, now));
        let least = if demanded > self.protection { least.min(demanded) } else { least.max(demanded) };
        self.pending = Some((least, since));
        if since + GUARD_DELAY <= now {
            (self.protection, self.pending) = (least, None);
            match least {
                Protection::None => tracing::info!("{}: temperature and voltage are well again", joint.name),
                Protection::Warn => tracing::warn!("{}: {}", joint.name, reading(&measurement)),
                Protection::Soften => {
                    tracing::warn!("{} gets half its torque: {}", joint.name, reading(&measurement));
                }
                Protection::Off => {
                    tracing::error!("{} loses its torque: {}", joint.name, reading(&measurement));
                }
            }
        }
    }
}

/// Temperature and voltage in words.
pub(crate) fn reading(measurement: &Measurement) -> String {
    let celsius = measurement.celsius.map(|celsius| format!("{celsius} degrees Celsius"));
    let voltage = measurement.voltage.map(|voltage| format!("{voltage} V"));
    celsius.into_iter().chain(voltage).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::joint::{Guard, Thresholds};
    use super::*;

    fn at(position: i64) -> Prepared {
        Prepared { position, error: StatusError::NONE, reach: Reach::default(), has_torque: true }
    }

    #[test]
    fn a_servo_stays_at_its_position_until_it_is_commanded() {
        let mut servo = Servo::new();
        servo.join(&at(2000), Softness::default());
        assert_eq!([servo.next_goal(10), servo.next_goal(10)], [2000, 2000]);
    }

    #[test]
    fn a_servo_that_comes_back_approaches_its_command_slowly_and_then_follows_at_once() {
        let mut servo = Servo::new();
        servo.want(2025, Time::ZERO);
        servo.join(&at(2000), Softness::default());
        let goals: Vec<i64> = (0..4).map(|_| servo.next_goal(10)).collect();
        assert_eq!(goals, [2010, 2020, 2025, 2025]);
        servo.want(1000, Time::ZERO);
        assert_eq!(servo.next_goal(10), 1000);
    }

    fn guarded(temperature: Thresholds) -> Joint {
        let text = "name = \"x\"\n[[bus]]\nname = \"b\"\nport = \"p\"\nbaud = 1000000\nprotocol = \"dynamixel1\"\ncycle_ms = 8\n[[joint]]\nname = \"j\"\nid = 1\nmodel = \"MX-28\"\nlimits = [-1.0, 1.0]";
        let description = super::super::description::Description::parse("x", text).unwrap();
        let mut joint = description.buses()[0].joints[0].clone();
        joint.guard = Guard { temperature_c: Some(temperature), ..Guard::default() };
        joint
    }

    #[test]
    fn a_guard_softens_and_switches_off_what_stays_hot_for_a_second() {
        let joint = guarded(Thresholds { warn: Some(60.0), soften: Some(65.0), off: Some(70.0) });
        let mut servo = Servo::new();
        servo.join(&at(2048), Softness::default());
        let after = |ms: i64| Time::from_nanos(ms * 1_000_000);
        let feel = |servo: &mut Servo, celsius, ms| {
            let measurement = Measurement {
                position: 2048,
                velocity: 0.0,
                effort: 0.0,
                voltage: None,
                celsius: Some(celsius),
            };
            servo.take(measurement, &joint, after(ms));
            servo.protection
        };
        assert_eq!(feel(&mut servo, 66.0, 0), Protection::None, "one hot sample is not enough");
        assert_eq!(feel(&mut servo, 59.0, 900), Protection::None);
        assert_eq!(feel(&mut servo, 66.0, 1000), Protection::None);
        assert_eq!(feel(&mut servo, 71.0, 2000), Protection::Soften, "the least of the last second");
        assert_eq!(servo.softness(&joint).torque_limit, Some(512));
        assert_eq!(feel(&mut servo, 71.0, 2100), Protection::Soften);
        assert_eq!(feel(&mut servo, 71.0, 3100), Protection::Off);
        assert!(!servo.wants_torque());
        feel(&mut servo, 20.0, 4000);
        assert_eq!(feel(&mut servo, 20.0, 9000), Protection::Off, "until it is switched on");
        servo.command_torque(1.0);
        assert!(servo.wants_torque());
        feel(&mut servo, 20.0, 10_000);
        assert_eq!(feel(&mut servo, 20.0, 11_000), Protection::None);
        assert_eq!(servo.softness(&joint).torque_limit, Some(1023));
    }

    #[test]
    fn a_servo_that_switched_itself_off_rests_and_gets_its_torque_again() {
        let mut joint = guarded(Thresholds::default());
        joint.guard.shutdown_rest_s = Some(2.0);
        let after = |ms: i64| Time::from_nanos(ms * 1_000_000);
        let mut servo = Servo::new();
        let softness = servo.softness(&joint);
        servo.join(&at(2048), softness);
        let is_tried = |servo: &mut Servo, error, ms| {
            servo.link.error = error;
            servo.rest(&joint, after(ms));
            let is_ended = servo.ends_torque();
            let limit = servo.softness(&joint).torque_limit;
            (is_ended, servo.is_to_engage(after(ms)), limit != servo.written.torque_limit)
        };
        let nothing = (false, false, false);
        assert_eq!(is_tried(&mut servo, StatusError::NONE, 0), nothing);
        assert_eq!(is_tried(&mut servo, StatusError::OVERHEATING, 1000), nothing);
        assert_eq!(is_tried(&mut servo, StatusError::OVERHEATING, 9000), nothing);
        assert!(servo.rests());
        assert_eq!(is_tried(&mut servo, StatusError::NONE, 10_000), nothing, "it has just cooled");
        assert_eq!(is_tried(&mut servo, StatusError::NONE, 11_000), (true, true, true));
        assert!(is_tried(&mut servo, StatusError::OVERHEATING, 11_008).1, "an old alarm");
        servo.engage(2000);
        servo.link.error = StatusError::NONE;
        assert!(!servo.ends_torque() && !servo.rests() && servo.has_torque());
        assert_eq!(servo.next_goal(10), 2000);
        joint.guard.shutdown_rest_s = None;
        servo.link.error = StatusError::OVERLOAD;
        servo.rest(&joint, after(20_000));
        servo.link.error = StatusError::NONE;
        servo.rest(&joint, after(99_000));
        servo.command_torque(0.0);
        servo.rest(&joint, after(100_000));
        assert!(servo.ends_torque() && servo.rests(), "until its torque is commanded");
        servo.command_torque(1.0);
        assert!(servo.is_to_engage(after(100_000)) && !servo.rests());
    }
}
