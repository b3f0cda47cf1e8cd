//! What the tests of several modules need.
#![allow(clippy::unwrap_used)]

use downbeat_executor::{
    Context, Core, ManualClock, Module, ModuleOptions, Received, Role, Setup, SetupError, Time,
};
use std::sync::{Arc, Mutex};

/// A core whose time stands still at 1000 s until it is set.
pub(crate) fn core_at_zero() -> (Core, ManualClock) {
    let clock = ManualClock::new(Time::from_nanos(1_000_000_000_000));
    (Core::new().with_clock(clock.clone()), clock)
}

/// All messages of a topic.
pub(crate) struct Collector<T> {
    messages: Arc<Mutex<Vec<T>>>,
}

struct CollectorModule<T> {
    topic: String,
    messages: Arc<Mutex<Vec<T>>>,
}

impl<T: Clone + Send + Sync + 'static> Collector<T> {
    /// Begins to collect.
    pub(crate) fn add(core: &mut Core, topic: &str) -> Self {
        let messages = Arc::default();
        let module = CollectorModule { topic: topic.to_owned(), messages: Arc::clone(&messages) };
        let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
        core.add_with(&format!("collector of {topic}"), module, options).unwrap();
        Self { messages }
    }

    /// What came since the last time.
    pub(crate) fn take(&self) -> Vec<T> {
        std::mem::take(&mut *self.messages.lock().unwrap())
    }
}

impl<T: Clone + Send + Sync + 'static> Module for CollectorModule<T> {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let topic = self.topic.clone();
        setup.subscribe(&topic, |module: &mut Self, message: Received<'_, T>, _: &mut Context<'_>| {
            module.messages.lock().unwrap().push(message.clone());
        })
    }
}
