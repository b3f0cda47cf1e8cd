//! The endpoints of a bridge: what goes through them, and what they report.

use super::endpoint::ExposedEndpoint;
use super::exposure::{ExposeError, Limiter, OfACycle};
use super::qos_events::{EndpointQos, QosCounts};
use crate::edge::{EncodedInlet, EncodedInletError, Offered, Sink};
use crate::middleware::Sample;
use crate::ros::{Publisher, Subscription};
use bytes::Bytes;
use downbeat_executor::{Clock, InletError, Outlet, OutletGate, Time};
use downbeat_msgs::qos::Durability;
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};

/// An exposed endpoint at one moment.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EndpointReport {
    /// The endpoint.
    #[serde(flatten)]
    pub endpoint: ExposedEndpoint,
    /// What went through it.
    pub traffic: EndpointTraffic,
}

/// What went through an endpoint so far.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EndpointTraffic {
    /// Matched endpoints of others; 0 after the bridge has stopped.
    pub matched: usize,
    /// Messages that went through.
    pub messages: u64,
    /// Messages that were not serialized since no endpoint was matched.
    pub skipped: u64,
    /// Messages that the limits held back.
    pub limited: u64,
    /// Messages that the bounded inbox of the bridge dropped because the bridge was busy.
    pub dropped: u64,
    /// Messages that failed to go through.
    pub errors: u64,
    /// The last reason for that.
    pub last_error: Option<String>,
    /// Events of the quality of service.
    pub qos: QosCounts,
}

/// Reports the exposed endpoints. Clones report the same. It keeps no endpoint alive.
#[derive(Clone, Default)]
pub struct BridgeStatus {
    endpoints: Arc<Endpoints>,
}

impl fmt::Display for EndpointReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let EndpointTraffic { matched, messages, limited, errors, .. } = self.traffic;
        write!(f, "{}, {matched} matched, {messages} messages", self.endpoint)?;
        for (count, what) in [(limited, "held back"), (errors, "failed")] {
            if count > 0 {
                write!(f, ", {count} {what}")?;
            }
        }
        Ok(())
    }
}

impl BridgeStatus {
    pub(super) fn new(endpoints: Arc<Endpoints>) -> Self {
        Self { endpoints }
    }

    /// The endpoints, in the order in which they were exposed.
    #[must_use]
    pub fn endpoints(&self) -> Vec<EndpointReport> {
        self.endpoints.state.lock().exposed.iter().map(Exposed::report).collect()
    }
}

/// All endpoints of a bridge, in the order in which they were exposed.
#[derive(Default)]
pub(super) struct Endpoints {
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    has_ended: bool,
    exposed: Vec<Exposed>,
}

/// An endpoint, and what keeps it alive.
pub(super) struct Exposed {
    pub(super) endpoint: ExposedEndpoint,
    pub(super) traffic: Arc<Traffic>,
    pub(super) events: Arc<EndpointQos>,
    /// `None` after the core has stopped.
    pub(super) held: Option<Held>,
}

pub(super) enum Held {
    /// The sink of the outlet owns the publisher.
    Out(Weak<Publisher>, #[expect(dead_code, reason = "held until it is dropped")] Outlet),
    In(Arc<Subscription>),
}

impl Exposed {
    pub(super) fn report(&self) -> EndpointReport {
        let matched = match &self.held {
            Some(Held::Out(publisher, _)) => publisher.upgrade().map_or(0, |p| p.matched_subscriptions()),
            Some(Held::In(subscription)) => subscription.matched_publishers(),
            None => 0,
        };
        let traffic = EndpointTraffic { matched, qos: self.events.counts(), ..self.traffic.report() };
        EndpointReport { endpoint: self.endpoint.clone(), traffic }
    }
}

impl Endpoints {
    pub(super) fn any(&self, is: impl Fn(&ExposedEndpoint) -> bool) -> bool {
        self.state.lock().exposed.iter().any(|exposed| is(&exposed.endpoint))
    }

    /// The first answer that is not `None`.
    pub(super) fn find<T>(&self, look: impl Fn(&ExposedEndpoint) -> Option<T>) -> Option<T> {
        self.state.lock().exposed.iter().find_map(|exposed| look(&exposed.endpoint))
    }

    pub(super) fn extend(&self, exposed: Vec<Exposed>) -> Result<(), ExposeError> {
        let mut state = self.state.lock();
        if state.has_ended {
            return Err(ExposeError::Stopped);
        }
        state.exposed.extend(exposed);
        Ok(())
    }

    /// Removes endpoints. Returns their last reports.
    pub(super) fn remove(&self, is_meant: impl Fn(&ExposedEndpoint) -> bool) -> Vec<EndpointReport> {
        let removed: Vec<_> =
            self.state.lock().exposed.extract_if(.., |exposed| is_meant(&exposed.endpoint)).collect();
        // Dropped without the lock: that may take until a message is sent or taken.
        removed.iter().map(Exposed::report).collect()
    }

    /// Drops all endpoints when the core stops; they are still reported.
    pub(super) fn close(&self) {
        let held: Vec<_> = {
            let mut state = self.state.lock();
            state.has_ended = true;
            state.exposed.iter_mut().map(|exposed| exposed.held.take()).collect()
        };
        drop(held);
    }
}

/// Counts what goes through an endpoint. Only errors take a lock.
#[derive(Default)]
pub(super) struct Traffic {
    messages: AtomicU64,
    skipped: AtomicU64,
    limited: AtomicU64,
    dropped: AtomicU64,
    errors: AtomicU64,
    last_error: Mutex<Option<String>>,
}

impl Traffic {
    /// Messages and errors.
    pub(super) fn totals(&self) -> (u64, u64) {
        (self.messages.load(Ordering::Relaxed), self.errors.load(Ordering::Relaxed))
    }

    /// Why something failed the last time.
    pub(super) fn last_error(&self) -> Option<String> {
        self.last_error.lock().clone()
    }

    /// Counts the message or the error; true for the first error, which is worth a log line.
    pub(super) fn count<E: fmt::Display>(&self, result: &Result<(), E>) -> bool {
        match result {
            Ok(()) => {
                self.messages.fetch_add(1, Ordering::Relaxed);
                false
            }
            Err(error) => {
                *self.last_error.lock() = Some(error.to_string());
                self.errors.fetch_add(1, Ordering::Relaxed) == 0
            }
        }
    }

    fn report(&self) -> EndpointTraffic {
        EndpointTraffic {
            messages: self.messages.load(Ordering::Relaxed),
            skipped: self.skipped.load(Ordering::Relaxed),
            limited: self.limited.load(Ordering::Relaxed),
            dropped: self.dropped.load(Ordering::Relaxed),
            errors: self.errors.load(Ordering::Relaxed),
            last_error: self.last_error.lock().clone(),
            ..EndpointTraffic::default()
        }
    }
}

/// Sends to ROS 2 the messages that an outlet takes out of the core.
pub(super) struct ToRos {
    pub(super) publisher: Arc<Publisher>,
    pub(super) traffic: Arc<Traffic>,
    pub(super) limiter: Limiter,
    pub(super) of_a_cycle: OfACycle,
}

impl ToRos {
    /// Latched messages are kept for subscriptions that come later.
    fn is_latched(&self) -> bool {
        self.publisher.qos().durability == Durability::TransientLocal
    }
}

impl Sink for ToRos {
    fn gate(&self) -> Option<OutletGate> {
        if self.is_latched() {
            return None;
        }
        // Not the publisher: dropping the last handle of it leaves DDS, which must not happen on that thread.
        let (readers, traffic) = (self.publisher.reader_counter(), Arc::clone(&self.traffic));
        Some(OutletGate::new(move |messages| {
            let is_wanted = readers() > 0;
            if !is_wanted {
                traffic.skipped.fetch_add(messages.into(), Ordering::Relaxed);
            }
            is_wanted
        }))
    }

    fn is_wanted(&mut self, message: Offered) -> bool {
        if message.missed > 0 {
            self.traffic.dropped.fetch_add(message.missed.into(), Ordering::Relaxed);
        }
        let is_too_old = self.of_a_cycle == OfACycle::Latest && !message.is_last_of_cycle;
        if is_too_old || !self.limiter.lets_pass(message.time) {
            self.traffic.limited.fetch_add(1, Ordering::Relaxed);
            return false;
        }
        // The last subscription may have left since the gate was asked.
        let is_wanted = self.is_latched() || self.publisher.is_subscribed();
        if !is_wanted {
            self.traffic.skipped.fetch_add(1, Ordering::Relaxed);
        }
        is_wanted
    }

    fn take(&mut self, _time: Time, cdr: Bytes) {
        let result = self.publisher.publish(cdr);
        if self.traffic.count(&result)
            && let Err(error) = result
        {
            let topic = self.publisher.topic().as_str();
            tracing::warn!(topic, %error, "a message was not sent; further errors are only counted");
        }
    }
}

/// Takes samples of ROS 2 into the core.
pub(super) struct FromRos {
    pub(super) inlet: EncodedInlet,
    pub(super) traffic: Arc<Traffic>,
    pub(super) limiter: Limiter,
    pub(super) clock: Arc<dyn Clock>,
}

impl FromRos {
    pub(super) fn take(&mut self, sample: &Sample) {
        if !self.limiter.lets_pass(self.clock.now()) {
            self.traffic.limited.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let result = self.inlet.publish_shared(&sample.cdr);
        if matches!(result, Err(EncodedInletError::Inlet { error: InletError::Stopped, .. })) {
            return;
        }
        if self.traffic.count(&result)
            && let Err(error) = result
        {
            let writer = sample.writer;
            tracing::warn!(%writer, %error, "a message was not taken in; further errors are only counted");
        }
    }
}
