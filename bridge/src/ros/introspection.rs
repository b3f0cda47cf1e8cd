//! Service introspection: events of services and clients, published on `<service>/_service_event`.
//!
//! As `rcl` does it (`rcl/src/rcl/service_event_publisher.c`, `service.c` and `client.c`, branch jazzy): a
//! server publishes an event when it has received a request and sent a response, a client when it has sent a
//! request and received a response.

use super::{MessageType, Node, NodeError, Publisher, ServiceName, ServiceType};
use crate::edge::{EventContent, KnownService};
use crate::middleware::Gid;
use downbeat_executor::Clock;
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::service_msgs::msg::ServiceEventInfo;
use downbeat_msgs::std_srvs::srv::Empty;
use parking_lot::{Mutex, MutexGuard};
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use thiserror::Error;

/// How much of the events of a service is published.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Introspection {
    /// Nothing.
    #[default]
    Off,
    /// The client and the time.
    Metadata,
    /// The same, with requests and responses.
    Contents,
}

/// A text that names no way of introspection.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("\"{0}\" is none of \"disabled\", \"metadata\" and \"contents\"")]
pub struct UnknownIntrospection(String);

impl FromStr for Introspection {
    type Err = UnknownIntrospection;

    /// In the words of `demo_nodes_cpp/src/services/introspection_service.cpp` (`ros2/demos`, branch jazzy).
    fn from_str(text: &str) -> Result<Self, UnknownIntrospection> {
        match text {
            "disabled" => Ok(Self::Off),
            "metadata" => Ok(Self::Metadata),
            "contents" => Ok(Self::Contents),
            other => Err(UnknownIntrospection(other.to_owned())),
        }
    }
}

impl fmt::Display for Introspection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Off => "disabled",
            Self::Metadata => "metadata",
            Self::Contents => "contents",
        })
    }
}

/// A step of a request; the values are those of `service_msgs/msg/ServiceEventInfo`.
#[derive(Clone, Copy)]
pub(super) enum Event {
    RequestSent = 0,
    RequestReceived = 1,
    ResponseSent = 2,
    ResponseReceived = 3,
}

/// Publishes the events of one service or client, if that is enabled.
pub(super) struct ServiceEvents {
    topic: String,
    service_type: ServiceType,
    active: Mutex<Option<Active>>,
    has_failed: AtomicBool,
}

struct Active {
    publisher: Publisher,
    clock: Arc<dyn Clock>,
    service_type: KnownService,
    with_contents: bool,
}

impl ServiceEvents {
    pub(super) fn new(service: &ServiceName, service_type: &ServiceType) -> Arc<Self> {
        Arc::new(Self {
            topic: format!("{service}/_service_event"),
            service_type: service_type.clone(),
            active: Mutex::default(),
            has_failed: AtomicBool::new(false),
        })
    }

    /// Sets what is published.
    pub(super) fn configure(
        &self,
        node: &Node,
        introspection: Introspection,
        qos: QosProfile,
        clock: Arc<dyn Clock>,
    ) -> Result<(), NodeError> {
        let mut active = self.active.lock();
        let before = active.take();
        if introspection == Introspection::Off {
            return Ok(());
        }
        let known = node.membership.shared.interfaces.service(self.service_type.as_str()).ok();
        let with_contents = introspection == Introspection::Contents;
        if with_contents && known.is_none() {
            let (topic, service_type) = (&self.topic, self.service_type.as_str());
            tracing::warn!(
                topic,
                "requests and responses are not published: the definition of {service_type} is not known"
            );
        }
        let publisher = match before {
            // An existing publisher stays, as in rcl.
            Some(before) => before.publisher,
            None => {
                let event_type = MessageType::new(&format!("{}_Event", self.service_type))?;
                node.publish(&self.topic, &event_type, qos)?
            }
        };
        *active = Some(Active {
            publisher,
            clock,
            // Without contents all events have the same bytes.
            service_type: known.unwrap_or(KnownService::of::<Empty>()),
            with_contents: with_contents && known.is_some(),
        });
        Ok(())
    }

    /// Locked while a request is sent, so that the event of its answer follows that of the request.
    pub(super) fn hold(&self) -> Publishing<'_> {
        Publishing { events: self, active: self.active.lock() }
    }

    pub(super) fn publish_event(&self, event: Event, client: Gid, number: i64, cdr: &[u8]) {
        self.hold().publish_event(event, client, number, cdr);
    }
}

pub(super) struct Publishing<'a> {
    events: &'a ServiceEvents,
    active: MutexGuard<'a, Option<Active>>,
}

impl Publishing<'_> {
    /// Publishes an event if a subscription receives it; `cdr` is the request or the response.
    pub(super) fn publish_event(&self, event: Event, client: Gid, number: i64, cdr: &[u8]) {
        let Some(active) = &*self.active else { return };
        if !active.publisher.is_subscribed() {
            return;
        }
        let info = ServiceEventInfo {
            event_type: event as u8,
            stamp: Time::from_nanos(active.clock.now().as_nanos()),
            client_gid: client.0,
            sequence_number: number,
        };
        let content = match event {
            _ if !active.with_contents => EventContent::Nothing,
            Event::RequestSent | Event::RequestReceived => EventContent::Request(cdr),
            Event::ResponseSent | Event::ResponseReceived => EventContent::Response(cdr),
        };
        let published = active
            .service_type
            .encode_event(info, content)
            .map_err(|error| error.to_string())
            .and_then(|event| active.publisher.publish(event.into()).map_err(|error| error.to_string()));
        if let Err(error) = published
            && !self.events.has_failed.swap(true, Ordering::Relaxed)
        {
            let topic = &self.events.topic;
            tracing::warn!(
                topic,
                "an event of a service was not published: {error}; further errors are not logged"
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_words_are_those_of_the_demo() {
        for introspection in [Introspection::Off, Introspection::Metadata, Introspection::Contents] {
            assert_eq!(introspection.to_string().parse(), Ok(introspection));
        }
        let error = "on".parse::<Introspection>().map_err(|error| error.to_string());
        assert_eq!(error, Err("\"on\" is none of \"disabled\", \"metadata\" and \"contents\"".to_owned()));
    }
}
