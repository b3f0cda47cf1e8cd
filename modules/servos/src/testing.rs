//! Helpers for the tests of several modules.
#![allow(clippy::unwrap_used)]

use downbeat_executor::{Core, Inbox, ManualClock, Received, Time};
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

impl<T: Clone + Send + Sync + 'static> Collector<T> {
    /// Starts to collect.
    pub(crate) fn add(core: &mut Core, topic: &str) -> Self {
        let messages = Arc::<Mutex<Vec<T>>>::default();
        let collected = Arc::clone(&messages);
        let collect = move |message: Received<'_, T>| collected.lock().unwrap().push(message.clone());
        core.outlet(topic, Inbox::KeepAll, collect).unwrap().keep();
        Self { messages }
    }

    /// The messages since the last call.
    pub(crate) fn take(&self) -> Vec<T> {
        std::mem::take(&mut *self.messages.lock().unwrap())
    }
}
