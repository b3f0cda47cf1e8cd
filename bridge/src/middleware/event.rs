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
    /// An endpoint of another participant was matched: samples go between them.
    Matched {
        /// The other.
        peer: Gid,
    },
    /// A matched endpoint has disappeared.
    Unmatched {
        /// The other.
        peer: Gid,
    },
    /// An endpoint of another participant is on the topic, and what is offered does not suffice for what is requested.
    IncompatibleQos {
        /// The other.
        peer: Gid,
        /// A policy that differs; there may be more.
        policy: QosPolicyKind,
    },
    /// An endpoint of another participant is on the topic with another type.
    IncompatibleType {
        /// The other.
        peer: Gid,
        /// The DDS name of its type.
        type_name: Arc<str>,
    },
    /// No sample was written, or none came, in the time that was offered or requested.
    DeadlineMissed {
        /// How many times that time passed.
        count: u32,
    },
    /// A writer has not shown in time that it is alive.
    LivelinessLost,
    /// A reader takes another view of whether a writer is alive.
    LivelinessChanged {
        /// The writer.
        peer: Gid,
        /// The view.
        now: Aliveness,
    },
    /// Samples of a writer did not come, going by the numbers of those that did.
    MessagesLost {
        /// The writer.
        peer: Gid,
        /// How many.
        count: u64,
    },
}

/// A reader's view of a writer, where it requests to know.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Aliveness {
    /// It shows that it is.
    Alive,
    /// It is matched, and has been silent for longer than its lease.
    NotAlive,
    /// It is matched no more.
    Gone,
}

/// A policy that can keep a writer and a reader apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum QosPolicyKind {
    /// A latched writer is needed.
    Durability,
    /// The writer may pause for longer than the reader accepts.
    Deadline,
    /// The kind, or the lease, of liveliness.
    Liveliness,
    /// A reliable writer is needed.
    Reliability,
    /// One that ROS 2 has no name for.
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

    /// The first policy by which a reader that requests one profile is kept from a writer that offers the other
    /// (DDS 1.4, 2.2.3, the column *RxO*); nothing where they match.
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
