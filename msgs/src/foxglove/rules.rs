//! The mapping between fields of ROS 2 and of Foxglove.

use super::special::{self, Special};

/// The mapping of a message type to one of Foxglove's.
pub(super) struct Rule {
    pub(super) ros: &'static str,
    pub(super) foxglove: &'static str,
    /// Foxglove's field, and the path of the corresponding field in the message. Others stay empty.
    pub(super) same: &'static [(&'static str, &'static str)],
    /// A list whose elements are converted by their own rule: Foxglove's field, the message's, the elements'
    /// type.
    pub(super) each: Option<(&'static str, &'static str, &'static str)>,
    /// Conversions beyond equal fields.
    pub(super) special: Option<Special>,
}

const fn rule(
    ros: &'static str,
    foxglove: &'static str,
    same: &'static [(&'static str, &'static str)],
) -> Rule {
    Rule { ros, foxglove, same, each: None, special: None }
}

const STAMP: (&str, &str) = ("timestamp", "header.stamp");
const FRAME: (&str, &str) = ("frame_id", "header.frame_id");

pub(super) static RULES: &[Rule] = &[
    rule("geometry_msgs/msg/Point", "foxglove.Point3", &[("x", "x"), ("y", "y"), ("z", "z")]),
    rule("geometry_msgs/msg/PointStamped", "foxglove.Point3InFrame", &[STAMP, FRAME, ("point", "point")]),
    rule(
        "geometry_msgs/msg/Pose",
        "foxglove.Pose",
        &[("position", "position"), ("orientation", "orientation")],
    ),
    rule("geometry_msgs/msg/PoseArray", "foxglove.PosesInFrame", &[STAMP, FRAME, ("poses", "poses")]),
    rule("geometry_msgs/msg/PoseStamped", "foxglove.PoseInFrame", &[STAMP, FRAME, ("pose", "pose")]),
    rule(
        "geometry_msgs/msg/Quaternion",
        "foxglove.Quaternion",
        &[("x", "x"), ("y", "y"), ("z", "z"), ("w", "w")],
    ),
    rule(
        "geometry_msgs/msg/TransformStamped",
        "foxglove.FrameTransform",
        &[
            STAMP,
            ("parent_frame_id", "header.frame_id"),
            ("child_frame_id", "child_frame_id"),
            ("translation", "transform.translation"),
            ("rotation", "transform.rotation"),
        ],
    ),
    rule("geometry_msgs/msg/Vector3", "foxglove.Vector3", &[("x", "x"), ("y", "y"), ("z", "z")]),
    rule(
        "nav_msgs/msg/Odometry",
        "foxglove.Odometry",
        &[
            STAMP,
            FRAME,
            ("body_frame_id", "child_frame_id"),
            ("pose", "pose.pose"),
            ("linear_velocity", "twist.twist.linear"),
            ("angular_velocity", "twist.twist.angular"),
            ("pose_covariance", "pose.covariance"),
            ("velocity_covariance", "twist.covariance"),
        ],
    ),
    Rule {
        special: Some(special::LOG),
        ..rule(
            "rcl_interfaces/msg/Log",
            "foxglove.Log",
            &[
                ("timestamp", "stamp"),
                ("message", "msg"),
                ("name", "name"),
                ("file", "file"),
                ("line", "line"),
            ],
        )
    },
    rule(
        "sensor_msgs/msg/CameraInfo",
        "foxglove.CameraCalibration",
        &[
            STAMP,
            FRAME,
            ("width", "width"),
            ("height", "height"),
            ("distortion_model", "distortion_model"),
            ("D", "d"),
            ("K", "k"),
            ("R", "r"),
            ("P", "p"),
        ],
    ),
    Rule {
        special: Some(special::COMPRESSED_IMAGE),
        ..rule(
            "sensor_msgs/msg/CompressedImage",
            "foxglove.CompressedImage",
            &[STAMP, FRAME, ("data", "data")],
        )
    },
    Rule {
        special: Some(special::IMAGE),
        ..rule(
            "sensor_msgs/msg/Image",
            "foxglove.RawImage",
            &[
                STAMP,
                FRAME,
                ("width", "width"),
                ("height", "height"),
                ("encoding", "encoding"),
                ("step", "step"),
                ("data", "data"),
            ],
        )
    },
    Rule {
        special: Some(special::JOINT_STATE),
        ..rule("sensor_msgs/msg/JointState", "foxglove.JointStates", &[STAMP])
    },
    Rule {
        special: Some(special::LASER_SCAN),
        ..rule(
            "sensor_msgs/msg/LaserScan",
            "foxglove.LaserScan",
            &[
                STAMP,
                FRAME,
                ("start_angle", "angle_min"),
                ("end_angle", "angle_max"),
                ("ranges", "ranges"),
                ("intensities", "intensities"),
            ],
        )
    },
    rule(
        "sensor_msgs/msg/NavSatFix",
        "foxglove.LocationFix",
        &[
            STAMP,
            FRAME,
            ("latitude", "latitude"),
            ("longitude", "longitude"),
            ("altitude", "altitude"),
            ("position_covariance", "position_covariance"),
            ("position_covariance_type", "position_covariance_type"),
        ],
    ),
    Rule {
        special: Some(special::POINT_CLOUD),
        ..rule(
            "sensor_msgs/msg/PointCloud2",
            "foxglove.PointCloud",
            &[STAMP, FRAME, ("point_stride", "point_step"), ("data", "data")],
        )
    },
    rule("std_msgs/msg/ColorRGBA", "foxglove.Color", &[("r", "r"), ("g", "g"), ("b", "b"), ("a", "a")]),
    Rule {
        each: Some(("transforms", "transforms", "geometry_msgs/msg/TransformStamped")),
        ..rule("tf2_msgs/msg/TFMessage", "foxglove.FrameTransforms", &[])
    },
];

/// The rule of a type.
pub(super) fn rule_of(type_name: &str) -> Option<&'static Rule> {
    RULES.iter().find(|rule| rule.ros == type_name)
}
