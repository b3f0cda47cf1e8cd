//! The life of a module: the states and transitions of ROS 2 managed nodes.

use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, Weak};

use crate::threads::unpoisoned;

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

/// What happens in the life of a module, see [`CoreHandle::on_transition`](crate::CoreHandle::on_transition).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LifeEvent {
    /// The module.
    pub module: Arc<str>,
    /// What happens.
    pub step: LifeStep,
}

/// A step in the life of a module.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LifeStep {
    /// A transition begins; its callback runs next. After a restart the first of them is from unconfigured.
    Begins {
        /// The transition.
        transition: Transition,
        /// The state it begins in.
        from: LifecycleState,
    },
    /// A transition was made.
    Made {
        /// The transition.
        transition: Transition,
        /// The state the module is in now.
        to: LifecycleState,
    },
    /// The module's callback said no.
    Failed {
        /// The transition.
        transition: Transition,
        /// The state the module has stayed in.
        state: LifecycleState,
    },
    /// A panic has ended the module, which is finalized now.
    Panicked {
        /// The transition in whose callback it was, if it was in one.
        transition: Option<Transition>,
        /// The state the module was in.
        from: LifecycleState,
    },
}

type Listener = dyn Fn(&LifeEvent) + Send + Sync;

/// A listener of transitions, until it is dropped.
#[must_use = "it stops listening when it is dropped"]
pub struct Listening {
    _listener: Arc<Listener>,
}

/// In the order in which they came.
#[derive(Default)]
pub(crate) struct Listeners {
    are_some: AtomicBool,
    listeners: Mutex<Vec<Weak<Listener>>>,
}

impl Listeners {
    pub(crate) fn add(&self, listener: impl Fn(&LifeEvent) + Send + Sync + 'static) -> Listening {
        let listener: Arc<Listener> = Arc::new(listener);
        unpoisoned(self.listeners.lock()).push(Arc::downgrade(&listener));
        self.are_some.store(true, Ordering::Release);
        Listening { _listener: listener }
    }

    pub(crate) fn report(&self, module: &Arc<str>, step: LifeStep) {
        if !self.are_some.load(Ordering::Acquire) {
            return;
        }
        let listeners: Vec<_> = {
            let mut listeners = unpoisoned(self.listeners.lock());
            listeners.retain(|listener| listener.strong_count() > 0);
            listeners.iter().filter_map(Weak::upgrade).collect()
        };
        let event = LifeEvent { module: Arc::clone(module), step };
        for listener in listeners {
            // A listener is no part of the module that is being run, and cannot end it.
            if catch_unwind(AssertUnwindSafe(|| listener(&event))).is_err() {
                tracing::error!(module = &**module, "a listener of its transitions panicked");
            }
        }
    }
}
