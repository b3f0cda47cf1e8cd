//! Quality of service of ROS 2 as rustdds policies, and what rustdds cannot do of it.

use crate::middleware::{Direction, Endpoint, MiddlewareError, QosPolicyKind};
use downbeat_msgs::qos::{Durability, History, Liveliness, QosProfile, Reliability};
use rustdds::policy;
use rustdds::qos::QosPolicyId;
use rustdds::{Duration as DdsDuration, QosPolicies, QosPolicyBuilder};
use std::time::Duration;

/// The send window of a transient local writer, unless its history is deeper: rustdds keeps this many for
/// late readers whatever the depth. Such topics hold values that change seldom.
const TRANSIENT_LOCAL_WINDOW: u32 = 64;
/// The send window of a writer of [`LARGE_SAMPLES`]: 64 MB at 1 MB a sample.
const WINDOW_OF_LARGE_SAMPLES: u32 = 64;
/// Types whose samples are often larger than 100 kB. rustdds counts samples, not bytes, and takes the window
/// before the first sample is written.
const LARGE_SAMPLES: [&str; 5] = [
    "nav_msgs::msg::dds_::OccupancyGrid_",
    "sensor_msgs::msg::dds_::CompressedImage_",
    "sensor_msgs::msg::dds_::Image_",
    "sensor_msgs::msg::dds_::PointCloud_",
    "sensor_msgs::msg::dds_::PointCloud2_",
];
/// How many samples a reader that keeps all may hold before its callback has taken them.
pub(super) const KEEP_ALL_SAMPLES: i32 = 8192;

/// The policies of a local endpoint. Logs a warning for a policy that is announced, but not applied.
pub(super) fn policies(endpoint: &Endpoint, direction: Direction) -> Result<QosPolicies, MiddlewareError> {
    let QosProfile { history, reliability, durability, deadline, lifespan, liveliness, .. } = endpoint.qos;
    let refuse = |reason: &str| MiddlewareError::Qos {
        topic_name: endpoint.topic_name.clone(),
        reason: reason.to_owned(),
    };

    let mut builder = QosPolicyBuilder::new()
        .durability(match durability {
            Durability::Volatile => policy::Durability::Volatile,
            Durability::TransientLocal => policy::Durability::TransientLocal,
        })
        .reliability(match reliability {
            Reliability::BestEffort => policy::Reliability::BestEffort,
            // Never wait in a write: the send window is sized so that a full one means a dead reader.
            Reliability::Reliable => policy::Reliability::Reliable { max_blocking_time: DdsDuration::ZERO },
        })
        .deadline(policy::Deadline(dds_duration(deadline)));

    let depth = match history {
        History::KeepLast(0) => return Err(refuse("history depth 0 keeps nothing; use 1 or more")),
        History::KeepLast(depth) => {
            let depth = i32::try_from(depth)
                .map_err(|_| refuse("the history depth is above 2147483647; use less, or keep all"))?;
            builder = builder.history(policy::History::KeepLast { depth });
            Some(depth)
        }
        History::KeepAll => {
            builder = builder.history(policy::History::KeepAll);
            None
        }
    };
    // For a writer this is the send window, and the bound on what a best-effort reader makes it hold: rustdds
    // evicts only what all readers have acknowledged, and those never acknowledge. For a reader it bounds
    // keep all.
    let max_samples = match direction {
        Direction::Out => {
            let window = match durability {
                Durability::Volatile if LARGE_SAMPLES.contains(&endpoint.type_name.as_str()) => {
                    endpoint.send_window.min(WINDOW_OF_LARGE_SAMPLES)
                }
                Durability::Volatile => endpoint.send_window,
                Durability::TransientLocal => endpoint.send_window.min(TRANSIENT_LOCAL_WINDOW),
            };
            i32::try_from(window).unwrap_or(i32::MAX).max(depth.unwrap_or(1))
        }
        Direction::In => depth.unwrap_or(KEEP_ALL_SAMPLES),
    };
    builder = builder.resource_limits(policy::ResourceLimits {
        max_samples,
        max_instances: 1,
        max_samples_per_instance: max_samples,
    });

    if let Some(lifespan) = lifespan {
        builder = builder.lifespan(policy::Lifespan { duration: DdsDuration::from_std(lifespan) });
        // Every node has `/rosout` with a lifespan; the documentation says it once.
        if direction == Direction::Out && endpoint.topic_name != "rt/rosout" {
            tracing::warn!(
                topic = endpoint.topic_name,
                "lifespan is announced but not carried out: the DDS engine sends old samples to late subscriptions"
            );
        }
    }
    let lease_duration = dds_duration(endpoint.qos.liveliness_lease_duration);
    builder = builder.liveliness(match liveliness {
        Liveliness::Automatic => policy::Liveliness::Automatic { lease_duration },
        // A local writer is asserted by its samples; rustdds sends nothing else.
        Liveliness::ManualByTopic => policy::Liveliness::ManualByTopic { lease_duration },
    });
    Ok(builder.build())
}

/// Reliability and durability of an endpoint of another participant; what it does not announce is the default
/// of DDS.
pub(super) fn reliability_and_durability(
    qos: &QosPolicies,
    direction: Direction,
) -> (Reliability, Durability) {
    let reliability = match (qos.reliability(), direction) {
        (Some(policy::Reliability::Reliable { .. }), _) | (None, Direction::Out) => Reliability::Reliable,
        (Some(policy::Reliability::BestEffort), _) | (None, Direction::In) => Reliability::BestEffort,
    };
    let durability = match qos.durability() {
        None | Some(policy::Durability::Volatile) => Durability::Volatile,
        Some(_) => Durability::TransientLocal,
    };
    (reliability, durability)
}

/// A policy that keeps a reader from a writer.
pub(super) fn incompatibility(offered: &QosPolicies, requested: &QosPolicies) -> QosPolicyKind {
    match offered.compliance_failure_wrt(requested) {
        Some(QosPolicyId::Durability) => QosPolicyKind::Durability,
        Some(QosPolicyId::Deadline) => QosPolicyKind::Deadline,
        Some(QosPolicyId::Liveliness) => QosPolicyKind::Liveliness,
        Some(QosPolicyId::Reliability) => QosPolicyKind::Reliability,
        _ => QosPolicyKind::Other,
    }
}

/// The longest time between two samples; none where it is infinite.
pub(super) fn deadline(qos: &QosPolicies) -> Option<Duration> {
    qos.deadline().and_then(|policy::Deadline(deadline)| std_duration(deadline))
}

/// How long a sample is worth delivering; none where it is for ever.
pub(super) fn lifespan(qos: &QosPolicies) -> Option<Duration> {
    qos.lifespan().and_then(|policy::Lifespan { duration }| std_duration(duration))
}

/// Liveliness and its lease. ROS 2 has no name for *manual by participant*: it counts as automatic.
pub(super) fn liveliness_and_lease(qos: &QosPolicies) -> (Liveliness, Option<Duration>) {
    match qos.liveliness() {
        None => (Liveliness::Automatic, None),
        Some(policy::Liveliness::ManualByTopic { lease_duration }) => {
            (Liveliness::ManualByTopic, std_duration(lease_duration))
        }
        Some(
            policy::Liveliness::Automatic { lease_duration }
            | policy::Liveliness::ManualByParticipant { lease_duration },
        ) => (Liveliness::Automatic, std_duration(lease_duration)),
    }
}

fn std_duration(duration: DdsDuration) -> Option<Duration> {
    (duration != DdsDuration::INFINITE).then(|| duration.to_std())
}

fn dds_duration(duration: Option<Duration>) -> DdsDuration {
    duration.map_or(DdsDuration::INFINITE, DdsDuration::from_std)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn mapped(qos: QosProfile, direction: Direction) -> Result<QosPolicies, MiddlewareError> {
        policies(&Endpoint::new("rt/t", "T", qos), direction)
    }

    #[test]
    fn the_ros_default_is_reliable_volatile_keep_last_10_and_never_blocks() {
        let qos = mapped(QosProfile::DEFAULT, Direction::Out).unwrap();
        assert_eq!(qos.reliable_max_blocking_time(), Some(DdsDuration::ZERO));
        assert_eq!(qos.durability(), Some(policy::Durability::Volatile));
        assert_eq!(qos.history(), Some(policy::History::KeepLast { depth: 10 }));
        assert_eq!(qos.resource_limits().unwrap().max_samples, Endpoint::SEND_WINDOW.cast_signed());
    }

    #[test]
    fn a_history_deeper_than_the_send_window_widens_it() {
        let qos = mapped(QosProfile::DEFAULT.keep_last(100_000), Direction::Out).unwrap();
        assert_eq!(qos.resource_limits().unwrap().max_samples, 100_000);
    }

    #[test]
    fn what_cannot_be_done_is_refused_with_the_topic_and_the_way_out() {
        let error = mapped(QosProfile::DEFAULT.keep_last(0), Direction::In).unwrap_err().to_string();
        assert!(error.contains("rt/t") && error.contains("1 or more"), "{error}");
    }

    #[test]
    fn what_a_peer_does_not_tell_is_the_default_of_dds() {
        let untold = QosPolicies::default();
        assert_eq!(
            reliability_and_durability(&untold, Direction::Out),
            (Reliability::Reliable, Durability::Volatile)
        );
        assert_eq!(reliability_and_durability(&untold, Direction::In).0, Reliability::BestEffort);
    }
}
