//! The part of the bridge that is a module of the executor: it sends out what it subscribes to.

use super::limit::{Limiter, OfACycle};
use super::status::Traffic;
use crate::edge::{KnownType, Offered, Sink};
use crate::ros::Publisher;
use bytes::Bytes;
use downbeat_executor::{Context, Inbox, Module, ModuleOptions, Role, Setup, SetupError, Synchrony, Time};
use downbeat_msgs::qos::Durability;
use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The name under which the bridge joins a core. What is exposed while the core runs has modules of its own,
/// `bridge.1` and so on.
pub const MODULE_NAME: &str = "bridge";

/// Batches that wait while the bridge is busy: 8 s at 125 Hz. Older ones are dropped.
const INBOX: NonZeroUsize = NonZeroUsize::new(1000).unwrap();

/// How the bridge's modules join a core.
pub(super) fn options() -> ModuleOptions {
    ModuleOptions {
        synchrony: Synchrony::Detached(Inbox::KeepLast(INBOX)),
        role: Role::Observer,
        ..ModuleOptions::default()
    }
}

/// Subscribes to the topics of its slots.
pub(super) struct Sender {
    pub(super) slots: Vec<Arc<Slot>>,
    /// Told when the module ends.
    pub(super) on_end: Box<dyn Fn() + Send>,
}

impl Module for Sender {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        for slot in &self.slots {
            slot.message_type.subscribe(setup, &slot.topic, ToRos(Arc::clone(slot)))?;
        }
        Ok(())
    }

    fn shutdown(&mut self, _ctx: &mut Context<'_>) {
        self.slots.iter().for_each(|slot| drop(slot.close()));
        (self.on_end)();
    }
}

/// A subscription of the executor, and the publisher that it feeds, if there is one at the moment: a subscription lasts
/// as long as its module, a publisher comes and goes.
pub(super) struct Slot {
    pub(super) topic: String,
    pub(super) message_type: KnownType,
    outlet: Mutex<Option<Outlet>>,
}

/// What a subscription feeds.
pub(super) struct Outlet {
    pub(super) publisher: Arc<Publisher>,
    pub(super) traffic: Arc<Traffic>,
    pub(super) limiter: Limiter,
    pub(super) of_a_cycle: OfACycle,
}

impl Slot {
    pub(super) fn new(topic: &str, message_type: KnownType, outlet: Outlet) -> Self {
        Self { topic: topic.to_owned(), message_type, outlet: Mutex::new(Some(outlet)) }
    }

    pub(super) fn open(&self, outlet: Outlet) {
        *self.lock() = Some(outlet);
    }

    /// Takes the publisher away, when the message that is being sent is sent.
    pub(super) fn close(&self) -> Option<Outlet> {
        self.lock().take()
    }

    fn lock(&self) -> MutexGuard<'_, Option<Outlet>> {
        self.outlet.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

struct ToRos(Arc<Slot>);

impl Sink for ToRos {
    fn is_wanted(&mut self, message: Offered) -> bool {
        self.0.lock().as_mut().is_some_and(|outlet| outlet.wants(message))
    }

    fn take(&mut self, _time: Time, cdr: Bytes) {
        if let Some(outlet) = self.0.lock().as_ref() {
            outlet.send(cdr);
        }
    }
}

impl Outlet {
    fn wants(&mut self, message: Offered) -> bool {
        self.traffic.count_dropped(message.missed);
        let is_too_old = self.of_a_cycle == OfACycle::Latest && !message.is_last_of_cycle;
        if is_too_old || !self.limiter.lets_pass(message.time) {
            self.traffic.count_limited();
            return false;
        }
        let is_latched = self.publisher.qos().durability == Durability::TransientLocal;
        let is_wanted = is_latched || self.publisher.matched_subscriptions() > 0;
        if !is_wanted {
            self.traffic.count_skipped();
        }
        is_wanted
    }

    fn send(&self, cdr: Bytes) {
        let result = self.publisher.publish(cdr);
        if self.traffic.count(&result)
            && let Err(error) = result
        {
            let topic = self.publisher.topic().as_str();
            tracing::warn!(topic, %error, "a message was not sent; from now on this is only counted");
        }
    }
}
