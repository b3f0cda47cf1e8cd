//! Quality of service that is decided when an endpoint is created.

use crate::middleware::{Direction, RemoteEndpoint};
use downbeat_msgs::qos::{Durability, History, Liveliness, QosProfile, Reliability};
use std::time::Duration;

/// A policy, or that it is to suit the endpoints of others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Policy<T> {
    /// This one.
    Given(T),
    /// The best that matches all endpoints of others that are known when the endpoint is created.
    BestAvailable,
}

/// What to offer or request where some of it may depend on who is there.
///
/// The rules for what is *best available* are those of `rmw_dds_common` (branch jazzy, `src/qos.cpp`):
///
/// | policy | of a publisher | of a subscription |
/// | --- | --- | --- |
/// | reliability | reliable | reliable if all publishers are |
/// | durability | transient local | transient local if all publishers are |
/// | liveliness | manual by topic if a subscription asks for it | manual by topic if all publishers are |
/// | deadline, lease | the shortest that a subscription asks for, less 1 ns | the longest that a publisher offers, and 1 ns |
///
/// As there, it is decided once: who comes later is not asked. A subscription that is created before anybody is found
/// thus asks for what all of nobody offer, reliable and transient local; only for liveliness this stays automatic, since
/// it would match hardly any publisher.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct QosRequest {
    /// What is not left open; its policies below are not looked at.
    pub history: History,
    /// See [`Reliability`].
    pub reliability: Policy<Reliability>,
    /// See [`Durability`].
    pub durability: Policy<Durability>,
    /// The longest time between two samples.
    pub deadline: Policy<Option<Duration>>,
    /// How long a sample is worth delivering.
    pub lifespan: Option<Duration>,
    /// See [`Liveliness`].
    pub liveliness: Policy<Liveliness>,
    /// How long a publisher may be silent before it counts as gone.
    pub liveliness_lease_duration: Policy<Option<Duration>>,
}

/// On the wire durations are fractions of 2^-32 s: a time that was read and is written again may come out a little
/// shorter or longer, and would then not match.
const ROUNDING: Duration = Duration::from_nanos(1);

impl QosRequest {
    /// Everything as is best, keep last 10: `rmw_qos_profile_best_available`.
    pub const BEST_AVAILABLE: Self = Self {
        history: History::KeepLast(10),
        reliability: Policy::BestAvailable,
        durability: Policy::BestAvailable,
        deadline: Policy::BestAvailable,
        lifespan: None,
        liveliness: Policy::BestAvailable,
        liveliness_lease_duration: Policy::BestAvailable,
    };

    /// The profile, where nothing is left open.
    #[must_use]
    pub fn profile(&self) -> Option<QosProfile> {
        let given = |is_open: bool| (!is_open).then_some(());
        given(self.reliability == Policy::BestAvailable)?;
        given(self.durability == Policy::BestAvailable)?;
        given(self.deadline == Policy::BestAvailable)?;
        given(self.liveliness == Policy::BestAvailable)?;
        given(self.liveliness_lease_duration == Policy::BestAvailable)?;
        Some(self.resolve(Direction::Out, &[]))
    }

    /// The profile for an endpoint of that direction, where the endpoints of others on its topic are `peers`; those of
    /// the same direction are passed over.
    #[must_use]
    pub fn resolve(&self, direction: Direction, peers: &[RemoteEndpoint]) -> QosProfile {
        let peers: Vec<_> = peers.iter().filter(|peer| peer.direction != direction).collect();
        let all = |has: fn(&RemoteEndpoint) -> bool| peers.iter().all(|peer| has(peer));
        let is_publisher = direction == Direction::Out;
        let is_manual = |peer: &RemoteEndpoint| peer.liveliness == Liveliness::ManualByTopic;
        let limit = |durations: Vec<Duration>| match direction {
            Direction::Out => durations.into_iter().min().map(|shortest| shortest.saturating_sub(ROUNDING)),
            Direction::In => durations.into_iter().max().map(|longest| longest.saturating_add(ROUNDING)),
        };
        QosProfile {
            history: self.history,
            reliability: self.reliability.or_else(|| {
                let is_reliable = is_publisher || all(|peer| peer.reliability == Reliability::Reliable);
                if is_reliable { Reliability::Reliable } else { Reliability::BestEffort }
            }),
            durability: self.durability.or_else(|| {
                let is_latched = is_publisher || all(|peer| peer.durability == Durability::TransientLocal);
                if is_latched { Durability::TransientLocal } else { Durability::Volatile }
            }),
            deadline: self
                .deadline
                .or_else(|| limit(peers.iter().filter_map(|peer| peer.deadline).collect())),
            lifespan: self.lifespan,
            liveliness: self.liveliness.or_else(|| {
                let is_wanted = match direction {
                    Direction::Out => peers.iter().any(|peer| is_manual(peer)),
                    Direction::In => !peers.is_empty() && all(is_manual),
                };
                if is_wanted { Liveliness::ManualByTopic } else { Liveliness::Automatic }
            }),
            liveliness_lease_duration: self
                .liveliness_lease_duration
                .or_else(|| limit(peers.iter().filter_map(|peer| peer.liveliness_lease_duration).collect())),
        }
    }
}

impl Default for QosRequest {
    fn default() -> Self {
        QosProfile::DEFAULT.into()
    }
}

impl From<QosProfile> for QosRequest {
    fn from(qos: QosProfile) -> Self {
        Self {
            history: qos.history,
            reliability: Policy::Given(qos.reliability),
            durability: Policy::Given(qos.durability),
            deadline: Policy::Given(qos.deadline),
            lifespan: qos.lifespan,
            liveliness: Policy::Given(qos.liveliness),
            liveliness_lease_duration: Policy::Given(qos.liveliness_lease_duration),
        }
    }
}

impl<T: Copy> Policy<T> {
    fn or_else(self, best: impl FnOnce() -> T) -> T {
        match self {
            Self::Given(policy) => policy,
            Self::BestAvailable => best(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::middleware::Gid;

    fn peer(direction: Direction, qos: QosProfile) -> RemoteEndpoint {
        RemoteEndpoint {
            gid: Gid::default(),
            direction,
            topic_name: "rt/t".into(),
            type_name: "T".into(),
            reliability: qos.reliability,
            durability: qos.durability,
            deadline: qos.deadline,
            lifespan: qos.lifespan,
            liveliness: qos.liveliness,
            liveliness_lease_duration: qos.liveliness_lease_duration,
            type_hash: None,
        }
    }

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn a_subscription_asks_for_what_all_publishers_offer() {
        let deadline = |milliseconds| QosProfile { deadline: Some(milliseconds * MS), ..QosProfile::LATCHED };
        let publishers = [peer(Direction::Out, deadline(20)), peer(Direction::Out, deadline(50))];
        let best = |peers: &[RemoteEndpoint]| QosRequest::BEST_AVAILABLE.resolve(Direction::In, peers);
        assert_eq!(
            best(&publishers),
            QosProfile {
                history: History::KeepLast(10),
                deadline: Some(50 * MS + ROUNDING),
                ..QosProfile::LATCHED
            }
        );

        let mixed = [publishers[0].clone(), peer(Direction::Out, QosProfile::SENSOR_DATA)];
        let expected =
            QosProfile { deadline: Some(20 * MS + ROUNDING), ..QosProfile::SENSOR_DATA.keep_last(10) };
        assert_eq!(best(&mixed), expected);

        let subscription = peer(Direction::In, QosProfile::SENSOR_DATA);
        assert_eq!(best(&[subscription]).reliability, Reliability::Reliable, "it is not a publisher");
    }

    #[test]
    fn a_publisher_offers_what_every_subscription_can_ask_for() {
        let manual = QosProfile {
            liveliness: Liveliness::ManualByTopic,
            liveliness_lease_duration: Some(30 * MS),
            ..QosProfile::SENSOR_DATA
        };
        let lease = QosProfile { liveliness_lease_duration: Some(10 * MS), ..QosProfile::DEFAULT };
        let subscriptions = [peer(Direction::In, manual), peer(Direction::In, lease)];
        let offered = QosRequest::BEST_AVAILABLE.resolve(Direction::Out, &subscriptions);
        let expected = QosProfile {
            durability: Durability::TransientLocal,
            liveliness: Liveliness::ManualByTopic,
            liveliness_lease_duration: Some(10 * MS - ROUNDING),
            ..QosProfile::DEFAULT
        };
        assert_eq!(offered, expected);
    }

    #[test]
    fn what_is_given_stays_whoever_is_there() {
        let given = QosRequest::from(QosProfile::SENSOR_DATA);
        let latched = [peer(Direction::Out, QosProfile::LATCHED)];
        assert_eq!(given.resolve(Direction::In, &latched), QosProfile::SENSOR_DATA);
        assert_eq!(given.profile(), Some(QosProfile::SENSOR_DATA));
        assert_eq!(QosRequest { durability: Policy::BestAvailable, ..given }.profile(), None);
    }
}
