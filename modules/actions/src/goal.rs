//! Goals: their ids and states.

use downbeat_executor::Time;
use downbeat_msgs::action_msgs::msg::GoalStatus as StatusMessage;
use downbeat_msgs::unique_identifier_msgs::msg::UUID;
use std::fmt;
use thiserror::Error;

/// The id of a goal of an action, chosen by the client that sends it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct GoalId(pub [u8; 16]);

impl GoalId {
    /// The id of a goal that a module sends: unique, since it depends on the time and a counter, and the same
    /// in a replay.
    pub(super) fn new(module: &str, action: &str, time: Time, number: u64) -> Self {
        let (time, number) = (time.as_nanos().to_le_bytes(), number.to_le_bytes());
        // Names contain no zero byte, so it separates them.
        let bytes = module.bytes().chain([0]).chain(action.bytes()).chain([0]).chain(time).chain(number);
        // FNV-1a with 128 bits (draft-eastlake-fnv).
        let hash = bytes.fold(0x6c62_272e_07bb_0142_62b8_2175_6295_c58d_u128, |hash, byte| {
            (hash ^ u128::from(byte)).wrapping_mul(0x0100_0000_0000_0000_0000_013b)
        });
        let mut id = hash.to_be_bytes();
        // Version 8 and the variant of RFC 9562: a custom id.
        id[6] = (id[6] & 0x0f) | 0x80;
        id[8] = (id[8] & 0x3f) | 0x80;
        Self(id)
    }
}

impl From<UUID> for GoalId {
    fn from(id: UUID) -> Self {
        Self(id.uuid)
    }
}

impl From<GoalId> for UUID {
    fn from(id: GoalId) -> Self {
        Self { uuid: id.0 }
    }
}

impl fmt::Display for GoalId {
    /// 32 hexadecimal digits, as `ros2 action` prints them.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// The status of a goal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum GoalStatus {
    /// The server does not know the goal, or no longer knows it.
    #[default]
    Unknown,
    /// Accepted, waiting for execution.
    Accepted,
    /// Being executed.
    Executing,
    /// Being canceled.
    Canceling,
    /// Reached.
    Succeeded,
    /// Canceled.
    Canceled,
    /// Aborted by the server.
    Aborted,
}

impl GoalStatus {
    /// True until the goal has ended.
    #[must_use]
    pub fn is_active(self) -> bool {
        matches!(self, Self::Accepted | Self::Executing | Self::Canceling)
    }

    /// The number in messages.
    #[must_use]
    pub fn to_message(self) -> i8 {
        match self {
            Self::Unknown => StatusMessage::STATUS_UNKNOWN,
            Self::Accepted => StatusMessage::STATUS_ACCEPTED,
            Self::Executing => StatusMessage::STATUS_EXECUTING,
            Self::Canceling => StatusMessage::STATUS_CANCELING,
            Self::Succeeded => StatusMessage::STATUS_SUCCEEDED,
            Self::Canceled => StatusMessage::STATUS_CANCELED,
            Self::Aborted => StatusMessage::STATUS_ABORTED,
        }
    }

    /// The status with that number; unknown numbers become [`Unknown`](Self::Unknown).
    #[must_use]
    pub fn from_message(status: i8) -> Self {
        let all = [
            Self::Accepted,
            Self::Executing,
            Self::Canceling,
            Self::Succeeded,
            Self::Canceled,
            Self::Aborted,
        ];
        all.into_iter().find(|known| known.to_message() == status).unwrap_or_default()
    }

    /// The state after an event, if it is permitted in this state
    /// (`rcl_action/src/rcl_action/goal_state_machine.c`).
    pub(super) fn after(self, event: GoalEvent) -> Option<Self> {
        match (self, event) {
            (Self::Accepted, GoalEvent::Execute) => Some(Self::Executing),
            (Self::Accepted | Self::Executing, GoalEvent::Cancel) => Some(Self::Canceling),
            (Self::Executing | Self::Canceling, GoalEvent::Succeed) => Some(Self::Succeeded),
            (Self::Executing | Self::Canceling, GoalEvent::Abort) => Some(Self::Aborted),
            (Self::Canceling, GoalEvent::Canceled) => Some(Self::Canceled),
            _ => None,
        }
    }
}

impl fmt::Display for GoalStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Unknown => "unknown",
            Self::Accepted => "accepted",
            Self::Executing => "executing",
            Self::Canceling => "canceling",
            Self::Succeeded => "succeeded",
            Self::Canceled => "canceled",
            Self::Aborted => "aborted",
        })
    }
}

/// An event of a goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum GoalEvent {
    Execute,
    Cancel,
    Succeed,
    Abort,
    Canceled,
}

impl fmt::Display for GoalEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Execute => "executed",
            Self::Cancel => "canceled",
            Self::Succeed => "succeeded",
            Self::Abort => "aborted",
            Self::Canceled => "ended as canceled",
        })
    }
}

/// An operation on a goal failed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum GoalError {
    /// It was never accepted, or its result has expired.
    #[error("action \"{action}\": there is no goal {goal}; its result may have expired")]
    Unknown {
        /// The action.
        action: String,
        /// The goal.
        goal: GoalId,
    },
    /// Its status does not allow it.
    #[error("action \"{action}\": goal {goal} cannot be {asked}, it is {status}")]
    Status {
        /// The action.
        action: String,
        /// The goal.
        goal: GoalId,
        /// The requested operation.
        asked: String,
        /// Its status.
        status: GoalStatus,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_depend_on_all_their_inputs_and_are_reproducible() {
        let id = |module: &str, action: &str, time, number| {
            GoalId::new(module, action, Time::from_nanos(time), number)
        };
        let ids = [
            id("a", "walk", 1, 0),
            id("b", "walk", 1, 0),
            id("a", "wave", 1, 0),
            id("a", "walk", 2, 0),
            id("a", "walk", 1, 1),
            id("aw", "alk", 1, 0),
        ];
        for (index, one) in ids.iter().enumerate() {
            assert!(ids[..index].iter().all(|other| other != one));
        }
        assert_eq!(ids[0], id("a", "walk", 1, 0));
        let text = ids[0].to_string();
        assert!(text.len() == 32 && text[12..].starts_with('8'), "{text}");
    }

    #[test]
    fn a_goal_makes_the_transitions_of_rcl_action_and_no_others() {
        use GoalEvent::{Abort, Cancel, Canceled, Execute, Succeed};
        use GoalStatus as Status;
        let ways = [
            (Status::Accepted, Execute, Status::Executing),
            (Status::Accepted, Cancel, Status::Canceling),
            (Status::Executing, Cancel, Status::Canceling),
            (Status::Executing, Succeed, Status::Succeeded),
            (Status::Executing, Abort, Status::Aborted),
            (Status::Canceling, Succeed, Status::Succeeded),
            (Status::Canceling, Abort, Status::Aborted),
            (Status::Canceling, Canceled, Status::Canceled),
        ];
        for status in (0..7).map(Status::from_message) {
            for event in [Execute, Cancel, Succeed, Abort, Canceled] {
                let way = ways.iter().find(|(from, what, _)| (*from, *what) == (status, event));
                assert_eq!(status.after(event), way.map(|(_, _, to)| *to), "{status} {event}");
            }
            assert_eq!(status.is_active(), (1..4).contains(&status.to_message()));
        }
        assert_eq!(Status::from_message(77), Status::Unknown);
    }
}
