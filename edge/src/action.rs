//! Types of actions.

use crate::{KnownService, KnownType, RawTypeError};
use downbeat_msgs::Action;
use downbeat_msgs::action_msgs::msg::GoalStatusArray;
use downbeat_msgs::action_msgs::srv::CancelGoal;
use downbeat_msgs::dynamic::{InterfaceDefinition, TypeLookupError};
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;

/// An action type of ROS 2, found through [`Interfaces`](crate::Interfaces) or by its Rust type
/// ([`KnownAction::of`]): the types of its three services and two topics.
#[derive(Clone, Copy)]
pub struct KnownAction {
    entry: &'static Entry,
}

impl KnownAction {
    /// The action type of a Rust type, which need not be registered.
    #[must_use]
    pub fn of<A: Action>() -> Self {
        Self { entry: Of::<A>::ENTRY }
    }

    /// An action of which only the definition is known.
    pub(crate) fn defined(definition: &InterfaceDefinition) -> Result<Self, RawTypeError> {
        // A hash is of the name too.
        static ACTIONS: Mutex<BTreeMap<&'static str, &'static Entry>> = Mutex::new(BTreeMap::new());
        if let Some(entry) = ACTIONS.lock().get(definition.hash.as_str()) {
            return Ok(Self { entry });
        }
        let name = definition.name.to_string();
        let unusable = |error: TypeLookupError| RawTypeError::Definition(Box::new(error));
        let send_goal = KnownService::defined(definition, &format!("{name}_SendGoal"))?;
        let get_result = KnownService::defined(definition, &format!("{name}_GetResult"))?;
        let feedback = definition.message(&format!("{name}_FeedbackMessage")).map_err(unusable)?;
        let feedback = KnownType::defined(feedback)?;
        let leak = |text: &str| -> &'static str { Box::leak(text.to_owned().into_boxed_str()) };
        let (hash, text) = (leak(&definition.hash), leak(&definition.text));
        let raw = Entry { name: leak(&name), hash, definition: text, send_goal, get_result, feedback };
        let mut actions = ACTIONS.lock();
        Ok(Self { entry: actions.entry(hash).or_insert_with(|| Box::leak(Box::new(raw))) })
    }

    /// As in `tf2_msgs/action/LookupTransform`.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.entry.name
    }

    /// `RIHS01_` and 64 hexadecimal digits.
    #[must_use]
    pub fn hash(self) -> &'static str {
        self.entry.hash
    }

    /// The definition text with all dependencies.
    #[must_use]
    pub fn definition(self) -> &'static str {
        self.entry.definition
    }

    /// The type of the service `send_goal`.
    #[must_use]
    pub fn send_goal(self) -> KnownService {
        self.entry.send_goal
    }

    /// The type of the service `cancel_goal`, which all actions share.
    #[must_use]
    pub fn cancel_goal(self) -> KnownService {
        KnownService::of::<CancelGoal>()
    }

    /// The type of the service `get_result`.
    #[must_use]
    pub fn get_result(self) -> KnownService {
        self.entry.get_result
    }

    /// The type of the topic `feedback`.
    #[must_use]
    pub fn feedback(self) -> KnownType {
        self.entry.feedback
    }

    /// The type of the topic `status`, which all actions share.
    #[must_use]
    pub fn status(self) -> KnownType {
        KnownType::of::<GoalStatusArray>()
    }
}

impl fmt::Debug for KnownAction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("KnownAction").field(&self.name()).finish()
    }
}

impl fmt::Display for KnownAction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl PartialEq for KnownAction {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name() && self.hash() == other.hash()
    }
}

impl Eq for KnownAction {}

struct Entry {
    name: &'static str,
    hash: &'static str,
    definition: &'static str,
    send_goal: KnownService,
    get_result: KnownService,
    feedback: KnownType,
}

/// Holds the entry of a type as a constant, so that a handle is a reference to it.
struct Of<A>(PhantomData<A>);

impl<A: Action> Of<A> {
    const ENTRY: &'static Entry = &Entry {
        name: A::TYPE_NAME,
        hash: A::TYPE_HASH,
        definition: A::DEFINITION,
        send_goal: KnownService::of::<A::SendGoal>(),
        get_result: KnownService::of::<A::GetResult>(),
        feedback: KnownType::of::<A::FeedbackMessage>(),
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use downbeat_msgs::tf2_msgs::action::LookupTransform;

    #[test]
    fn an_action_has_the_types_of_its_parts() {
        let action = KnownAction::of::<LookupTransform>();
        assert_eq!(action.send_goal().name(), "tf2_msgs/action/LookupTransform_SendGoal");
        assert_eq!(action.get_result().name(), "tf2_msgs/action/LookupTransform_GetResult");
        assert_eq!(action.feedback().name(), "tf2_msgs/action/LookupTransform_FeedbackMessage");
    }
}
