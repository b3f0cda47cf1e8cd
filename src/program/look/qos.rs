//! Quality of service on the command line: the options `--qos-…` of `ros2 topic`.

use std::time::Duration;

use crate::bridge::ros::{Policy, QosRequest};
use crate::msgs::qos::{Durability, History, Liveliness, QosProfile, Reliability};
use clap::{Args, ValueEnum};

use super::values::seconds;

#[derive(Args)]
pub(crate) struct QosArguments {
    /// The preset to start from; default is sensor_data for subscribing, default for publishing.
    #[arg(long, value_name = "PRESET", value_enum)]
    qos_profile: Option<Preset>,
    /// The depth of the history, instead of the preset's.
    #[arg(long, value_name = "N")]
    qos_depth: Option<u32>,
    /// Overrides the preset.
    #[arg(long, value_name = "HISTORY", value_enum)]
    qos_history: Option<HistoryKind>,
    /// Overrides the preset; by default, a subscription requests what all publishers offer.
    #[arg(long, value_name = "RELIABILITY", value_enum)]
    qos_reliability: Option<ReliabilityKind>,
    /// Overrides the preset; by default, a subscription requests what all publishers offer.
    #[arg(long, value_name = "DURABILITY", value_enum)]
    qos_durability: Option<DurabilityKind>,
    /// Overrides the preset.
    #[arg(long, value_name = "LIVELINESS", value_enum)]
    qos_liveliness: Option<LivelinessKind>,
    /// The lease of liveliness, instead of the preset's.
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    qos_liveliness_lease_duration_seconds: Option<Duration>,
}

#[derive(Clone, Copy, ValueEnum)]
#[value(rename_all = "snake_case")]
pub(super) enum Preset {
    Default,
    SystemDefault,
    SensorData,
    ServicesDefault,
    Parameters,
    ParameterEvents,
    ActionStatusDefault,
    BestAvailable,
}

#[derive(Clone, Copy, ValueEnum)]
#[value(rename_all = "snake_case")]
enum HistoryKind {
    SystemDefault,
    KeepLast,
    KeepAll,
}

#[derive(Clone, Copy, ValueEnum)]
#[value(rename_all = "snake_case")]
enum ReliabilityKind {
    SystemDefault,
    Reliable,
    BestEffort,
    BestAvailable,
}

#[derive(Clone, Copy, ValueEnum)]
#[value(rename_all = "snake_case")]
enum DurabilityKind {
    SystemDefault,
    TransientLocal,
    Volatile,
    BestAvailable,
}

#[derive(Clone, Copy, ValueEnum)]
#[value(rename_all = "snake_case")]
enum LivelinessKind {
    SystemDefault,
    Automatic,
    ManualByTopic,
    BestAvailable,
}

impl QosArguments {
    /// Whether a policy is given, so that the publishers' QoS is not considered.
    pub(super) fn has_policies(&self) -> bool {
        self.qos_depth.is_some()
            || self.qos_history.is_some()
            || self.qos_reliability.is_some()
            || self.qos_durability.is_some()
            || self.qos_liveliness.is_some()
            || self.qos_liveliness_lease_duration_seconds.is_some()
    }

    /// The preset with the policies that are given.
    pub(super) fn request(&self, unless_given: Preset) -> QosRequest {
        let mut request = self.qos_profile.unwrap_or(unless_given).request();
        let depth = match request.history {
            History::KeepLast(depth) => depth,
            History::KeepAll => 10,
        };
        match self.qos_history {
            None => {}
            Some(HistoryKind::KeepAll) => request.history = History::KeepAll,
            Some(HistoryKind::KeepLast | HistoryKind::SystemDefault) => {
                request.history = History::KeepLast(depth)
            }
        }
        // As in rclpy, 0 means none.
        if let (Some(depth @ 1..), History::KeepLast(_)) = (self.qos_depth, request.history) {
            request.history = History::KeepLast(depth);
        }
        if let Some(kind) = self.qos_reliability {
            request.reliability = match kind {
                ReliabilityKind::SystemDefault | ReliabilityKind::Reliable => {
                    Policy::Given(Reliability::Reliable)
                }
                ReliabilityKind::BestEffort => Policy::Given(Reliability::BestEffort),
                ReliabilityKind::BestAvailable => Policy::BestAvailable,
            };
        }
        if let Some(kind) = self.qos_durability {
            request.durability = match kind {
                DurabilityKind::SystemDefault | DurabilityKind::Volatile => {
                    Policy::Given(Durability::Volatile)
                }
                DurabilityKind::TransientLocal => Policy::Given(Durability::TransientLocal),
                DurabilityKind::BestAvailable => Policy::BestAvailable,
            };
        }
        if let Some(kind) = self.qos_liveliness {
            request.liveliness = match kind {
                LivelinessKind::SystemDefault | LivelinessKind::Automatic => {
                    Policy::Given(Liveliness::Automatic)
                }
                LivelinessKind::ManualByTopic => Policy::Given(Liveliness::ManualByTopic),
                LivelinessKind::BestAvailable => Policy::BestAvailable,
            };
        }
        if let Some(lease) = self.qos_liveliness_lease_duration_seconds {
            request.liveliness_lease_duration = Policy::Given(Some(lease));
        }
        request
    }
}

impl Preset {
    fn request(self) -> QosRequest {
        given(match self {
            Self::Default | Self::SystemDefault => QosProfile::DEFAULT,
            Self::SensorData => QosProfile::SENSOR_DATA,
            Self::ServicesDefault => QosProfile::SERVICES,
            Self::Parameters => QosProfile::PARAMETERS,
            Self::ParameterEvents => QosProfile::PARAMETER_EVENTS,
            // As in rcl_action: latched, depth 1.
            Self::ActionStatusDefault => QosProfile::LATCHED,
            Self::BestAvailable => return QosRequest::BEST_AVAILABLE,
        })
    }
}

/// A fully specified request.
pub(super) fn given(profile: QosProfile) -> QosRequest {
    QosRequest {
        history: profile.history,
        reliability: Policy::Given(profile.reliability),
        durability: Policy::Given(profile.durability),
        deadline: Policy::Given(profile.deadline),
        lifespan: profile.lifespan,
        liveliness: Policy::Given(profile.liveliness),
        liveliness_lease_duration: Policy::Given(profile.liveliness_lease_duration),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        qos: QosArguments,
    }

    fn read(line: &[&str]) -> QosArguments {
        Line::try_parse_from([&["x"], line].concat()).map(|line| line.qos).unwrap()
    }

    #[test]
    fn options_override_the_policies_of_a_preset() {
        let nothing = read(&[]);
        assert!(!nothing.has_policies());
        assert_eq!(nothing.request(Preset::SensorData), given(QosProfile::SENSOR_DATA));
        let some =
            read(&["--qos-profile", "parameters", "--qos-depth", "3", "--qos-durability", "transient_local"]);
        assert!(some.has_policies());
        let expected =
            QosProfile { durability: Durability::TransientLocal, ..QosProfile::PARAMETERS.keep_last(3) };
        assert_eq!(some.request(Preset::Default), given(expected));
        let best = read(&["--qos-reliability", "best_available"]);
        assert_eq!(best.request(Preset::Default).reliability, Policy::BestAvailable);
    }
}
