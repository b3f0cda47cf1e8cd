//! Quality of service as stored by rosbag2, which can express less (`unknown`) or more than [`QosProfile`].

use std::time::Duration;

use downbeat_msgs::qos::{
    BEST_AVAILABLE, Durability, History, Liveliness, QosProfile, Reliability, SYSTEM_DEFAULT, Word,
};
use serde::de::{Deserialize, Deserializer, Visitor};

/// One policy: the names are those of `rmw/qos_string_conversions.h` (metadata version 9), the numbers those
/// of `rmw/types.h` (older versions).
macro_rules! policy {
    ($(#[$doc:meta])* $name:ident, $what:literal: $($(#[$variant_doc:meta])* $variant:ident = $number:literal $text:expr),+ $(,)?) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name {
            $($(#[$variant_doc])* $variant),+
        }

        impl $name {
            /// The name in metadata.yaml.
            #[must_use]
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $text),+ }
            }

            /// The number in older versions.
            pub(super) fn number(self) -> u64 {
                match self { $(Self::$variant => $number),+ }
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                struct Policy;
                impl Visitor<'_> for Policy {
                    type Value = $name;

                    fn expecting(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                        formatter.write_str(concat!("a ", $what, " policy, as a name or as a number"))
                    }

                    // Like rosbag2, reads unknown values as `unknown`, so that newer bags can be opened.
                    fn visit_str<E>(self, text: &str) -> Result<$name, E> {
                        let known = [$($name::$variant),+].into_iter().find(|policy| policy.name() == text);
                        Ok(known.unwrap_or($name::Unknown))
                    }

                    fn visit_u64<E>(self, number: u64) -> Result<$name, E> {
                        Ok(match number { $($number => $name::$variant,)+ _ => $name::Unknown })
                    }
                }
                deserializer.deserialize_any(Policy)
            }
        }
    };
}

policy! {
    /// How many samples a publisher kept.
    RecordedHistory, "history":
    /// The middleware's own choice.
    SystemDefault = 0 SYSTEM_DEFAULT,
    /// The latest `depth`.
    KeepLast = 1 History::KEEP_LAST,
    /// All.
    KeepAll = 2 History::KEEP_ALL,
    /// Not discoverable: DDS discovery does not include the history of a remote publisher, so the real
    /// recorder usually writes this.
    Unknown = 3 "unknown",
}
policy! {
    /// Whether lost samples were sent again.
    RecordedReliability, "reliability":
    /// The middleware's own choice.
    SystemDefault = 0 SYSTEM_DEFAULT,
    /// Sent again.
    Reliable = 1 Reliability::Reliable.name(),
    /// Not sent again.
    BestEffort = 2 Reliability::BestEffort.name(),
    /// Not discoverable.
    Unknown = 3 "unknown",
    /// The best that matches every peer.
    BestAvailable = 4 BEST_AVAILABLE,
}
policy! {
    /// Whether late subscriptions received older samples.
    RecordedDurability, "durability":
    /// The middleware's own choice.
    SystemDefault = 0 SYSTEM_DEFAULT,
    /// They did.
    TransientLocal = 1 Durability::TransientLocal.name(),
    /// They did not.
    Volatile = 2 Durability::Volatile.name(),
    /// Not discoverable.
    Unknown = 3 "unknown",
    /// The best that matches every peer.
    BestAvailable = 4 BEST_AVAILABLE,
}
policy! {
    /// Who asserted that the publisher was alive.
    RecordedLiveliness, "liveliness":
    /// The middleware's own choice.
    SystemDefault = 0 SYSTEM_DEFAULT,
    /// The middleware.
    Automatic = 1 Liveliness::Automatic.name(),
    /// The node (removed from ROS 2; in old bags only).
    ManualByNode = 2 "manual_by_node",
    /// The program, for each topic.
    ManualByTopic = 3 Liveliness::ManualByTopic.name(),
    /// Not discoverable.
    Unknown = 4 "unknown",
    /// The best that matches every peer.
    BestAvailable = 5 BEST_AVAILABLE,
}

/// An offered quality of service, exactly as in a bag. `None` means *infinite* for every duration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecordedQos {
    /// See [`RecordedHistory`].
    pub history: RecordedHistory,
    /// The number of samples with [`RecordedHistory::KeepLast`], else 0.
    pub depth: u32,
    /// See [`RecordedReliability`].
    pub reliability: RecordedReliability,
    /// See [`RecordedDurability`].
    pub durability: RecordedDurability,
    /// The longest time between two samples.
    pub deadline: Option<Duration>,
    /// How long a sample was valid.
    pub lifespan: Option<Duration>,
    /// See [`RecordedLiveliness`].
    pub liveliness: RecordedLiveliness,
    /// How long the publisher could be silent before it was considered lost.
    pub liveliness_lease_duration: Option<Duration>,
    /// Whether the DDS topic name was the plain name, without the prefix `rt/`.
    pub avoid_ros_namespace_conventions: bool,
}

impl RecordedQos {
    /// The profile for playing the topic: policies that the bag leaves open are the default (keep last 10,
    /// reliable, volatile, automatic).
    #[must_use]
    pub fn to_profile(&self) -> QosProfile {
        QosProfile {
            history: match self.history {
                RecordedHistory::KeepLast => History::KeepLast(self.depth.max(1)),
                RecordedHistory::KeepAll => History::KeepAll,
                RecordedHistory::SystemDefault | RecordedHistory::Unknown => QosProfile::DEFAULT.history,
            },
            reliability: match self.reliability {
                RecordedReliability::BestEffort => Reliability::BestEffort,
                _ => Reliability::Reliable,
            },
            durability: match self.durability {
                RecordedDurability::TransientLocal => Durability::TransientLocal,
                _ => Durability::Volatile,
            },
            deadline: self.deadline,
            lifespan: self.lifespan,
            liveliness: match self.liveliness {
                RecordedLiveliness::ManualByTopic => Liveliness::ManualByTopic,
                _ => Liveliness::Automatic,
            },
            liveliness_lease_duration: self.liveliness_lease_duration,
        }
    }
}

impl RecordedQos {
    /// The part of this profile that discovery transmits: everything except the history.
    #[must_use]
    pub fn without_history(self) -> Self {
        Self { history: RecordedHistory::Unknown, depth: 0, ..self }
    }
}

impl From<QosProfile> for RecordedQos {
    fn from(profile: QosProfile) -> Self {
        Self::from(&profile)
    }
}

impl From<&QosProfile> for RecordedQos {
    fn from(profile: &QosProfile) -> Self {
        let (history, depth) = match profile.history {
            History::KeepLast(depth) => (RecordedHistory::KeepLast, depth),
            History::KeepAll => (RecordedHistory::KeepAll, 0),
        };
        Self {
            history,
            depth,
            reliability: match profile.reliability {
                Reliability::Reliable => RecordedReliability::Reliable,
                Reliability::BestEffort => RecordedReliability::BestEffort,
            },
            durability: match profile.durability {
                Durability::Volatile => RecordedDurability::Volatile,
                Durability::TransientLocal => RecordedDurability::TransientLocal,
            },
            deadline: profile.deadline,
            lifespan: profile.lifespan,
            liveliness: match profile.liveliness {
                Liveliness::Automatic => RecordedLiveliness::Automatic,
                Liveliness::ManualByTopic => RecordedLiveliness::ManualByTopic,
            },
            liveliness_lease_duration: profile.liveliness_lease_duration,
            avoid_ros_namespace_conventions: false,
        }
    }
}
