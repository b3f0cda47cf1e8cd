//! Which servos stay limp: those whose present position cannot be their goal.
//!
//! A servo holds its present position when it gets its torque. If it could only be given another goal, such
//! as the nearer end of the register, it would turn there without a command.

use super::joint::Joint;
use super::models::Register;
use super::protocol::{Protocol, StatusError};

/// The raw positions that a servo takes as goals: those of the register, within the position limits that the
/// servo keeps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Reach {
    min: i64,
    max: i64,
}

impl Reach {
    pub(crate) fn contains(self, raw: i64) -> bool {
        (self.min..=self.max).contains(&raw)
    }
}

/// The reach of a servo with these settings, the first bytes of its table, after these have been written.
pub(crate) fn reach_of(
    joint: &Joint,
    protocol: Protocol,
    settings: &[u8],
    written: &[(&Register, i64)],
) -> Reach {
    let limit = |name: &str| {
        let written = written.iter().find(|(register, _)| register.name == name).map(|(_, value)| *value);
        written.or_else(|| joint.model.register(name)?.raw_in(protocol, settings, 0))
    };
    let goal = &joint.registers.goal;
    Reach {
        min: limit("min_position_limit").map_or(goal.min, |min| min.max(goal.min)),
        max: limit("max_position_limit").map_or(goal.max, |max| max.min(goal.max)),
    }
}

/// Why a servo stays limp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Limp {
    /// Its position is outside its reach.
    Outside { position: i64, reach: Reach },
    /// It reports that its position sensor is faulty.
    Sensor { position: i64 },
}

impl Limp {
    /// Why this servo stays limp, if it has to. Goals that are velocities or efforts do not depend on the
    /// position.
    pub(crate) fn of(joint: &Joint, reach: Reach, position: i64, error: StatusError) -> Option<Self> {
        if joint.drive.is_some() {
            None
        } else if error.contains(StatusError::POSITION_SENSOR) {
            Some(Self::Sensor { position })
        } else if reach.contains(position) {
            None
        } else {
            Some(Self::Outside { position, reach })
        }
    }

    /// The reason with joint, id, reading and remedy.
    pub(crate) fn words(self, joint: &Joint) -> String {
        let Joint { id, name, .. } = joint;
        let angle = |position| format!("{position} ({:.3} rad)", joint.angle(position));
        match self {
            Self::Outside { position, reach: Reach { min, max } } => format!(
                "servo {id} ({name}) stays limp: its position reads {}, outside {min} to {max}, where its goals can be, and with \
                 torque it would turn there by itself. Reset its count of turns (switch its power off and on), calibrate it \
                 (homing_offset, position limits), or turn it by hand into that range; then it gets its torque",
                angle(position),
            ),
            Self::Sensor { position } => format!(
                "servo {id} ({name}) stays limp: it reports that its position sensor is faulty, and reads {}. Switch its power off \
                 and on, calibrate it, or exchange it",
                angle(position),
            ),
        }
    }
}
