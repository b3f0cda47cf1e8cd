//! What the bridge is doing, for a status display on another thread.

use super::Limits;
use super::endpoints::Endpoints;
use super::qos_events::{EndpointQos, QosCounts};
use crate::edge::KnownType;
use crate::middleware::Direction;
use crate::ros::{Publisher, Subscription};
use downbeat_msgs::qos::QosProfile;
use std::fmt::Display;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// Shows the exposed endpoints. Clones show the same. It keeps no endpoint alive.
#[derive(Clone, Default)]
pub struct BridgeStatus {
    endpoints: Arc<Endpoints>,
}

/// One exposed endpoint at one moment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EndpointReport {
    /// The topic in the executor.
    pub topic: String,
    /// The topic in ROS 2, absolute.
    pub ros_topic: String,
    /// The node that has the endpoint, absolute.
    pub node: String,
    /// The type in ROS 2.
    pub type_name: &'static str,
    /// Out of the executor or into it.
    pub direction: Direction,
    /// What is offered or requested.
    pub qos: QosProfile,
    /// How much of it passes.
    pub limits: Limits,
    /// How many endpoints of others are matched; 0 after the bridge has stopped.
    pub matched: usize,
    /// Messages that went through.
    pub messages: u64,
    /// Messages that were not serialized since nobody was matched.
    pub skipped: u64,
    /// Messages that the limits held back.
    pub limited: u64,
    /// Messages that were dropped before the bridge came to them: more than its bounded inbox holds came while it was busy.
    pub dropped: u64,
    /// What happened to the quality of service.
    pub qos_counts: QosCounts,
    /// Messages that should have gone through and did not.
    pub errors: u64,
    /// The last reason for that.
    pub last_error: Option<String>,
}

impl BridgeStatus {
    pub(super) fn new(endpoints: Arc<Endpoints>) -> Self {
        Self { endpoints }
    }

    /// The endpoints, in the order in which they were exposed.
    #[must_use]
    pub fn endpoints(&self) -> Vec<EndpointReport> {
        self.endpoints.reports()
    }
}

pub(super) struct EndpointStatus {
    pub(super) topic: String,
    pub(super) ros_topic: String,
    pub(super) node: String,
    pub(super) message_type: KnownType,
    pub(super) direction: Direction,
    pub(super) qos: QosProfile,
    pub(super) limits: Limits,
    pub(super) endpoint: WeakEndpoint,
    pub(super) traffic: Arc<Traffic>,
    pub(super) events: Arc<EndpointQos>,
}

pub(super) enum WeakEndpoint {
    Publisher(Weak<Publisher>),
    Subscription(Weak<Subscription>),
}

impl EndpointStatus {
    pub(super) fn report(&self) -> EndpointReport {
        let matched = match &self.endpoint {
            WeakEndpoint::Publisher(publisher) => publisher.upgrade().map(|p| p.matched_subscriptions()),
            WeakEndpoint::Subscription(subscription) => {
                subscription.upgrade().map(|s| s.matched_publishers())
            }
        };
        EndpointReport {
            topic: self.topic.clone(),
            ros_topic: self.ros_topic.clone(),
            node: self.node.clone(),
            type_name: self.message_type.name(),
            direction: self.direction,
            qos: self.qos,
            limits: self.limits,
            matched: matched.unwrap_or(0),
            messages: self.traffic.messages.load(Ordering::Relaxed),
            skipped: self.traffic.skipped.load(Ordering::Relaxed),
            limited: self.traffic.limited.load(Ordering::Relaxed),
            dropped: self.traffic.dropped.load(Ordering::Relaxed),
            qos_counts: self.events.counts(),
            errors: self.traffic.errors.load(Ordering::Relaxed),
            last_error: self.traffic.last_error.lock().unwrap_or_else(PoisonError::into_inner).clone(),
        }
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
    pub(super) fn count_skipped(&self) {
        self.skipped.fetch_add(1, Ordering::Relaxed);
    }

    /// Messages and errors.
    pub(super) fn totals(&self) -> (u64, u64) {
        (self.messages.load(Ordering::Relaxed), self.errors.load(Ordering::Relaxed))
    }

    pub(super) fn count_limited(&self) {
        self.limited.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn count_dropped(&self, messages: u32) {
        if messages > 0 {
            self.dropped.fetch_add(messages.into(), Ordering::Relaxed);
        }
    }

    /// Counts the message or the error; true for the first error, which is worth a log line.
    pub(super) fn count<E: Display>(&self, result: &Result<(), E>) -> bool {
        match result {
            Ok(()) => {
                self.messages.fetch_add(1, Ordering::Relaxed);
                false
            }
            Err(error) => {
                let last_error = Some(error.to_string());
                *self.last_error.lock().unwrap_or_else(PoisonError::into_inner) = last_error;
                self.errors.fetch_add(1, Ordering::Relaxed) == 0
            }
        }
    }
}
