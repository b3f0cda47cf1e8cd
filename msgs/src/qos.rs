//! Quality of service in the terms of ROS 2: what a publisher offers and a subscription requests.
//!
//! The presets are those of `rmw/qos_profiles.h` and `rcl/logging_rosout.h` (branch jazzy).

use std::fmt;
use std::time::Duration;

use serde::{Deserialize, Serialize};

/// A policy with named values. All users of the names refer to this trait: robot files, the command line, the
/// metadata of bags, ROS parameters and the answers of other programs.
pub trait Word: Copy + PartialEq + 'static {
    /// All values of the policy.
    const ALL: &'static [Self];

    /// The name in ROS 2 (`rmw/qos_string_conversions.h`).
    fn name(self) -> &'static str;

    /// Returns the value with this name.
    #[must_use]
    fn of_name(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|value| value.name() == name)
    }
}

macro_rules! words {
    ($(#[$doc:meta])* $policy:ident { $($(#[$value_doc:meta])* $value:ident = $name:literal),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
        pub enum $policy {
            $($(#[$value_doc])* #[serde(rename = $name)] $value),+
        }

        impl Word for $policy {
            const ALL: &'static [Self] = &[$(Self::$value),+];

            fn name(self) -> &'static str {
                match self { $(Self::$value => $name),+ }
            }
        }

        impl fmt::Display for $policy {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(self.name())
            }
        }
    };
}

words! {
    /// Whether a sample is sent again until each matched subscription has it.
    Reliability {
        /// Lost samples are sent again.
        Reliable = "reliable",
        /// Lost samples are not repeated.
        BestEffort = "best_effort",
    }
}
words! {
    /// Whether a subscription that joins late receives what was published before.
    Durability {
        /// It does not receive earlier samples.
        Volatile = "volatile",
        /// It receives the latest samples, up to the depth of the history ("latched").
        TransientLocal = "transient_local",
    }
}
words! {
    /// What asserts that a publisher is alive.
    Liveliness {
        /// The middleware.
        Automatic = "automatic",
        /// The program, for each topic.
        ManualByTopic = "manual_by_topic",
    }
}

/// How many samples are kept for repetition and for late subscriptions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(tag = "history", content = "depth", rename_all = "snake_case")]
pub enum History {
    /// The latest n, at least 1.
    KeepLast(u32),
    /// All, up to the limits of the middleware.
    KeepAll,
}

impl History {
    /// The name of [`History::KeepLast`] in ROS 2.
    pub const KEEP_LAST: &str = "keep_last";
    /// The name of [`History::KeepAll`] in ROS 2.
    pub const KEEP_ALL: &str = "keep_all";

    /// The name in ROS 2, without the depth.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::KeepLast(_) => Self::KEEP_LAST,
            Self::KeepAll => Self::KEEP_ALL,
        }
    }

    /// The depth, if it is limited.
    #[must_use]
    pub const fn depth(self) -> Option<u32> {
        match self {
            Self::KeepLast(depth) => Some(depth),
            Self::KeepAll => None,
        }
    }
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
    /// How long a publisher may go without an assertion before it counts as not alive.
    pub liveliness_lease_duration: Option<Duration>,
}

/// A policy that is fixed, or chosen when the endpoint is created.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Policy<T> {
    /// The best value that matches all other endpoints known when the endpoint is created.
    #[serde(rename = "best_available")]
    BestAvailable,
    /// This value.
    #[serde(untagged)]
    Given(T),
}

/// The name for a policy, or a whole profile, that is chosen when the endpoint is created.
pub const BEST_AVAILABLE: &str = "best_available";
/// The name for a policy, or a whole profile, that is left to the middleware.
pub const SYSTEM_DEFAULT: &str = "system_default";

/// The QoS to offer or request, parts of which may depend on the endpoints of others. Serialized with the
/// names of robot files.
///
/// The rules for *best available* are those of `rmw_dds_common` (branch jazzy, `src/qos.cpp`):
///
/// | policy | publisher | subscription |
/// | --- | --- | --- |
/// | reliability | reliable | reliable if all publishers are |
/// | durability | transient local | transient local if all publishers are |
/// | liveliness | manual by topic if a subscription asks for it | manual by topic if all publishers are |
/// | deadline, lease | the shortest that a subscription asks for, less 1 ns | the longest that a publisher offers, and 1 ns |
///
/// As in `rmw_dds_common`, it is decided once, and endpoints that join later have no influence. A
/// subscription that is created before any publisher is known therefore requests reliable and transient
/// local; only liveliness is then automatic, because manual by topic would match hardly any publisher.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct QosRequest {
    /// See [`Reliability`].
    pub reliability: Policy<Reliability>,
    /// See [`Durability`].
    pub durability: Policy<Durability>,
    /// See [`History`].
    #[serde(flatten)]
    pub history: History,
    /// The longest time between two samples.
    #[serde(with = "policy_time")]
    pub deadline: Policy<Option<Duration>>,
    /// How long a sample is valid.
    #[serde(with = "time")]
    pub lifespan: Option<Duration>,
    /// See [`Liveliness`].
    pub liveliness: Policy<Liveliness>,
    /// How long a publisher may go without an assertion before it counts as not alive.
    #[serde(with = "policy_time")]
    pub liveliness_lease_duration: Policy<Option<Duration>>,
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

    /// The presets with their names in ROS 2 tools, and `latched`.
    pub const PRESETS: [(&str, Self); 8] = [
        ("default", Self::DEFAULT),
        ("sensor_data", Self::SENSOR_DATA),
        ("parameters", Self::PARAMETERS),
        ("parameter_events", Self::PARAMETER_EVENTS),
        ("services_default", Self::SERVICES),
        ("rosout", Self::ROSOUT),
        ("clock", Self::CLOCK),
        ("latched", Self::LATCHED),
    ];

    /// Returns the preset with this name.
    #[must_use]
    pub fn preset(name: &str) -> Option<Self> {
        Self::PRESETS.into_iter().find(|(known, _)| *known == name).map(|(_, profile)| profile)
    }

    /// Returns this profile with history keep last `depth`.
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

/// On the wire, durations are fractions of 2^-32 s: a duration that is read and written again may be slightly
/// shorter or longer, and would then not match.
const ROUNDING: Duration = Duration::from_nanos(1);

impl QosRequest {
    /// All policies best available, keep last 10: `rmw_qos_profile_best_available`.
    pub const BEST_AVAILABLE: Self = Self {
        history: History::KeepLast(10),
        reliability: Policy::BestAvailable,
        durability: Policy::BestAvailable,
        deadline: Policy::BestAvailable,
        lifespan: None,
        liveliness: Policy::BestAvailable,
        liveliness_lease_duration: Policy::BestAvailable,
    };

    /// Returns the profile, if all policies are fixed.
    #[must_use]
    pub fn profile(&self) -> Option<QosProfile> {
        Some(QosProfile {
            history: self.history,
            reliability: self.reliability.given()?,
            durability: self.durability.given()?,
            deadline: self.deadline.given()?,
            lifespan: self.lifespan,
            liveliness: self.liveliness.given()?,
            liveliness_lease_duration: self.liveliness_lease_duration.given()?,
        })
    }

    /// Returns the QoS that a publisher offers to these subscriptions.
    #[must_use]
    pub fn offered_to(&self, subscriptions: &[QosProfile]) -> QosProfile {
        let shortest = |times: &dyn Fn(&QosProfile) -> Option<Duration>| {
            let shortest = subscriptions.iter().filter_map(times).min();
            shortest.map(|shortest| shortest.saturating_sub(ROUNDING))
        };
        let is_manual = |qos: &QosProfile| qos.liveliness == Liveliness::ManualByTopic;
        self.resolve(QosProfile {
            history: self.history,
            reliability: Reliability::Reliable,
            durability: Durability::TransientLocal,
            deadline: shortest(&|qos| qos.deadline),
            lifespan: self.lifespan,
            liveliness: match subscriptions.iter().any(is_manual) {
                true => Liveliness::ManualByTopic,
                false => Liveliness::Automatic,
            },
            liveliness_lease_duration: shortest(&|qos| qos.liveliness_lease_duration),
        })
    }

    /// Returns the QoS that a subscription requests from these publishers.
    #[must_use]
    pub fn requested_of(&self, publishers: &[QosProfile]) -> QosProfile {
        let all = |has: fn(&QosProfile) -> bool| publishers.iter().all(has);
        let longest = |times: &dyn Fn(&QosProfile) -> Option<Duration>| {
            let longest = publishers.iter().filter_map(times).max();
            longest.map(|longest| longest.saturating_add(ROUNDING))
        };
        self.resolve(QosProfile {
            history: self.history,
            reliability: match all(|qos| qos.reliability == Reliability::Reliable) {
                true => Reliability::Reliable,
                false => Reliability::BestEffort,
            },
            durability: match all(|qos| qos.durability == Durability::TransientLocal) {
                true => Durability::TransientLocal,
                false => Durability::Volatile,
            },
            deadline: longest(&|qos| qos.deadline),
            lifespan: self.lifespan,
            liveliness: match !publishers.is_empty() && all(|qos| qos.liveliness == Liveliness::ManualByTopic)
            {
                true => Liveliness::ManualByTopic,
                false => Liveliness::Automatic,
            },
            liveliness_lease_duration: longest(&|qos| qos.liveliness_lease_duration),
        })
    }

    fn resolve(&self, best: QosProfile) -> QosProfile {
        QosProfile {
            reliability: self.reliability.given().unwrap_or(best.reliability),
            durability: self.durability.given().unwrap_or(best.durability),
            deadline: self.deadline.given().unwrap_or(best.deadline),
            liveliness: self.liveliness.given().unwrap_or(best.liveliness),
            liveliness_lease_duration: self
                .liveliness_lease_duration
                .given()
                .unwrap_or(best.liveliness_lease_duration),
            ..best
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

/// Formats reliability, durability and history, and other policies that differ from the default.
impl fmt::Display for QosRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |policy: Option<&'static str>| policy.unwrap_or(BEST_AVAILABLE);
        let period =
            |policy: Policy<Option<Duration>>| policy.given().map_or(BEST_AVAILABLE.into(), time::text);
        let reliability = name(self.reliability.given().map(Word::name));
        let durability = name(self.durability.given().map(Word::name));
        write!(f, "{reliability} {durability} {}", self.history.name())?;
        if let Some(depth) = self.history.depth() {
            write!(f, " {depth}")?;
        }
        for (policy, value, usual) in [
            ("deadline", period(self.deadline), time::INFINITE),
            ("lifespan", time::text(self.lifespan), time::INFINITE),
            (
                "liveliness",
                name(self.liveliness.given().map(Word::name)).to_owned(),
                Liveliness::Automatic.name(),
            ),
            ("lease", period(self.liveliness_lease_duration), time::INFINITE),
        ] {
            if value != usual {
                write!(f, " {policy} {value}")?;
            }
        }
        Ok(())
    }
}

impl<T: Copy> Policy<T> {
    /// Returns the policy, if it is fixed.
    pub fn given(self) -> Option<T> {
        match self {
            Self::Given(policy) => Some(policy),
            Self::BestAvailable => None,
        }
    }
}

/// Serialises a time with its unit, such as `100ms`, or `infinite`.
mod time {
    use downbeat_files::duration;
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};
    use std::time::Duration;

    pub(super) const INFINITE: &str = "infinite";

    pub(super) fn text(time: Option<Duration>) -> String {
        time.map_or_else(|| INFINITE.to_owned(), |time| format!("{time:?}"))
    }

    pub(super) fn parse<E: Error>(text: &str) -> Result<Option<Duration>, E> {
        if text == INFINITE {
            return Ok(None);
        }
        // `Debug` writes at most nanoseconds, so the nearest one is exact.
        duration::parse(text).map(Some).map_err(|problem| E::custom(format!("{problem}, or {INFINITE}")))
    }

    pub(super) fn serialize<S: Serializer>(
        time: &Option<Duration>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&text(*time))
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<Duration>, D::Error> {
        parse(&String::deserialize(deserializer)?)
    }
}

/// Like [`time`], or `best_available`.
mod policy_time {
    use super::{BEST_AVAILABLE, Policy, time};
    use serde::{Deserialize, Deserializer, Serializer};
    use std::time::Duration;

    pub(super) fn serialize<S: Serializer>(
        policy: &Policy<Option<Duration>>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        match policy {
            Policy::BestAvailable => serializer.serialize_str(BEST_AVAILABLE),
            Policy::Given(given) => time::serialize(given, serializer),
        }
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Policy<Option<Duration>>, D::Error> {
        let text = String::deserialize(deserializer)?;
        match &*text {
            BEST_AVAILABLE => Ok(Policy::BestAvailable),
            text => time::parse(text).map(Policy::Given),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn every_listed_preset_exists() {
        for (name, profile) in QosProfile::PRESETS {
            assert_eq!(QosProfile::preset(name), Some(profile), "{name}");
        }
        assert!(QosProfile::preset("sensor").is_none());
    }

    #[test]
    fn a_subscription_asks_for_what_all_publishers_offer() {
        let deadline = |milliseconds| QosProfile { deadline: Some(milliseconds * MS), ..QosProfile::LATCHED };
        let publishers = [deadline(20), deadline(50)];
        let best = |publishers: &[QosProfile]| QosRequest::BEST_AVAILABLE.requested_of(publishers);
        assert_eq!(
            best(&publishers),
            QosProfile {
                history: History::KeepLast(10),
                deadline: Some(50 * MS + ROUNDING),
                ..QosProfile::LATCHED
            }
        );

        let mixed = [publishers[0], QosProfile::SENSOR_DATA];
        let expected =
            QosProfile { deadline: Some(20 * MS + ROUNDING), ..QosProfile::SENSOR_DATA.keep_last(10) };
        assert_eq!(best(&mixed), expected);
        assert_eq!(best(&[]).reliability, Reliability::Reliable, "there is no publisher");
    }

    #[test]
    fn a_publisher_offers_what_every_subscription_can_ask_for() {
        let manual = QosProfile {
            liveliness: Liveliness::ManualByTopic,
            liveliness_lease_duration: Some(30 * MS),
            ..QosProfile::SENSOR_DATA
        };
        let lease = QosProfile { liveliness_lease_duration: Some(10 * MS), ..QosProfile::DEFAULT };
        let offered = QosRequest::BEST_AVAILABLE.offered_to(&[manual, lease]);
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
        assert_eq!(given.requested_of(&[QosProfile::LATCHED]), QosProfile::SENSOR_DATA);
        assert_eq!(given.profile(), Some(QosProfile::SENSOR_DATA));
        assert_eq!(QosRequest { durability: Policy::BestAvailable, ..given }.profile(), None);
    }

    #[test]
    fn a_request_is_written_in_the_words_of_ros_and_read_again() {
        let request = QosRequest {
            history: History::KeepAll,
            durability: Policy::BestAvailable,
            deadline: Policy::Given(Some(Duration::from_nanos(1_500_001))),
            lifespan: Some(Duration::from_secs(2)),
            ..QosRequest::default()
        };
        let yaml = serde_norway::to_string(&request).unwrap();
        let expected = "reliability: reliable\ndurability: best_available\nhistory: keep_all\ndeadline: 1.500001ms\n\
                        lifespan: 2s\nliveliness: automatic\nliveliness_lease_duration: infinite\n";
        assert_eq!(yaml, expected);
        for request in [request, QosRequest::BEST_AVAILABLE, QosProfile::SENSOR_DATA.into()] {
            let yaml = serde_norway::to_string(&request).unwrap();
            assert_eq!(serde_norway::from_str::<QosRequest>(&yaml).unwrap(), request, "{yaml}");
        }
        assert_eq!(request.to_string(), "reliable best_available keep_all deadline 1.500001ms lifespan 2s");
        assert_eq!(Reliability::of_name("best_effort"), Some(Reliability::BestEffort));
    }
}
