//! Quality of service in the terms of ROS 2: what a publisher offers and a subscription requests.
//!
//! The presets are those of `rmw/qos_profiles.h` and `rcl/logging_rosout.h` (branch jazzy).

use std::time::Duration;

/// Whether a sample is sent again until each matched subscription has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Reliability {
    /// Lost samples are repeated.
    Reliable,
    /// Lost samples are not repeated.
    BestEffort,
}

/// Whether a late subscription receives samples that were published before it joined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Durability {
    /// It does not receive earlier samples.
    Volatile,
    /// It receives the latest samples, up to the depth of the history ("latched").
    TransientLocal,
}

/// How many samples are kept for repetition and for late subscriptions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum History {
    /// The latest n, at least 1.
    KeepLast(u32),
    /// All, up to the limits of the middleware.
    KeepAll,
}

/// Who asserts that a publisher is alive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Liveliness {
    /// The middleware.
    Automatic,
    /// The program, for each topic.
    ManualByTopic,
}

/// A quality of service profile. `None` means *infinite* for every duration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct QosProfile {
    /// See [`History`].
    pub history: History,
    /// See [`Reliability`].
    pub reliability: Reliability,
    /// See [`Durability`].
    pub durability: Durability,
    /// The longest time between two samples.
    pub deadline: Option<Duration>,
    /// How long a sample is valid.
    pub lifespan: Option<Duration>,
    /// See [`Liveliness`].
    pub liveliness: Liveliness,
    /// How long a publisher may be silent before it is considered lost.
    pub liveliness_lease_duration: Option<Duration>,
}

impl QosProfile {
    /// Reliable, volatile, keep last 10: the default of `rclcpp`.
    pub const DEFAULT: Self = Self {
        history: History::KeepLast(10),
        reliability: Reliability::Reliable,
        durability: Durability::Volatile,
        deadline: None,
        lifespan: None,
        liveliness: Liveliness::Automatic,
        liveliness_lease_duration: None,
    };
    /// Best effort, volatile, keep last 5: for sensors, where the newest sample matters more than
    /// completeness.
    pub const SENSOR_DATA: Self = Self { reliability: Reliability::BestEffort, ..Self::DEFAULT.keep_last(5) };
    /// Reliable, volatile, keep last 1000.
    pub const PARAMETERS: Self = Self::DEFAULT.keep_last(1000);
    /// Reliable, volatile, keep last 1000.
    pub const PARAMETER_EVENTS: Self = Self::DEFAULT.keep_last(1000);
    /// Reliable, volatile, keep last 10.
    pub const SERVICES: Self = Self::DEFAULT;
    /// Reliable, transient local, keep last 1000, lifespan 10 s.
    pub const ROSOUT: Self = Self {
        durability: Durability::TransientLocal,
        lifespan: Some(Duration::from_secs(10)),
        ..Self::DEFAULT.keep_last(1000)
    };
    /// Best effort, volatile, keep last 1.
    pub const CLOCK: Self = Self { reliability: Reliability::BestEffort, ..Self::DEFAULT.keep_last(1) };
    /// Reliable, transient local, keep last 1: a topic that holds a value, such as a robot description.
    pub const LATCHED: Self = Self { durability: Durability::TransientLocal, ..Self::DEFAULT.keep_last(1) };

    /// The names that [`QosProfile::preset`] accepts, for error messages.
    pub const PRESETS: [&str; 8] = [
        "default",
        "sensor_data",
        "parameters",
        "parameter_events",
        "services_default",
        "rosout",
        "clock",
        "latched",
    ];

    /// The preset of that name, spelled as in ROS 2 tools.
    #[must_use]
    pub fn preset(name: &str) -> Option<Self> {
        Some(match name {
            "default" => Self::DEFAULT,
            "sensor_data" => Self::SENSOR_DATA,
            "parameters" => Self::PARAMETERS,
            "parameter_events" => Self::PARAMETER_EVENTS,
            "services_default" => Self::SERVICES,
            "rosout" => Self::ROSOUT,
            "clock" => Self::CLOCK,
            "latched" => Self::LATCHED,
            _ => return None,
        })
    }

    /// The same profile with history keep last `depth`.
    #[must_use]
    pub const fn keep_last(self, depth: u32) -> Self {
        Self { history: History::KeepLast(depth), ..self }
    }
}

impl Default for QosProfile {
    fn default() -> Self {
        Self::DEFAULT
    }
}

#[cfg(test)]
mod tests {
    use super::QosProfile;

    #[test]
    fn every_listed_preset_exists() {
        for name in QosProfile::PRESETS {
            assert!(QosProfile::preset(name).is_some(), "{name}");
        }
        assert!(QosProfile::preset("sensor").is_none());
    }
}
