//! Events of endpoints: matches and quality of service.

use super::Gid;
use downbeat_msgs::qos::{Durability, Liveliness, QosProfile, Reliability};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

/// Handles the events of an endpoint. It runs on a thread of the middleware, so it must not block.
pub type EventHandler = Box<dyn Fn(&EndpointEvent) + Send + Sync>;

/// What happened to an endpoint: the statuses of DDS (DDS 1.4, 2.2.4.1) that `rmw` has events for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EndpointEvent {
    /// Another endpoint was matched: samples are exchanged with it.
    Matched {
        /// The other endpoint.
        peer: Gid,
    },
    /// A matched endpoint has disappeared.
    Unmatched {
        /// The other endpoint.
        peer: Gid,
    },
    /// Another endpoint is on the topic, but the offered quality of service does not satisfy the requested
    /// one.
    IncompatibleQos {
        /// The other endpoint.
        peer: Gid,
        /// An incompatible policy; there may be more.
        policy: QosPolicyKind,
    },
    /// Another endpoint is on the topic with another type.
    IncompatibleType {
        /// The other endpoint.
        peer: Gid,
        /// The DDS name of its type.
        type_name: Arc<str>,
    },
    /// Another endpoint is on the topic with a type of the same name and another definition, and the engine
    /// exchanges no samples with it.
    IncompatibleDefinition {
        /// The other endpoint.
        peer: Gid,
        /// The hash of its type; `None` if it announces none.
        type_hash: Option<Arc<str>>,
    },
    /// The writer wrote no sample within the offered deadline, or the reader received none within the
    /// requested one.
    DeadlineMissed {
        /// The number of missed deadlines.
        count: u32,
    },
    /// The writer was not asserted within its liveliness lease.
    LivelinessLost,
    /// The liveliness of a writer changed, as the reader sees it.
    LivelinessChanged {
        /// The writer.
        peer: Gid,
        /// The new liveliness.
        now: Aliveness,
    },
    /// A matched reader knows no samples of the writer any more: its participant had lost this one, for
    /// example during a pause longer than its lease, and has found it again.
    BegunAnew {
        /// The reader.
        peer: Gid,
    },
    /// Samples of a writer were lost: their sequence numbers are missing.
    MessagesLost {
        /// The writer.
        peer: Gid,
        /// The number of lost samples.
        count: u64,
    },
}

/// The liveliness of a writer, as a reader with a liveliness lease sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Aliveness {
    /// It was asserted within its lease.
    Alive,
    /// It is matched, but was silent for longer than its lease.
    NotAlive,
    /// It is no longer matched.
    Gone,
}

/// A policy that can prevent a match.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum QosPolicyKind {
    /// The reader requests a latched writer.
    Durability,
    /// The offered deadline is longer than the requested one.
    Deadline,
    /// The kind or the lease of the liveliness.
    Liveliness,
    /// The reader requests a reliable writer.
    Reliability,
    /// A policy without a name in ROS 2.
    Other,
}

impl QosPolicyKind {
    /// As rclcpp and rclpy print it (`qos_policy_name_from_kind`).
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Durability => "DURABILITY_QOS_POLICY",
            Self::Deadline => "DEADLINE_QOS_POLICY",
            Self::Liveliness => "LIVELINESS_QOS_POLICY",
            Self::Reliability => "RELIABILITY_QOS_POLICY",
            Self::Other => "INVALID_QOS_POLICY",
        }
    }

    /// The first policy that prevents a match of a writer that offers one profile and a reader that requests
    /// the other (DDS 1.4, 2.2.3, the column *RxO*); `None` if they match.
    #[must_use]
    pub fn between(offered: &QosProfile, requested: &QosProfile) -> Option<Self> {
        let endless = |time: Option<Duration>| time.unwrap_or(Duration::MAX);
        let is_short = |offered, requested| endless(offered) <= endless(requested);
        let is_manual = |qos: &QosProfile| qos.liveliness == Liveliness::ManualByTopic;
        let suits = [
            (
                Self::Durability,
                offered.durability == Durability::TransientLocal
                    || requested.durability == Durability::Volatile,
            ),
            (Self::Deadline, is_short(offered.deadline, requested.deadline)),
            (
                Self::Liveliness,
                (is_manual(offered) || !is_manual(requested))
                    && is_short(offered.liveliness_lease_duration, requested.liveliness_lease_duration),
            ),
            (
                Self::Reliability,
                offered.reliability == Reliability::Reliable
                    || requested.reliability == Reliability::BestEffort,
            ),
        ];
        suits.into_iter().find(|(_, suits)| !suits).map(|(policy, _)| policy)
    }
}

impl fmt::Display for QosPolicyKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_offered_must_suffice_for_what_is_requested() {
        let ms = |ms| Some(Duration::from_millis(ms));
        let default = QosProfile::DEFAULT;
        let between = QosPolicyKind::between;
        assert_eq!(between(&default, &QosProfile::SENSOR_DATA), None);
        assert_eq!(between(&QosProfile::SENSOR_DATA, &default), Some(QosPolicyKind::Reliability));
        assert_eq!(between(&default, &QosProfile::LATCHED), Some(QosPolicyKind::Durability));
        let with = |deadline, lease| QosProfile {
            deadline,
            liveliness_lease_duration: lease,
            ..QosProfile::DEFAULT
        };
        assert_eq!(between(&with(ms(10), ms(10)), &with(ms(10), ms(20))), None);
        assert_eq!(between(&with(ms(20), None), &with(ms(10), None)), Some(QosPolicyKind::Deadline));
        assert_eq!(between(&default, &with(None, ms(10))), Some(QosPolicyKind::Liveliness));
        let manual = QosProfile { liveliness: Liveliness::ManualByTopic, ..default };
        assert_eq!(between(&default, &manual), Some(QosPolicyKind::Liveliness));
        assert_eq!(between(&manual, &default), None);
    }
}
