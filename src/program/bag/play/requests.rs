//! Recorded requests, sent again: `--publish-service-requests`.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use crate::bags::{RecordedTopic, TopicInfo};
use crate::bridge::limiter::Limiter;
use crate::bridge::ros::{Node, RawClient, ServiceType};
use crate::msgs::qos::QosProfile;
use crate::msgs::service_msgs::msg::ServiceEventInfo;
use crate::table::Decoder;
use anyhow::Context;
use bytes::Bytes;
use clap::ValueEnum;

/// Which recorded requests are used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
pub(crate) enum RequestsSource {
    /// Those that the server received.
    #[default]
    ServiceIntrospection,
    /// Those that the clients sent.
    ClientIntrospection,
}

impl RequestsSource {
    fn event_type(self) -> u8 {
        match self {
            Self::ServiceIntrospection => ServiceEventInfo::REQUEST_RECEIVED,
            Self::ClientIntrospection => ServiceEventInfo::REQUEST_SENT,
        }
    }
}

/// Sends the requests in the events of a service.
pub(super) struct Requests {
    client: RawClient,
    decoder: Decoder,
    event_type: u8,
    unanswered: Arc<AtomicUsize>,
    /// Limits messages about requests that are not sent or not answered.
    failures: Arc<Limiter>,
    /// Whether the missing requests in events have been reported.
    has_told: AtomicBool,
}

/// The suffixes of the event topic and the event type of a service.
const TOPIC_ENDING: &str = "/_service_event";
const TYPE_ENDING: &str = "_Event";

/// How long to wait for responses, so that the last ones arrive before the player exits.
const TIMEOUT: Duration = Duration::from_secs(5);

impl Requests {
    /// The name and type of the service whose events a topic carries.
    pub(super) fn service(topic: &TopicInfo) -> Option<(&str, &str)> {
        Some((topic.name.strip_suffix(TOPIC_ENDING)?, topic.type_name.strip_suffix(TYPE_ENDING)?))
    }

    pub(super) fn new(topic: &RecordedTopic, source: RequestsSource, node: &Node) -> anyhow::Result<Self> {
        let (service, type_name) = Self::service(&topic.info).context("it has no service events")?;
        let client = node.client_raw(service, &ServiceType::new(type_name)?, QosProfile::SERVICES)?;
        Ok(Self {
            client,
            decoder: Decoder::of(topic, node.participant().interfaces())?,
            event_type: source.event_type(),
            unanswered: Arc::default(),
            failures: Arc::default(),
            has_told: AtomicBool::new(false),
        })
    }

    pub(super) fn has_server(&self) -> bool {
        self.client.is_available()
    }

    /// Whether a response is pending.
    pub(super) fn is_unanswered(&self) -> bool {
        self.unanswered.load(Ordering::Relaxed) > 0
    }

    /// Sends the request in an event; returns false if the event has none from the selected source, or there
    /// is no server.
    pub(super) fn send(&self, event: Bytes) -> anyhow::Result<bool> {
        let event = self.decoder.decode(event)?;
        if event.get("info.event_type")?.as_u64() != Some(self.event_type.into()) {
            return Ok(false);
        }
        let service = self.client.name();
        let requests = event.get("request")?;
        let Some(request) = requests.as_array().and_then(|requests| requests.get(0)?.as_message()) else {
            if !self.has_told.swap(true, Ordering::Relaxed) {
                tracing::warn!(
                    "{service}: its events were recorded without requests; set introspection to \"contents\" for that"
                );
            }
            return Ok(false);
        };
        if !self.has_server() {
            if let Some(left_out) = self.failures.allow() {
                tracing::warn!("{service}: there is no server; a request is not sent{left_out}");
            }
            return Ok(false);
        }
        let (name, unanswered) = (service.to_string(), Arc::clone(&self.unanswered));
        let failures = Arc::clone(&self.failures);
        unanswered.fetch_add(1, Ordering::Relaxed);
        self.client.call(request.to_message().to_cdr().into(), TIMEOUT, move |answer| {
            unanswered.fetch_sub(1, Ordering::Relaxed);
            if let Err(error) = answer
                && let Some(left_out) = failures.allow()
            {
                tracing::warn!("{name}: {error}{left_out}");
            }
        });
        Ok(true)
    }
}
