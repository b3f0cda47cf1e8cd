//! Exposures: which topics of a core are exposed, and which of their messages.

use crate::edge::KnownType;
use crate::middleware::{Direction, SendOptions};
use crate::ros::{NodeError, NodeName};
use downbeat_executor::{SetupError, Time};
use downbeat_msgs::qos::QosRequest;
use serde::{Deserialize, Serialize};
use std::time::Duration;
use thiserror::Error;

/// A topic to publish in ROS 2, or to subscribe there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Exposure {
    /// The topic in the executor.
    pub topic: String,
    /// The topic in ROS 2 where it differs: absolute, relative to the node's namespace, or private (`~/…`).
    pub ros_topic: Option<String>,
    /// The type of the messages.
    pub message_type: KnownType,
    /// Out of the executor or into it.
    pub direction: Direction,
    /// What to offer or request.
    pub qos: QosRequest,
    /// Which of its messages pass.
    pub limits: Limits,
    /// How those that go out go over a link.
    pub send: SendOptions,
    /// The node that has the endpoint; `None` for the bridge's own.
    pub node: Option<NodeName>,
    /// The network that has it; `None` for that of the bridge's node.
    pub network: Option<String>,
    /// Whether messages go out that came in from another network.
    pub relays: bool,
}

/// Which messages of a topic pass: the latest of a cycle, of these every n-th, of these no more than the rate
/// allows. For a network or a display that needs fewer messages than the robot has.
///
/// The time is that of the executor, so the same run lets the same messages pass. Serialized with the keys of
/// robot files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(from = "LimitKeys", into = "LimitKeys")]
pub struct Limits {
    /// The least time between two messages that pass, on average; 100 ms for 10 Hz.
    pub period: Option<Duration>,
    /// The first of every so many messages passes; 0 and 1 let all pass.
    pub every: u32,
    /// Which messages of one cycle pass.
    pub of_a_cycle: OfACycle,
}

#[derive(Serialize, Deserialize)]
struct LimitKeys {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    rate_hz: Option<f64>,
    every: u32,
    latest_only: bool,
}

/// Which of the messages that a topic carries in one cycle pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum OfACycle {
    /// All.
    #[default]
    All,
    /// Only the last.
    Latest,
}

/// A topic could not be exposed.
#[derive(Debug, Error)]
pub enum ExposeError {
    /// Its ROS 2 endpoint could not be created.
    #[error("exposing topic \"{topic}\": {error}")]
    Endpoint {
        /// The topic in the executor.
        topic: String,
        /// Why not.
        error: NodeError,
    },
    /// The ROS 2 endpoints of a service could not be created.
    #[error("exposing service \"{service}\": {error}")]
    Service {
        /// The service in the executor.
        service: String,
        /// Why not.
        error: NodeError,
    },
    /// A message that came in would go out again, to the subscriptions that received it already.
    #[error(
        "topic \"{0}\" is exposed in both directions: what comes in would go out again; expose one of them under \
         another topic of the executor"
    )]
    BothDirections(String),
    /// What comes in from one network would go out to another.
    #[error(
        "topic \"{0}\" comes in from one network and would go out to another, which its exposure does not allow"
    )]
    Relay(String),
    /// The bridge was not given a network of that name.
    #[error("\"{name}\": there is no network \"{network}\"")]
    NoNetwork {
        /// The topic or service in the executor.
        name: String,
        /// The network.
        network: String,
    },
    /// The node has an endpoint of that direction on the topic already.
    #[error("{0} is exposed already; remove it before, or give this one another name")]
    Twice(String),
    /// Another bridge exposes topics of the core.
    #[error("this core has a bridge already; expose more through that one")]
    SecondBridge,
    /// The bridge's core has stopped.
    #[error("the robot has stopped")]
    Stopped,
    /// The executor refused.
    #[error(transparent)]
    Setup(#[from] SetupError),
}

impl Exposure {
    /// All messages of a topic, under the same name, on the bridge's own node, with the default QoS.
    #[must_use]
    pub fn new(topic: impl Into<String>, message_type: KnownType, direction: Direction) -> Self {
        Self {
            topic: topic.into(),
            ros_topic: None,
            message_type,
            direction,
            qos: QosRequest::default(),
            limits: Limits::default(),
            send: SendOptions::default(),
            node: None,
            network: None,
            relays: false,
        }
    }

    /// The topic in ROS 2, before it is expanded.
    #[must_use]
    pub fn ros_topic(&self) -> &str {
        self.ros_topic.as_deref().unwrap_or(&self.topic)
    }

    /// True if this would publish in one network what the other receives from another one.
    #[must_use]
    pub fn relays_from(&self, other: &Self) -> bool {
        let directions = (self.direction, other.direction);
        directions == (Direction::Out, Direction::In)
            && self.network != other.network
            && is_same_topic(&self.topic, &other.topic)
    }
}

/// Whether two names mean the same topic of the executor.
pub(super) fn is_same_topic(one: &str, other: &str) -> bool {
    one.trim_start_matches('/') == other.trim_start_matches('/')
}

impl Limits {
    /// In messages per second, without the noise of binary fractions.
    #[must_use]
    pub fn rate_hz(&self) -> Option<f64> {
        self.period.map(|period| (1e6 / period.as_secs_f64()).round() / 1e6)
    }

    /// The period of a rate in messages per second, if it is one.
    #[must_use]
    pub fn period_of(rate_hz: f64) -> Option<Duration> {
        let period = Duration::try_from_secs_f64(1.0 / rate_hz).ok();
        period.filter(|period| !period.is_zero() && rate_hz > 0.0)
    }
}

impl From<LimitKeys> for Limits {
    fn from(LimitKeys { rate_hz, every, latest_only }: LimitKeys) -> Self {
        let of_a_cycle = if latest_only { OfACycle::Latest } else { OfACycle::All };
        Self { period: rate_hz.and_then(Self::period_of), every, of_a_cycle }
    }
}

impl From<Limits> for LimitKeys {
    fn from(limits: Limits) -> Self {
        let latest_only = limits.of_a_cycle == OfACycle::Latest;
        Self { rate_hz: limits.rate_hz(), every: limits.every.max(1), latest_only }
    }
}

/// Decides for the messages of one topic.
#[derive(Debug)]
pub(super) struct Limiter {
    limits: Limits,
    /// How many messages came, modulo `every`.
    count: u32,
    last: Option<Time>,
    next: Time,
}

impl Limiter {
    pub(super) fn new(limits: Limits) -> Self {
        Self { limits, count: 0, last: None, next: Time::ZERO }
    }

    /// True if a message of that time passes.
    pub(super) fn lets_pass(&mut self, time: Time) -> bool {
        self.is_nth() && self.is_in_time(time)
    }

    fn is_nth(&mut self) -> bool {
        let is_first = self.count == 0;
        self.count = (self.count + 1) % self.limits.every.max(1);
        is_first
    }

    /// Keeps the average rate where messages come a little late, and does not catch up after a pause.
    fn is_in_time(&mut self, time: Time) -> bool {
        let Some(period) = self.limits.period else { return true };
        // A clock that is set back, as by a bag that begins again, starts anew.
        let is_due = self.last.is_none_or(|last| time < last || time >= self.next);
        if is_due {
            let is_behind = self.last.is_none_or(|last| time < last) || time >= self.next + period;
            self.next = if is_behind { time + period } else { self.next + period };
        }
        self.last = Some(time);
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn passing(limits: Limits, times_ms: impl IntoIterator<Item = i64>) -> Vec<i64> {
        let mut limiter = Limiter::new(limits);
        times_ms.into_iter().filter(|&ms| limiter.lets_pass(Time::from_nanos(ms * 1_000_000))).collect()
    }

    fn at_most_every(milliseconds: u64) -> Limits {
        Limits { period: Some(Duration::from_millis(milliseconds)), ..Limits::default() }
    }

    #[test]
    fn a_rate_is_kept_on_average() {
        let times = (0..125).map(|number| number * 8);
        assert_eq!(
            passing(at_most_every(100), times.clone()),
            [0, 104, 200, 304, 400, 504, 600, 704, 800, 904]
        );
        assert_eq!(passing(at_most_every(8), times.clone()).len(), 125);
        assert_eq!(passing(at_most_every(1), times).len(), 125);
    }

    #[test]
    fn after_a_pause_nothing_is_caught_up() {
        assert_eq!(passing(at_most_every(100), [0, 1000, 1010, 1090, 1100]), [0, 1000, 1100]);
    }

    #[test]
    fn a_clock_that_was_set_back_starts_anew() {
        assert_eq!(passing(at_most_every(100), [1000, 1050, 10, 50, 110]), [1000, 10, 110]);
    }

    #[test]
    fn each_nth_passes_the_first_among_them() {
        let every = |every| Limits { every, ..Limits::default() };
        assert_eq!(passing(every(3), 0..8), [0, 3, 6]);
        assert_eq!(passing(every(1), 0..3), [0, 1, 2]);
        assert_eq!(passing(Limits::default(), 0..3), [0, 1, 2]);
        let both = Limits { every: 2, ..at_most_every(5) };
        assert_eq!(passing(both, 0..16), [0, 6, 10]);
    }
}
