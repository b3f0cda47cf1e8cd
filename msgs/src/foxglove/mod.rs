//! Types that Foxglove has schemas of its own for, which it shows without knowing ROS 2.
//!
//! ```
//! assert_eq!(downbeat_msgs::foxglove::schema_name("sensor_msgs/msg/Image"), Some("foxglove.RawImage"));
//! assert_eq!(downbeat_msgs::foxglove::schema_name("sensor_msgs/msg/Imu"), None);
//! ```
//!
//! | ROS 2 | Foxglove | not kept |
//! | --- | --- | --- |
//! | `sensor_msgs/msg/Image` | `RawImage` | `is_bigendian` (an image with big-endian pixels of several bytes is refused) |
//! | `sensor_msgs/msg/CompressedImage` | `CompressedImage` | what `format` says besides `jpeg`, `png`, `webp` or `avif` |
//! | `sensor_msgs/msg/CameraInfo` | `CameraCalibration` | binning, `roi` |
//! | `sensor_msgs/msg/PointCloud2` | `PointCloud` | rows and the padding behind them, `is_dense`; a field of `n` values becomes `n` fields |
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
//! What is not kept is as in a new message in one that is read back. Nanoseconds of a second and more are carried over into
//! the seconds.
//!
//! Markers and grids are left to the encodings that keep them: a `Marker` changes, replaces or deletes what earlier ones have
//! drawn and finds meshes by `package://`, which one `SceneUpdate` does not say; an `OccupancyGrid` means more by its cells
//! (unknown, free, occupied) than a `Grid` of numbers.
//!
//! # References
//! - `schemas/proto/foxglove/*.proto` and `schemas/flatbuffer/*.fbs` of foxglove/foxglove-sdk, commit ca8a1ce: names, numbers
//!   and ids of fields.

mod convert;
mod path;
mod point_cloud;
mod rules;
mod schemas;
mod special;

pub(crate) use convert::Mapping;

/// The schema Foxglove has for a message type, if it has one.
#[must_use]
pub fn schema_name(type_name: &str) -> Option<&'static str> {
    rules::rule_of(type_name).map(|rule| rule.foxglove)
}

/// The message types that have one, with its name.
pub fn types() -> impl Iterator<Item = (&'static str, &'static str)> {
    rules::RULES.iter().map(|rule| (rule.ros, rule.foxglove))
}
