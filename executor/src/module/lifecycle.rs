//! The lifecycle of modules: states and transitions as of ROS 2 managed nodes.

use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, Weak};

use crate::threads::unpoisoned;

/// The state of a module, with the meaning of the ROS 2 lifecycle
/// (<https://design.ros2.org/articles/node_lifecycle.html>).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum LifecycleState {
    /// Set up, not yet configured. Only transitions run.
    Unconfigured,
    /// Configured. Only transitions run; messages are dropped, requests are refused.
    Inactive,
    /// Running.
    #[default]
    Active,
    /// Ended by a shutdown or a panic.
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

/// A transition between states; each has a callback in [`Module`](crate::Module).
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
    /// The target state, or `None` if the transition does not begin in `from`.
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

/// The error of a transition callback. The module stays in its state.
///
/// Every error type converts into it, so that `?` works in the callbacks.
#[derive(Debug)]
pub struct TransitionError(String);

impl TransitionError {
    /// An error with this text.
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

/// The reason why a module did not make a transition.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TransitionRefused {
    /// The transition does not begin in the module's state.
    #[error("module \"{module}\" is {state}: {transition} is not possible from there")]
    WrongState {
        /// The module.
        module: Arc<str>,
        /// The transition.
        transition: Transition,
        /// The current state of the module.
        state: LifecycleState,
    },
    /// The module's callback returned an error.
    #[error("module \"{module}\" stays {state}: {transition} failed: {reason}")]
    ByModule {
        /// The module.
        module: Arc<str>,
        /// The transition.
        transition: Transition,
        /// The current state of the module.
        state: LifecycleState,
        /// The error text of the module.
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
    /// The core has no module of this name.
    #[error("there is no module \"{module}\"")]
    UnknownModule {
        /// The given name.
        module: Arc<str>,
    },
}

/// An event in the lifecycle of a module, see
/// [`CoreHandle::on_transition`](crate::CoreHandle::on_transition).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LifeEvent {
    /// The module.
    pub module: Arc<str>,
    /// The kind of the event.
    pub step: LifeStep,
}

/// A step in the lifecycle of a module.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LifeStep {
    /// A transition begins; its callback runs next. The first transition after a restart begins in the
    /// unconfigured state.
    Begins {
        /// The transition.
        transition: Transition,
        /// The state before the transition.
        from: LifecycleState,
    },
    /// A transition was made.
    Made {
        /// The transition.
        transition: Transition,
        /// The new state of the module.
        to: LifecycleState,
    },
    /// The module's callback returned an error.
    Failed {
        /// The transition.
        transition: Transition,
        /// The state in which the module stays.
        state: LifecycleState,
    },
    /// A panic has ended the module, whose state is now finalized.
    Panicked {
        /// The transition whose callback panicked; `None` for another callback.
        transition: Option<Transition>,
        /// The previous state of the module.
        from: LifecycleState,
    },
}

type Listener = dyn Fn(&LifeEvent) + Send + Sync;

/// Registration of a listener of transitions, which ends when this is dropped.
#[must_use = "the listener is removed when this is dropped"]
pub struct Listening {
    _listener: Arc<Listener>,
}

/// The listeners, in the order of registration.
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
            // A panic of a listener does not end the module, since the listener is not part of it.
            if catch_unwind(AssertUnwindSafe(|| listener(&event))).is_err() {
                tracing::error!(module = &**module, "a listener of its transitions panicked");
            }
        }
    }
}
