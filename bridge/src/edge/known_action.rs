//! The registry of action types.

use super::nearest::nearest;
use super::{KnownService, KnownType};
use downbeat_executor::ServiceInfo;
use downbeat_msgs::{Action, Message, Service};
use std::fmt;
use thiserror::Error;

/// An action type of ROS 2 that this program was compiled with: the types of its three services and two topics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KnownAction {
    name: &'static str,
    hash: &'static str,
    send_goal: KnownService,
    cancel_goal: KnownService,
    get_result: KnownService,
    feedback: KnownType,
    status: KnownType,
}

/// A type name that no action has.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("unknown action type {name:?}, did you mean {nearest:?}?")]
pub struct UnknownAction {
    /// The name that was looked for.
    pub name: String,
    /// The name most like it.
    pub nearest: &'static str,
}

impl KnownAction {
    /// The type of that name, such as `tf2_msgs/action/LookupTransform`.
    ///
    /// # Errors
    /// [`UnknownAction`] with the nearest name where there is none.
    pub fn named(name: &str) -> Result<Self, UnknownAction> {
        let entry = ENTRIES.iter().find(|entry| entry.name == name);
        entry.and_then(Self::of_entry).ok_or_else(|| UnknownAction {
            name: name.to_owned(),
            nearest: nearest(name, ENTRIES.iter().map(|entry| entry.name)),
        })
    }

    /// The type of an action of a core, by its service `send_goal`.
    #[must_use]
    pub fn of_send_goal(service: &ServiceInfo) -> Option<Self> {
        let send_goal = KnownService::of(service)?;
        ENTRIES.iter().find(|entry| entry.send_goal == send_goal.name()).and_then(Self::of_entry)
    }

    /// As in `tf2_msgs/action/LookupTransform`.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.name
    }

    /// `RIHS01_` and 64 hexadecimal digits.
    #[must_use]
    pub fn hash(self) -> &'static str {
        self.hash
    }

    /// The type of the service `send_goal`.
    #[must_use]
    pub fn send_goal(self) -> KnownService {
        self.send_goal
    }

    /// The type of the service `cancel_goal`, which all actions share.
    #[must_use]
    pub fn cancel_goal(self) -> KnownService {
        self.cancel_goal
    }

    /// The type of the service `get_result`.
    #[must_use]
    pub fn get_result(self) -> KnownService {
        self.get_result
    }

    /// The type of the topic `feedback`.
    #[must_use]
    pub fn feedback(self) -> KnownType {
        self.feedback
    }

    /// The type of the topic `status`, which all actions share.
    #[must_use]
    pub fn status(self) -> KnownType {
        self.status
    }

    /// Nothing only where the program has no package `action_msgs`.
    fn of_entry(entry: &Entry) -> Option<Self> {
        Some(Self {
            name: entry.name,
            hash: entry.hash,
            send_goal: KnownService::named(entry.send_goal).ok()?,
            cancel_goal: KnownService::named("action_msgs/srv/CancelGoal").ok()?,
            get_result: KnownService::named(entry.get_result).ok()?,
            feedback: KnownType::named(entry.feedback).ok()?,
            status: KnownType::named("action_msgs/msg/GoalStatusArray").ok()?,
        })
    }
}

impl fmt::Display for KnownAction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

struct Entry {
    name: &'static str,
    hash: &'static str,
    send_goal: &'static str,
    get_result: &'static str,
    feedback: &'static str,
}

const fn entry<A: Action>() -> Entry {
    Entry {
        name: A::TYPE_NAME,
        hash: A::TYPE_HASH,
        send_goal: <A::SendGoal as Service>::TYPE_NAME,
        get_result: <A::GetResult as Service>::TYPE_NAME,
        feedback: <A::FeedbackMessage as Message>::TYPE_NAME,
    }
}

macro_rules! entries {
    ($($action:ty),* $(,)?) => {
        static ENTRIES: &[Entry] = &[$(entry::<$action>()),*];
    };
}
downbeat_msgs::for_each_action!(entries);

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn an_action_is_found_by_its_name_with_the_types_of_its_parts() {
        let action = KnownAction::named("tf2_msgs/action/LookupTransform").unwrap();
        assert_eq!(action.send_goal().name(), "tf2_msgs/action/LookupTransform_SendGoal");
        assert_eq!(action.get_result().name(), "tf2_msgs/action/LookupTransform_GetResult");
        assert_eq!(action.feedback().name(), "tf2_msgs/action/LookupTransform_FeedbackMessage");
        let error = KnownAction::named("tf2_msgs/LookupTransform").unwrap_err();
        assert_eq!(error.nearest, "tf2_msgs/action/LookupTransform");
    }
}
