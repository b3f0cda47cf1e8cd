//! What replayed modules publish.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use downbeat_bridge::edge::{Interfaces, KnownType};
use downbeat_executor::{self as executor, Core, Module, ModuleOptions, Role, Setup, SetupError, Time};
use downbeat_msgs::downbeat_interfaces::msg::ModuleEvent;

use crate::event_journal;

/// A message that a replayed module published.
pub(super) struct Replayed {
    /// Without the leading slash.
    pub(super) topic: Arc<str>,
    /// The time of the cycle that published it.
    pub(super) time: i64,
    pub(super) cdr: Bytes,
}

/// The messages that were published and not taken yet.
#[derive(Clone, Default)]
pub(super) struct Captured(Arc<Mutex<Contents>>);

#[derive(Default)]
struct Contents {
    messages: Vec<Replayed>,
    events: Vec<ModuleEvent>,
}

impl Captured {
    /// Adds a module to a core that captures what its modules publish on the topics that are wanted.
    pub(super) fn add(
        core: &mut Core,
        interfaces: &Interfaces,
        is_wanted: impl Fn(&str) -> bool,
    ) -> Result<Self, SetupError> {
        let captured = Self::default();
        let topics = core.topics().filter(|topic| topic.is_published && is_wanted(&topic.name));
        let topics = topics.filter_map(|topic| {
            Some((Arc::clone(&topic.name), interfaces.message_of(topic.message_type_id)?))
        });
        let watch = Watch { topics: topics.collect(), captured: captured.clone() };
        let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
        core.add_with("replay_watch", watch, options)?;
        Ok(captured)
    }

    pub(super) fn take(&self) -> Vec<Replayed> {
        std::mem::take(&mut self.lock().messages)
    }

    pub(super) fn take_events(&self) -> Vec<ModuleEvent> {
        std::mem::take(&mut self.lock().events)
    }

    fn lock(&self) -> MutexGuard<'_, Contents> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

struct Watch {
    topics: Vec<(Arc<str>, KnownType)>,
    captured: Captured,
}

impl Module for Watch {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        for (topic, message_type) in self.topics.drain(..) {
            let (captured, name) = (self.captured.clone(), Arc::clone(&topic));
            let sink = move |time: Time, cdr: Bytes| {
                let replayed = Replayed { topic: Arc::clone(&name), time: time.as_nanos(), cdr };
                captured.lock().messages.push(replayed);
            };
            message_type.subscribe(setup, &topic, sink)?;
        }
        setup.subscribe::<executor::ModuleEvent, _>(
            executor::ModuleEvent::TOPIC,
            |watch: &mut Self, event, _| {
                watch.captured.lock().events.push(event_journal::message(&event));
            },
        )
    }
}
