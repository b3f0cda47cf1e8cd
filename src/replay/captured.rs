//! What replayed modules publish.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use downbeat_edge::{CoreAccess, Interfaces};
use downbeat_executor::{self as executor, Core, Inbox, OutletInbox, Received, SetupError, Time};
use downbeat_msgs::downbeat_interfaces::msg::ModuleEvent;

use crate::journal;

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
    /// Captures what the modules of a core publish on the topics that are wanted.
    pub(super) fn add(
        core: &mut Core,
        interfaces: &Interfaces,
        is_wanted: impl Fn(&str) -> bool,
    ) -> Result<Self, SetupError> {
        let captured = Self::default();
        let topics = core.topics().filter(|topic| topic.is_published && is_wanted(&topic.name));
        let topics: Vec<_> = topics
            .filter_map(|topic| {
                Some((Arc::clone(&topic.name), interfaces.message_of(topic.message_type_id)?))
            })
            .collect();
        let inbox = OutletInbox::new("replay", Inbox::KeepAll);
        for (topic, message_type) in topics {
            let (captured, name) = (captured.clone(), Arc::clone(&topic));
            let sink = move |time: Time, cdr: Bytes| {
                let replayed = Replayed { topic: Arc::clone(&name), time: time.as_nanos(), cdr };
                captured.lock().messages.push(replayed);
            };
            message_type.outlet(&mut CoreAccess::Idle(core), &topic, &inbox, sink)?.keep();
        }
        let events = captured.clone();
        let note = move |event: Received<'_, executor::ModuleEvent>| {
            events.lock().events.push(journal::events::message(&event));
        };
        core.outlet(executor::ModuleEvent::TOPIC, &inbox, note)?.keep();
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
