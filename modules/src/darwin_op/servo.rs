//! What the module knows of one servo, and how it takes it into service.

use super::counted::Counted;
use super::line::{Line, Trouble};
use super::protocol::{Id, StatusError};
use super::reading::ServoReading;
use super::tables::mx28;
use downbeat_executor::Time;

/// How fast a servo that has just come into service goes to where it is wanted, in ticks per cycle: about 2 rad/s.
const CATCH_UP_TICKS: u16 = 10;

/// Whether a servo is in service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Service {
    /// Not asked yet.
    Unknown,
    /// Is read and driven in every cycle.
    Active,
    /// Does not answer. Is asked again then.
    Silent { retry_at: Time },
    /// Answers, but cannot be used. Is asked again then.
    Unsuitable { reason: String, retry_at: Time },
}

/// One servo.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Servo {
    pub(super) service: Service,
    /// The last that it said.
    pub(super) last: Option<ServoReading>,
    /// How many times in a row it was asked and did not answer.
    pub(super) misses: u32,
    /// How many times it fell silent.
    pub(super) outages: Counted,
    /// How many answers did not come, in all.
    pub(super) missed: u64,
    /// Where it is told to go.
    goal: u16,
    /// Where it is wanted, once somebody said so.
    wanted: Option<u16>,
    /// Whether it has caught up with where it is wanted since it came into service.
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

    /// Whether what is known of it is old: it is not in service, or missed its last answers.
    pub(super) fn is_stale(&self) -> bool {
        !self.is_active() || self.misses >= 2
    }

    /// When to ask again, if it is out of service.
    pub(super) fn retry_at(&self) -> Option<Time> {
        match self.service {
            Service::Unknown | Service::Active => None,
            Service::Silent { retry_at } | Service::Unsuitable { retry_at, .. } => Some(retry_at),
        }
    }

    /// Says where it is wanted.
    pub(super) fn want(&mut self, ticks: u16) {
        self.wanted = Some(ticks);
    }

    /// Takes it into service at this position, from where it does not jump.
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

    /// What is wrong with it by its own account.
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
            Trouble::Refused(error) => Self::Unsuitable(format!("it refuses its settings: {error}")),
            trouble => Self::Trouble(trouble),
        }
    }
}

/// Checks a servo and gives it what the cycle needs: no return delay, an answer to everything, these gains, no speed
/// limit, torque, and its present position as goal. Says where it is.
///
/// What outlives the power is written only where it differs: that memory wears out.
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
    // D, I, P, one byte that means nothing, goal, no speed limit.
    line.write(id, mx28::D_GAIN.address, &[d, i, p, 0, goal[0], goal[1], 0, 0])?;
    line.write(id, mx28::TORQUE_ENABLE.address, &[1])?;
    Ok(u16::from_le_bytes(goal))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_servo_stays_where_it_joins_until_it_is_wanted_elsewhere() {
        let mut servo = Servo::new();
        servo.join(2000);
        assert_eq!([servo.next_goal(), servo.next_goal()], [2000, 2000]);
    }

    #[test]
    fn a_servo_that_comes_back_goes_slowly_to_where_it_is_wanted_and_then_follows_at_once() {
        let mut servo = Servo::new();
        servo.want(2025);
        servo.join(2000);
        let goals: Vec<u16> = (0..4).map(|_| servo.next_goal()).collect();
        assert_eq!(goals, [2010, 2020, 2025, 2025]);
        servo.want(1000);
        assert_eq!(servo.next_goal(), 1000);
    }
}
