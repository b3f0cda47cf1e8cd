//! The releases of PX4, and the names of their topics.

use std::fmt;
use std::str::FromStr;

use downbeat_msgs::{InterfaceSet, InterfaceVisitor};

use crate::{v1_14, v1_15, v1_16, v1_17};

/// A release of PX4 whose messages are carried.
///
/// ```
/// use downbeat_px4::Release;
///
/// let release: Release = "1.16".parse()?;
/// assert_eq!(release.topic("/fmu/out/vehicle_status", "VehicleStatus"), "/fmu/out/vehicle_status_v1");
/// assert_eq!(Release::V1_15.topic("/fmu/out/vehicle_status", "VehicleStatus"), "/fmu/out/vehicle_status");
/// # Ok::<(), downbeat_px4::UnknownRelease>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum Release {
    /// 1.14
    V1_14,
    /// 1.15
    V1_15,
    /// 1.16, the first one with versions in the names of topics.
    V1_16,
    /// 1.17
    #[default]
    V1_17,
}

/// A name of no release whose messages are carried.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the messages of PX4 {0:?} are not carried; those of {list} are", list = Release::NAMES.join(", "))]
pub struct UnknownRelease(pub String);

impl Release {
    /// All, the oldest first.
    pub const ALL: [Self; 4] = [Self::V1_14, Self::V1_15, Self::V1_16, Self::V1_17];

    /// Their names, in the same order.
    pub const NAMES: [&'static str; 4] = ["1.14", "1.15", "1.16", "1.17"];

    /// The name, such as `1.17`.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize]
    }

    /// The version of a message, the constant `MESSAGE_VERSION` of its definition: 0 without one, or if the
    /// message is not carried.
    #[must_use]
    pub fn message_version(self, message: &str) -> u32 {
        let versions = match self {
            Self::V1_14 => v1_14::MESSAGE_VERSIONS,
            Self::V1_15 => v1_15::MESSAGE_VERSIONS,
            Self::V1_16 => v1_16::MESSAGE_VERSIONS,
            Self::V1_17 => v1_17::MESSAGE_VERSIONS,
        };
        versions.iter().find(|(name, _)| *name == message).map_or(0, |(_, version)| *version)
    }

    /// The name that the topic of a message has in this release: with `_v` and the version of the message,
    /// unless that is 0.
    ///
    /// # References
    /// PX4 user guide, "PX4-ROS 2 Message Translation Node" and "uORB Messaging, versioned messages".
    #[must_use]
    pub fn topic(self, topic: &str, message: &str) -> String {
        match self.message_version(message) {
            0 => topic.to_owned(),
            version => format!("{topic}_v{version}"),
        }
    }
}

/// The environment variable that names the release whose definitions the names of px4_msgs stand for.
pub const RELEASE_VARIABLE: &str = "DOWNBEAT_PX4_RELEASE";

/// The messages of all releases, to register them as other versions of each other. A name such as
/// `px4_msgs/msg/VehicleStatus` stands for the definition of the first release; modules use the others by
/// their Rust types.
#[derive(Clone, Copy, Debug)]
pub struct AllReleases {
    /// The first release.
    pub first: Release,
}

impl AllReleases {
    /// Begins with the release that [`RELEASE_VARIABLE`] names, or with the newest one.
    ///
    /// # Errors
    /// Returns an error if the variable names no release.
    pub fn from_environment() -> Result<Self, UnknownRelease> {
        match std::env::var_os(RELEASE_VARIABLE).filter(|name| !name.is_empty()) {
            Some(name) => Ok(Self { first: name.to_string_lossy().parse()? }),
            None => Ok(Self { first: Release::default() }),
        }
    }
}

impl InterfaceSet for AllReleases {
    fn visit(&self, visitor: &mut impl InterfaceVisitor) {
        let rest = Release::ALL.into_iter().rev().filter(|release| *release != self.first);
        for release in std::iter::once(self.first).chain(rest) {
            match release {
                Release::V1_14 => v1_14::INTERFACES.visit(visitor),
                Release::V1_15 => v1_15::INTERFACES.visit(visitor),
                Release::V1_16 => v1_16::INTERFACES.visit(visitor),
                Release::V1_17 => v1_17::INTERFACES.visit(visitor),
            }
        }
    }
}

impl fmt::Display for Release {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// From a name such as `1.17`.
impl FromStr for Release {
    type Err = UnknownRelease;

    fn from_str(name: &str) -> Result<Self, UnknownRelease> {
        Self::ALL
            .into_iter()
            .find(|release| release.name() == name)
            .ok_or_else(|| UnknownRelease(name.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use downbeat_msgs::Message;

    #[test]
    fn a_topic_has_the_version_of_its_message() {
        let battery = |release: Release| release.topic("battery_status", "BatteryStatus");
        assert_eq!(
            Release::ALL.map(battery),
            ["battery_status", "battery_status", "battery_status", "battery_status_v1"]
        );
        assert_eq!(v1_17::msg::BatteryStatus::MESSAGE_VERSION, 1);
        assert_eq!(v1_16::msg::VehicleStatus::MESSAGE_VERSION, 1);
        assert_eq!(Release::V1_17.topic("vehicle_odometry", "VehicleOdometry"), "vehicle_odometry");
        assert_eq!(Release::V1_17.topic("mine", "Mine"), "mine");
    }

    #[test]
    fn a_release_has_a_name_and_others_are_refused_with_those_that_are_carried() {
        for release in Release::ALL {
            assert_eq!(release.name().parse(), Ok(release));
        }
        let error = "1.13".parse::<Release>().unwrap_err().to_string();
        assert_eq!(
            error,
            "the messages of PX4 \"1.13\" are not carried; those of 1.14, 1.15, 1.16, 1.17 are"
        );
        assert!("v1.17".parse::<Release>().is_err());
    }

    /// The hash depends on the fields, not on comments and constants.
    #[test]
    fn releases_share_the_types_that_mean_the_same_and_no_others() {
        fn is_same<A: 'static, B: 'static>() -> bool {
            std::any::TypeId::of::<A>() == std::any::TypeId::of::<B>()
        }
        assert!(is_same::<v1_14::msg::VehicleOdometry, v1_17::msg::VehicleOdometry>());
        assert!(!is_same::<v1_14::msg::OffboardControlMode, v1_15::msg::OffboardControlMode>());
        let hashes = [
            v1_14::msg::VehicleStatus::TYPE_HASH,
            v1_15::msg::VehicleStatus::TYPE_HASH,
            v1_16::msg::VehicleStatus::TYPE_HASH,
        ];
        assert!(hashes[0] != hashes[1] && hashes[1] != hashes[2]);
        // The constants of the states of arming differ.
        assert!(!is_same::<v1_16::msg::VehicleCommand, v1_17::msg::VehicleCommand>());
        assert_eq!(v1_16::msg::VehicleCommand::TYPE_HASH, v1_17::msg::VehicleCommand::TYPE_HASH);
        assert_eq!(v1_17::msg::VehicleOdometry::TYPE_NAME, "px4_msgs/msg/VehicleOdometry");
    }
}
