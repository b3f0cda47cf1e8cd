//! Quality of service as rosbag2 stores it, which can say less (`unknown`) or more than [`QosProfile`] does.

use std::time::Duration;

use downbeat_msgs::qos::{Durability, History, Liveliness, QosProfile, Reliability};
use serde::de::{Deserialize, Deserializer, Visitor};

/// One policy: the names are those of `rmw/qos_string_conversions.h` (metadata version 9), the numbers those of
/// `rmw/types.h` (older versions).
macro_rules! policy {
    ($(#[$doc:meta])* $name:ident, $what:literal: $($(#[$variant_doc:meta])* $variant:ident = $number:literal $text:literal),+ $(,)?) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name {
            $($(#[$variant_doc])* $variant),+
        }

        impl $name {
            /// The name in metadata.yaml.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $text),+ }
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

                    // rosbag2 takes what it does not know for `unknown`, so that newer bags still open.
                    fn visit_str<E>(self, text: &str) -> Result<$name, E> {
                        Ok(match text { $($text => $name::$variant,)+ _ => $name::Unknown })
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
    /// How many samples a publisher held.
    RecordedHistory, "history":
    /// The middleware's own choice.
    SystemDefault = 0 "system_default",
    /// The latest `depth`.
    KeepLast = 1 "keep_last",
    /// All.
    KeepAll = 2 "keep_all",
    /// Not discoverable: DDS discovery does not tell the history of a remote publisher, so this is what the real
    /// recorder usually writes.
    Unknown = 3 "unknown",
}
policy! {
    /// Whether lost samples were sent again.
    RecordedReliability, "reliability":
    /// The middleware's own choice.
    SystemDefault = 0 "system_default",
    /// Sent again.
    Reliable = 1 "reliable",
    /// Not sent again.
    BestEffort = 2 "best_effort",
    /// Not discoverable.
    Unknown = 3 "unknown",
    /// The best that matches every peer.
    BestAvailable = 4 "best_available",
}
policy! {
    /// Whether late subscriptions received older samples.
    RecordedDurability, "durability":
    /// The middleware's own choice.
    SystemDefault = 0 "system_default",
    /// They did.
    TransientLocal = 1 "transient_local",
    /// They did not.
    Volatile = 2 "volatile",
    /// Not discoverable.
    Unknown = 3 "unknown",
    /// The best that matches every peer.
    BestAvailable = 4 "best_available",
}
policy! {
    /// Who asserted that the publisher was alive.
    RecordedLiveliness, "liveliness":
    /// The middleware's own choice.
    SystemDefault = 0 "system_default",
    /// The middleware.
    Automatic = 1 "automatic",
    /// The node (removed from ROS 2; in old bags only).
    ManualByNode = 2 "manual_by_node",
    /// The program, for each topic.
    ManualByTopic = 3 "manual_by_topic",
    /// Not discoverable.
    Unknown = 4 "unknown",
    /// The best that matches every peer.
    BestAvailable = 5 "best_available",
}

/// An offered quality of service, exactly as a bag tells it. `None` means *infinite* for every duration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecordedQos {
    /// See [`RecordedHistory`].
    pub history: RecordedHistory,
    /// Samples held with [`RecordedHistory::KeepLast`], else 0.
    pub depth: u32,
    /// See [`RecordedReliability`].
    pub reliability: RecordedReliability,
    /// See [`RecordedDurability`].
    pub durability: RecordedDurability,
    /// The longest time between two samples.
    pub deadline: Option<Duration>,
    /// How long a sample was worth delivering.
    pub lifespan: Option<Duration>,
    /// See [`RecordedLiveliness`].
    pub liveliness: RecordedLiveliness,
    /// How long the publisher could be silent before it counted as gone.
    pub liveliness_lease_duration: Option<Duration>,
    /// Whether the DDS topic name was the plain name, without the prefix `rt/`.
    pub avoid_ros_namespace_conventions: bool,
}

impl RecordedQos {
    /// The profile to publish with when the topic is played: what the bag leaves open becomes the default
    /// (keep last 10, reliable, volatile, automatic).
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
    /// What discovery tells of a publisher that offers this: its history is not among it.
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
