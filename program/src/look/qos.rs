//! Quality of service on the command line: the options `--qos-…` of `ros2 topic`.

use std::time::Duration;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum};
use downbeat_msgs::qos::{
    BEST_AVAILABLE, Durability, History, Liveliness, Policy, QosProfile, QosRequest, Reliability,
    SYSTEM_DEFAULT, Word,
};

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
    #[arg(long, value_name = "HISTORY", value_parser = [SYSTEM_DEFAULT, History::KEEP_LAST, History::KEEP_ALL])]
    qos_history: Option<String>,
    /// Overrides the preset; by default, a subscription requests what all publishers offer.
    #[arg(long, value_name = "RELIABILITY", value_parser = policy::<Reliability>())]
    qos_reliability: Option<Policy<Reliability>>,
    /// Overrides the preset; by default, a subscription requests what all publishers offer.
    #[arg(long, value_name = "DURABILITY", value_parser = policy::<Durability>())]
    qos_durability: Option<Policy<Durability>>,
    /// Overrides the preset.
    #[arg(long, value_name = "LIVELINESS", value_parser = policy::<Liveliness>())]
    qos_liveliness: Option<Policy<Liveliness>>,
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

/// Parses a policy by its name, or one of the names for a choice that is left open.
fn policy<T: Word + Send + Sync>() -> impl TypedValueParser<Value = Policy<T>> {
    let words = T::ALL.iter().map(|policy| policy.name()).chain([SYSTEM_DEFAULT, BEST_AVAILABLE]);
    PossibleValuesParser::new(words.collect::<Vec<_>>()).map(|word| match &*word {
        BEST_AVAILABLE => Policy::BestAvailable,
        // The first name is the default of ROS 2.
        word => Policy::Given(T::of_name(word).unwrap_or(T::ALL[0])),
    })
}

impl QosArguments {
    /// Returns whether a policy is given, so that the publishers' QoS is not considered.
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
        match self.qos_history.as_deref() {
            None => {}
            Some(History::KEEP_ALL) => request.history = History::KeepAll,
            Some(_) => request.history = History::KeepLast(depth),
        }
        // As in rclpy, 0 means none.
        if let (Some(depth @ 1..), History::KeepLast(_)) = (self.qos_depth, request.history) {
            request.history = History::KeepLast(depth);
        }
        request.reliability = self.qos_reliability.unwrap_or(request.reliability);
        request.durability = self.qos_durability.unwrap_or(request.durability);
        request.liveliness = self.qos_liveliness.unwrap_or(request.liveliness);
        if let Some(lease) = self.qos_liveliness_lease_duration_seconds {
            request.liveliness_lease_duration = Policy::Given(Some(lease));
        }
        request
    }
}

impl Preset {
    fn request(self) -> QosRequest {
        match self {
            Self::Default | Self::SystemDefault => QosProfile::DEFAULT,
            Self::SensorData => QosProfile::SENSOR_DATA,
            Self::ServicesDefault => QosProfile::SERVICES,
            Self::Parameters => QosProfile::PARAMETERS,
            Self::ParameterEvents => QosProfile::PARAMETER_EVENTS,
            // As in rcl_action: latched, depth 1.
            Self::ActionStatusDefault => QosProfile::LATCHED,
            Self::BestAvailable => return QosRequest::BEST_AVAILABLE,
        }
        .into()
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
        assert_eq!(nothing.request(Preset::SensorData), QosProfile::SENSOR_DATA.into());
        let some =
            read(&["--qos-profile", "parameters", "--qos-depth", "3", "--qos-durability", "transient_local"]);
        assert!(some.has_policies());
        let expected =
            QosProfile { durability: Durability::TransientLocal, ..QosProfile::PARAMETERS.keep_last(3) };
        assert_eq!(some.request(Preset::Default), expected.into());
        let best = read(&["--qos-reliability", "best_available"]);
        assert_eq!(best.request(Preset::Default).reliability, Policy::BestAvailable);
    }
}
