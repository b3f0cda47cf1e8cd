//! The life of a module: the states and transitions of ROS 2 managed nodes.

use std::fmt;
use std::sync::Arc;

/// The state of a module, with the meaning of the ROS 2 lifecycle
/// (<https://design.ros2.org/articles/node_lifecycle.html>).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum LifecycleState {
    /// Set up, not yet configured. Runs nothing but transitions.
    Unconfigured,
    /// Configured. Runs nothing but transitions: messages pass it by, requests are refused.
    Inactive,
    /// Runs.
    #[default]
    Active,
    /// At its end: shut down, or stopped by a panic.
    Finalized,
}

impl fmt::Display for LifecycleState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Unconfigured => "unconfigured",
            Self::Inactive => "inactive",
            Self::Active => "active",
            Self::Finalized => "finalized",
        })
    }
}

/// A step from one state to another; each has a callback in [`Module`](crate::Module).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Transition {
    /// Unconfigured to inactive.
    Configure,
    /// Inactive to active.
    Activate,
    /// Active to inactive.
    Deactivate,
    /// Inactive to unconfigured.
    Cleanup,
    /// From every state to finalized.
    Shutdown,
}

impl Transition {
    /// The state it leads to, or nothing if it does not begin in `from`.
    #[must_use]
    pub fn from(self, from: LifecycleState) -> Option<LifecycleState> {
        use LifecycleState as State;
        match (self, from) {
            (Self::Configure, State::Unconfigured) | (Self::Deactivate, State::Active) => {
                Some(State::Inactive)
            }
            (Self::Activate, State::Inactive) => Some(State::Active),
            (Self::Cleanup, State::Inactive) => Some(State::Unconfigured),
            (Self::Shutdown, State::Unconfigured | State::Inactive | State::Active) => Some(State::Finalized),
            _ => None,
        }
    }
}

impl fmt::Display for Transition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Configure => "configure",
            Self::Activate => "activate",
            Self::Deactivate => "deactivate",
            Self::Cleanup => "cleanup",
            Self::Shutdown => "shutdown",
        })
    }
}

/// Why a module does not make a transition; it stays in the state it was in.
///
/// Every error becomes one, so that `?` works in the callbacks.
#[derive(Debug)]
pub struct TransitionError(String);

impl TransitionError {
    /// A reason in words.
    #[must_use]
    pub fn new(reason: impl Into<String>) -> Self {
        Self(reason.into())
    }
}

impl fmt::Display for TransitionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl<E: std::error::Error> From<E> for TransitionError {
    fn from(error: E) -> Self {
        Self(error.to_string())
    }
}

/// Why a module did not make a transition.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TransitionRefused {
    /// The transition does not begin in the module's state.
    #[error("module \"{module}\" is {state}: {transition} is not possible from there")]
    WrongState {
        /// The module.
        module: Arc<str>,
        /// The transition.
        transition: Transition,
        /// The state the module is in.
        state: LifecycleState,
    },
    /// The module's callback said no.
    #[error("module \"{module}\" stays {state}: {transition} failed: {reason}")]
    ByModule {
        /// The module.
        module: Arc<str>,
        /// The transition.
        transition: Transition,
        /// The state the module is in.
        state: LifecycleState,
        /// What the module said.
        reason: String,
    },
    /// The module's callback panicked.
    #[error("module \"{module}\" panicked in {transition}")]
    Panicked {
        /// The module.
        module: Arc<str>,
        /// The transition.
        transition: Transition,
    },
    /// There is no such module.
    #[error("there is no module \"{module}\"")]
    UnknownModule {
        /// The name that was given.
        module: Arc<str>,
    },
}
