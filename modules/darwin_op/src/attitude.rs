//! The orientation of the trunk, as the IMU reports it.

use downbeat_msgs::sensor_msgs::msg::Imu;
use glam::DQuat;

/// The rotation from the trunk to the world; `None` for data without a valid orientation.
pub(crate) fn world_from_trunk(imu: &Imu) -> Option<DQuat> {
    let q = &imu.orientation;
    let orientation = DQuat::from_xyzw(q.x, q.y, q.z, q.w);
    // -1 marks data without orientation.
    let is_valid = imu.orientation_covariance[0] >= 0.0 && (orientation.length_squared() - 1.0).abs() < 1e-3;
    is_valid.then_some(orientation)
}
