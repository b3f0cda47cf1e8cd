//! Quality of service of ROS 2 as tokens announce it, and back.

use crate::middleware::Priority;
use downbeat_msgs::qos::{Durability, History, Liveliness, QosProfile, Reliability};
use downbeat_zenoh::wire::{Period, Qos};
use downbeat_zenoh::zenoh::qos;
use std::time::Duration;

/// The samples that a publisher with an unbounded history keeps for late subscriptions.
pub(super) const MOST_KEPT: u32 = 64;

/// The policies of a local endpoint.
pub(super) fn to_token(profile: &QosProfile) -> Qos {
    let (history, depth) = match profile.history {
        History::KeepLast(depth) => (Qos::KEEP_LAST, depth.max(1).into()),
        History::KeepAll => (Qos::KEEP_ALL, MOST_KEPT.into()),
    };
    Qos {
        reliability: match profile.reliability {
            Reliability::Reliable => Qos::RELIABLE,
            Reliability::BestEffort => Qos::BEST_EFFORT,
        },
        durability: match profile.durability {
            Durability::Volatile => Qos::VOLATILE,
            Durability::TransientLocal => Qos::TRANSIENT_LOCAL,
        },
        history,
        depth,
        deadline: period(profile.deadline),
        lifespan: period(profile.lifespan),
        liveliness: match profile.liveliness {
            Liveliness::Automatic => Qos::AUTOMATIC,
            Liveliness::ManualByTopic => Qos::MANUAL_BY_TOPIC,
        },
        lease: period(profile.liveliness_lease_duration),
    }
}

/// The policies of another endpoint. *Best available* and unknown numbers count as what they act as in
/// `rmw_zenoh_cpp`: best effort and volatile.
pub(super) fn from_token(qos: &Qos) -> QosProfile {
    QosProfile {
        history: match qos.history {
            Qos::KEEP_ALL => History::KeepAll,
            _ => History::KeepLast(qos.depth.try_into().unwrap_or(u32::MAX)),
        },
        reliability: match qos.reliability {
            Qos::RELIABLE => Reliability::Reliable,
            _ => Reliability::BestEffort,
        },
        durability: match qos.durability {
            Qos::TRANSIENT_LOCAL => Durability::TransientLocal,
            _ => Durability::Volatile,
        },
        deadline: duration(qos.deadline),
        lifespan: duration(qos.lifespan),
        liveliness: match qos.liveliness {
            Qos::MANUAL_BY_TOPIC => Liveliness::ManualByTopic,
            _ => Liveliness::Automatic,
        },
        liveliness_lease_duration: duration(qos.lease),
    }
}

/// The priority of a publisher, which tokens do not announce.
pub(super) fn to_zenoh(priority: Priority) -> qos::Priority {
    match priority {
        Priority::RealTime => qos::Priority::RealTime,
        Priority::InteractiveHigh => qos::Priority::InteractiveHigh,
        Priority::InteractiveLow => qos::Priority::InteractiveLow,
        Priority::DataHigh => qos::Priority::DataHigh,
        Priority::Data => qos::Priority::Data,
        Priority::DataLow => qos::Priority::DataLow,
        Priority::Background => qos::Priority::Background,
    }
}

fn period(duration: Option<Duration>) -> Period {
    let finite = |time: Duration| Period { seconds: time.as_secs(), nanoseconds: time.subsec_nanos().into() };
    duration.map_or(Period::INFINITE, finite)
}

fn duration(period: Period) -> Option<Duration> {
    // `RMW_DURATION_BEST_AVAILABLE` is a nanosecond less than infinite.
    let is_finite = period.seconds < Period::INFINITE.seconds;
    let nanoseconds = period.nanoseconds.min(999_999_999);
    is_finite.then(|| Duration::new(period.seconds, nanoseconds.try_into().unwrap_or(0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profiles_of_ros_survive_the_way_there_and_back() {
        let manual = QosProfile {
            deadline: Some(Duration::from_millis(250)),
            liveliness: Liveliness::ManualByTopic,
            liveliness_lease_duration: Some(Duration::from_secs(2)),
            ..QosProfile::DEFAULT
        };
        for profile in [QosProfile::DEFAULT, QosProfile::SENSOR_DATA, QosProfile::ROSOUT, manual] {
            assert_eq!(from_token(&to_token(&profile)), profile);
        }
    }

    #[test]
    fn best_available_of_a_peer_acts_as_best_effort() {
        let best: Qos = "4:4:,10:,854775806:,:5,,854775806".parse().unwrap_or(Qos::DEFAULT);
        let sensor = QosProfile { reliability: Reliability::BestEffort, ..QosProfile::DEFAULT.keep_last(10) };
        assert_eq!(from_token(&best), sensor);
    }
}
