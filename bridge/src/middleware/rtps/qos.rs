//! Quality of service of ROS 2 as policies of DDS, and back.

use crate::middleware::{Endpoint, MiddlewareError};
use downbeat_msgs::qos::{Durability, History, Liveliness, QosProfile, Reliability};
use downbeat_rtps::qos::{self, Qos, Representation};

/// The policies of a local endpoint.
pub(super) fn to_rtps(endpoint: &Endpoint) -> Result<Qos, MiddlewareError> {
    let QosProfile {
        history,
        reliability,
        durability,
        deadline,
        lifespan,
        liveliness,
        liveliness_lease_duration,
    } = endpoint.qos;
    let history = match history {
        History::KeepLast(0) => {
            return Err(MiddlewareError::Qos {
                topic_name: endpoint.topic_name.clone(),
                reason: "history depth 0 keeps nothing; use 1 or more".to_owned(),
            });
        }
        History::KeepLast(depth) => qos::History::KeepLast(depth),
        History::KeepAll => qos::History::KeepAll,
    };
    Ok(Qos {
        reliability: match reliability {
            Reliability::Reliable => qos::Reliability::Reliable,
            Reliability::BestEffort => qos::Reliability::BestEffort,
        },
        durability: match durability {
            Durability::Volatile => qos::Durability::Volatile,
            Durability::TransientLocal => qos::Durability::TransientLocal,
        },
        history,
        deadline,
        lifespan,
        liveliness: match liveliness {
            Liveliness::Automatic => qos::Liveliness::Automatic,
            Liveliness::ManualByTopic => qos::Liveliness::ManualByTopic,
        },
        lease: liveliness_lease_duration,
        representation: vec![Representation::XCDR1],
        ..Qos::writer_default()
    })
}

/// The policies of another endpoint as ROS 2 names them. *Manual by participant*, which has no name there,
/// counts as automatic.
pub(super) fn from_rtps(qos: &Qos) -> QosProfile {
    QosProfile {
        history: match qos.history {
            qos::History::KeepLast(depth) => History::KeepLast(depth),
            qos::History::KeepAll => History::KeepAll,
        },
        reliability: match qos.reliability {
            qos::Reliability::Reliable => Reliability::Reliable,
            qos::Reliability::BestEffort => Reliability::BestEffort,
        },
        durability: match qos.durability {
            qos::Durability::Volatile => Durability::Volatile,
            _ => Durability::TransientLocal,
        },
        deadline: qos.deadline,
        lifespan: qos.lifespan,
        liveliness: match qos.liveliness {
            qos::Liveliness::ManualByTopic => Liveliness::ManualByTopic,
            _ => Liveliness::Automatic,
        },
        liveliness_lease_duration: qos.lease,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::time::Duration;

    #[test]
    fn profiles_of_ros_survive_the_way_there_and_back() {
        let second = Some(Duration::from_secs(1));
        let manual = QosProfile {
            history: History::KeepAll,
            deadline: second,
            liveliness: Liveliness::ManualByTopic,
            liveliness_lease_duration: second,
            ..QosProfile::DEFAULT
        };
        for profile in [QosProfile::DEFAULT, QosProfile::SENSOR_DATA, QosProfile::ROSOUT, manual] {
            assert_eq!(from_rtps(&to_rtps(&Endpoint::new("rt/t", "T", profile)).unwrap()), profile);
        }
    }

    #[test]
    fn a_history_without_samples_is_refused_with_the_topic_and_the_way_out() {
        let endpoint = Endpoint::new("rt/t", "T", QosProfile::DEFAULT.keep_last(0));
        let error = to_rtps(&endpoint).unwrap_err().to_string();
        assert!(error.contains("rt/t") && error.contains("1 or more"), "{error}");
    }
}
