//! Those who are told of transitions while they happen.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use crate::{LifecycleState, Transition};

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

/// Has transitions told until it is dropped.
#[must_use = "it ends when it is dropped"]
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
        self.lock().push(Arc::downgrade(&listener));
        self.are_some.store(true, Ordering::Release);
        Listening { _listener: listener }
    }

    pub(crate) fn tell(&self, module: &Arc<str>, step: LifeStep) {
        if !self.are_some.load(Ordering::Acquire) {
            return;
        }
        let listeners: Vec<_> = {
            let mut listeners = self.lock();
            listeners.retain(|listener| listener.strong_count() > 0);
            listeners.iter().filter_map(Weak::upgrade).collect()
        };
        let event = LifeEvent { module: Arc::clone(module), step };
        for listener in listeners {
            // A listener is no part of the module that is being run, and cannot end it.
            if catch_unwind(AssertUnwindSafe(|| listener(&event))).is_err() {
                tracing::error!(module = &**module, "who listens to its transitions panicked");
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Weak<Listener>>> {
        self.listeners.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
