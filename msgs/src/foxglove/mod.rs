//! Types for which Foxglove has its own schemas, which it can show without ROS 2.
//!
//! ```
//! assert_eq!(downbeat_msgs::foxglove::schema_name("sensor_msgs/msg/Image"), Some("foxglove.RawImage"));
//! assert_eq!(downbeat_msgs::foxglove::schema_name("sensor_msgs/msg/Imu"), None);
//! ```
//!
//! | ROS 2 | Foxglove | not preserved |
//! | --- | --- | --- |
//! | `sensor_msgs/msg/Image` | `RawImage` | `is_bigendian` (an image with big-endian multi-byte pixels is rejected) |
//! | `sensor_msgs/msg/CompressedImage` | `CompressedImage` | the content of `format` besides `jpeg`, `png`, `webp` or `avif` |
//! | `sensor_msgs/msg/CameraInfo` | `CameraCalibration` | binning, `roi` |
//! | `sensor_msgs/msg/PointCloud2` | `PointCloud` | rows and their padding, `is_dense`; a field of `n` values becomes `n` fields |
//! | `sensor_msgs/msg/LaserScan` | `LaserScan` | `time_increment`, `scan_time`, `range_min`, `range_max` |
//! | `sensor_msgs/msg/NavSatFix` | `LocationFix` | `status` |
//! | `sensor_msgs/msg/JointState` | `JointStates` | `header.frame_id` |
//! | `geometry_msgs/msg/TransformStamped` | `FrameTransform` | |
//! | `tf2_msgs/msg/TFMessage` | `FrameTransforms` | |
//! | `geometry_msgs/msg/PoseStamped` | `PoseInFrame` | |
//! | `geometry_msgs/msg/PoseArray` | `PosesInFrame` | |
//! | `geometry_msgs/msg/PointStamped` | `Point3InFrame` | |
//! | `nav_msgs/msg/Odometry` | `Odometry` | |
//! | `rcl_interfaces/msg/Log` | `Log` | `function` |
//! | `geometry_msgs/msg/{Point, Pose, Quaternion, Vector3}` | `{Point3, Pose, Quaternion, Vector3}` | |
//! | `std_msgs/msg/ColorRGBA` | `Color` | |
//!
//! After conversion back, fields that are not preserved have their defaults. Nanoseconds of a second and more
//! are carried over into the seconds.
//!
//! Markers and grids are not converted: a `Marker` changes, replaces or deletes what earlier ones have drawn
//! and finds meshes by `package://`, which a single `SceneUpdate` cannot express; the cells of an
//! `OccupancyGrid` (unknown, free, occupied) mean more than the numbers of a `Grid`.
//!
//! # References
//! - `schemas/proto/foxglove/*.proto` and `schemas/flatbuffer/*.fbs` of foxglove/foxglove-sdk, commit
//!   ca8a1ce: names, numbers and ids of fields.

mod convert;
mod object;
mod rules;
mod schemas;
mod special;

pub(crate) use convert::Mapping;

/// The name of Foxglove's schema for a message type, if it has one.
#[must_use]
pub fn schema_name(type_name: &str) -> Option<&'static str> {
    rules::rule_of(type_name).map(|rule| rule.foxglove)
}

/// The message types that have one of Foxglove's schemas, with its name.
pub fn types() -> impl Iterator<Item = (&'static str, &'static str)> {
    rules::RULES.iter().map(|rule| (rule.ros, rule.foxglove))
}
