//! The states and transitions of rcl_lifecycle, and where a module is among them.
//!
//! Ids, labels and the order in which services list them are those of
//! `rcl_lifecycle/src/default_state_machine.c`.

use downbeat_executor::{LifeStep, LifecycleState, Transition};
use downbeat_msgs::lifecycle_msgs::msg::{
    State as StateMessage, Transition as TransitionMessage, TransitionDescription,
};

/// A state: primary, or of a transition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RosState {
    id: u8,
    label: &'static str,
}

const UNKNOWN: RosState = RosState { id: StateMessage::PRIMARY_STATE_UNKNOWN, label: "unknown" };
const UNCONFIGURED: RosState =
    RosState { id: StateMessage::PRIMARY_STATE_UNCONFIGURED, label: "unconfigured" };
const INACTIVE: RosState = RosState { id: StateMessage::PRIMARY_STATE_INACTIVE, label: "inactive" };
const ACTIVE: RosState = RosState { id: StateMessage::PRIMARY_STATE_ACTIVE, label: "active" };
const FINALIZED: RosState = RosState { id: StateMessage::PRIMARY_STATE_FINALIZED, label: "finalized" };
const CONFIGURING: RosState =
    RosState { id: StateMessage::TRANSITION_STATE_CONFIGURING, label: "configuring" };
const CLEANING_UP: RosState = RosState { id: StateMessage::TRANSITION_STATE_CLEANINGUP, label: "cleaningup" };
const SHUTTING_DOWN: RosState =
    RosState { id: StateMessage::TRANSITION_STATE_SHUTTINGDOWN, label: "shuttingdown" };
const ACTIVATING: RosState = RosState { id: StateMessage::TRANSITION_STATE_ACTIVATING, label: "activating" };
const DEACTIVATING: RosState =
    RosState { id: StateMessage::TRANSITION_STATE_DEACTIVATING, label: "deactivating" };
const ERROR_PROCESSING: RosState =
    RosState { id: StateMessage::TRANSITION_STATE_ERRORPROCESSING, label: "errorprocessing" };

/// All states.
pub(super) const STATES: [RosState; 11] = [
    UNKNOWN,
    UNCONFIGURED,
    INACTIVE,
    ACTIVE,
    FINALIZED,
    CONFIGURING,
    CLEANING_UP,
    SHUTTING_DOWN,
    ACTIVATING,
    DEACTIVATING,
    ERROR_PROCESSING,
];

/// A transition of rcl, of which a transition of a module makes two: one in, one out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RosTransition {
    id: u8,
    label: &'static str,
    start: RosState,
    goal: RosState,
}

const fn to(id: u8, label: &'static str, start: RosState, goal: RosState) -> RosTransition {
    RosTransition { id, label, start, goal }
}

const SUCCESS: &str = "transition_success";
const FAILURE: &str = "transition_failure";
const ERROR: &str = "transition_error";

/// All transitions.
#[rustfmt::skip] // One a line.
pub(super) const TRANSITIONS: [RosTransition; 25] = [
    to(TransitionMessage::TRANSITION_CONFIGURE, "configure", UNCONFIGURED, CONFIGURING),
    to(TransitionMessage::TRANSITION_ON_CONFIGURE_SUCCESS, SUCCESS, CONFIGURING, INACTIVE),
    to(TransitionMessage::TRANSITION_ON_CONFIGURE_FAILURE, FAILURE, CONFIGURING, UNCONFIGURED),
    to(TransitionMessage::TRANSITION_ON_CONFIGURE_ERROR, ERROR, CONFIGURING, ERROR_PROCESSING),
    to(TransitionMessage::TRANSITION_CLEANUP, "cleanup", INACTIVE, CLEANING_UP),
    to(TransitionMessage::TRANSITION_ON_CLEANUP_SUCCESS, SUCCESS, CLEANING_UP, UNCONFIGURED),
    to(TransitionMessage::TRANSITION_ON_CLEANUP_FAILURE, FAILURE, CLEANING_UP, INACTIVE),
    to(TransitionMessage::TRANSITION_ON_CLEANUP_ERROR, ERROR, CLEANING_UP, ERROR_PROCESSING),
    to(TransitionMessage::TRANSITION_ACTIVATE, "activate", INACTIVE, ACTIVATING),
    to(TransitionMessage::TRANSITION_ON_ACTIVATE_SUCCESS, SUCCESS, ACTIVATING, ACTIVE),
    to(TransitionMessage::TRANSITION_ON_ACTIVATE_FAILURE, FAILURE, ACTIVATING, INACTIVE),
    to(TransitionMessage::TRANSITION_ON_ACTIVATE_ERROR, ERROR, ACTIVATING, ERROR_PROCESSING),
    to(TransitionMessage::TRANSITION_DEACTIVATE, "deactivate", ACTIVE, DEACTIVATING),
    to(TransitionMessage::TRANSITION_ON_DEACTIVATE_SUCCESS, SUCCESS, DEACTIVATING, INACTIVE),
    to(TransitionMessage::TRANSITION_ON_DEACTIVATE_FAILURE, FAILURE, DEACTIVATING, ACTIVE),
    to(TransitionMessage::TRANSITION_ON_DEACTIVATE_ERROR, ERROR, DEACTIVATING, ERROR_PROCESSING),
    to(TransitionMessage::TRANSITION_UNCONFIGURED_SHUTDOWN, "shutdown", UNCONFIGURED, SHUTTING_DOWN),
    to(TransitionMessage::TRANSITION_INACTIVE_SHUTDOWN, "shutdown", INACTIVE, SHUTTING_DOWN),
    to(TransitionMessage::TRANSITION_ACTIVE_SHUTDOWN, "shutdown", ACTIVE, SHUTTING_DOWN),
    to(TransitionMessage::TRANSITION_ON_SHUTDOWN_SUCCESS, SUCCESS, SHUTTING_DOWN, FINALIZED),
    to(TransitionMessage::TRANSITION_ON_SHUTDOWN_FAILURE, FAILURE, SHUTTING_DOWN, FINALIZED),
    to(TransitionMessage::TRANSITION_ON_SHUTDOWN_ERROR, ERROR, SHUTTING_DOWN, ERROR_PROCESSING),
    to(TransitionMessage::TRANSITION_ON_ERROR_SUCCESS, SUCCESS, ERROR_PROCESSING, UNCONFIGURED),
    to(TransitionMessage::TRANSITION_ON_ERROR_FAILURE, FAILURE, ERROR_PROCESSING, FINALIZED),
    to(TransitionMessage::TRANSITION_ON_ERROR_ERROR, ERROR, ERROR_PROCESSING, FINALIZED),
];

impl RosState {
    pub(super) fn to_message(self) -> StateMessage {
        StateMessage { id: self.id, label: self.label.to_owned() }
    }

    pub(super) fn is_active(self) -> bool {
        self == ACTIVE
    }

    pub(super) fn label(self) -> &'static str {
        self.label
    }

    /// The transitions that begin in it.
    pub(super) fn transitions(self) -> impl Iterator<Item = RosTransition> {
        TRANSITIONS.into_iter().filter(move |transition| transition.start == self)
    }

    /// The state that a module passes through.
    fn during(transition: Transition) -> Self {
        match transition {
            Transition::Configure => CONFIGURING,
            Transition::Activate => ACTIVATING,
            Transition::Deactivate => DEACTIVATING,
            Transition::Cleanup => CLEANING_UP,
            Transition::Shutdown => SHUTTING_DOWN,
        }
    }
}

impl From<LifecycleState> for RosState {
    fn from(state: LifecycleState) -> Self {
        match state {
            LifecycleState::Unconfigured => UNCONFIGURED,
            LifecycleState::Inactive => INACTIVE,
            LifecycleState::Active => ACTIVE,
            LifecycleState::Finalized => FINALIZED,
        }
    }
}

impl RosTransition {
    pub(super) fn to_message(self) -> TransitionDescription {
        TransitionDescription {
            transition: TransitionMessage { id: self.id, label: self.label.to_owned() },
            start_state: self.start.to_message(),
            goal_state: self.goal.to_message(),
        }
    }

    /// What a module is requested to do; `None` for a transition that ends such a request.
    pub(super) fn of_module(self) -> Option<Transition> {
        match self.goal {
            CONFIGURING => Some(Transition::Configure),
            ACTIVATING => Some(Transition::Activate),
            DEACTIVATING => Some(Transition::Deactivate),
            CLEANING_UP => Some(Transition::Cleanup),
            SHUTTING_DOWN => Some(Transition::Shutdown),
            _ => None,
        }
    }

    /// The transition that a request means in a state: by its label if there is one, otherwise by its id, as
    /// in rclcpp.
    pub(super) fn requested(request: &TransitionMessage, state: RosState) -> Option<Self> {
        state.transitions().find(|transition| match request.label.as_str() {
            "" => transition.id == request.id,
            label => transition.label == label,
        })
    }
}

/// The state of a module.
pub(super) struct Track {
    now: RosState,
}

impl Track {
    pub(super) fn new(state: LifecycleState) -> Self {
        Self { now: state.into() }
    }

    pub(super) fn now(&self) -> RosState {
        self.now
    }

    /// Goes on by a step; returns the transitions of rcl that it takes, from and to.
    ///
    /// A module that says no has failed, and one that panics is in error: what an rclcpp node is that answers
    /// `FAILURE` or throws. Only a restart ends that error, and no transition describes it.
    pub(super) fn follow(&mut self, step: LifeStep) -> Vec<(RosState, RosState)> {
        let path = match step {
            LifeStep::Begins { transition, from } => vec![from.into(), RosState::during(transition)],
            LifeStep::Made { transition, to } => vec![RosState::during(transition), to.into()],
            LifeStep::Failed { transition, state } => vec![RosState::during(transition), state.into()],
            LifeStep::Panicked { transition, from } => {
                vec![transition.map_or(from.into(), RosState::during), ERROR_PROCESSING, FINALIZED]
            }
        };
        self.now = path.last().copied().unwrap_or(self.now);
        path.iter().copied().zip(path.iter().copied().skip(1)).collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn request(id: u8, label: &str) -> TransitionMessage {
        TransitionMessage { id, label: label.to_owned() }
    }

    #[test]
    fn a_request_is_understood_by_its_label_before_its_id_and_only_where_it_can_begin() {
        let of = |request: TransitionMessage, state| {
            RosTransition::requested(&request, state).and_then(RosTransition::of_module)
        };
        assert_eq!(of(request(1, ""), UNCONFIGURED), Some(Transition::Configure));
        assert_eq!(of(request(1, "shutdown"), UNCONFIGURED), Some(Transition::Shutdown));
        assert_eq!(of(request(5, ""), UNCONFIGURED), Some(Transition::Shutdown));
        assert_eq!(of(request(0, "cleanup"), INACTIVE), Some(Transition::Cleanup));
        for (refused, state) in [
            (request(3, ""), UNCONFIGURED),
            (request(0, ""), UNCONFIGURED),
            (request(5, ""), ACTIVE),
            (request(1, "no such thing"), UNCONFIGURED),
            (request(1, ""), FINALIZED),
            (request(10, ""), CONFIGURING),
        ] {
            assert_eq!(of(refused, state), None);
        }
    }

    #[test]
    fn every_step_of_a_module_is_a_way_through_the_graph() {
        let mut track = Track::new(LifecycleState::Unconfigured);
        let steps = [
            LifeStep::Begins { transition: Transition::Configure, from: LifecycleState::Unconfigured },
            LifeStep::Failed { transition: Transition::Configure, state: LifecycleState::Unconfigured },
            LifeStep::Begins { transition: Transition::Configure, from: LifecycleState::Unconfigured },
            LifeStep::Made { transition: Transition::Configure, to: LifecycleState::Inactive },
            LifeStep::Begins { transition: Transition::Activate, from: LifecycleState::Inactive },
            LifeStep::Panicked { transition: Some(Transition::Activate), from: LifecycleState::Inactive },
        ];
        let taken: Vec<_> = steps.into_iter().flat_map(|step| track.follow(step)).collect();
        assert_eq!(taken.len(), 7);
        for (start, goal) in taken {
            let is_it = |transition: &RosTransition| transition.start == start && transition.goal == goal;
            assert!(TRANSITIONS.iter().any(is_it), "{start:?} to {goal:?}");
        }
        assert_eq!(track.now(), FINALIZED);
    }
}
