//! What messages say, in the numbers of the filters.

use crate::filter::Pose;
use downbeat_executor::Time;
use downbeat_football::IntersectionKind;
use downbeat_football::soccer_vision_3d_msgs::msg::MarkingIntersection;
use downbeat_msgs::geometry_msgs::msg::{Point, Pose as PoseMessage, Quaternion};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::std_msgs::msg::Header;
use glam::{DQuat, DVec2};

/// Beyond it nothing is used, in m.
pub(crate) const FARTHEST: f64 = 15.0;

pub(crate) fn time(header: &Header) -> Time {
    Time::from_nanos(header.stamp.as_nanos())
}

/// On the floor, and the whole orientation.
pub(crate) fn pose_of(message: &Odometry) -> Option<(Pose, DQuat)> {
    pose_from(&message.pose.pose)
}

pub(crate) fn pose_from(message: &PoseMessage) -> Option<(Pose, DQuat)> {
    let Point { x, y, z } = message.position;
    let q = message.orientation;
    let orientation = DQuat::from_xyzw(q.x, q.y, q.z, q.w);
    let is_pose = [x, y, z].iter().all(|part| part.abs() < 1e6) && (orientation.length() - 1.0).abs() < 0.01;
    let orientation = orientation.normalize();
    let ahead = orientation * glam::DVec3::X;
    is_pose
        .then(|| (Pose { position: DVec2::new(x, y), heading: libm::atan2(ahead.y, ahead.x) }, orientation))
}

pub(crate) fn quaternion(of: DQuat) -> Quaternion {
    let DQuat { x, y, z, w } = of;
    Quaternion { x, y, z, w }
}

/// A point on the floor near the robot.
pub(crate) fn point(of: &Point) -> Option<DVec2> {
    let point = DVec2::new(of.x, of.y);
    (point.is_finite() && point.length() <= FARTHEST).then_some(point)
}

pub(crate) fn intersection(message: &MarkingIntersection) -> Option<(DVec2, IntersectionKind, f64)> {
    let kind = match message.rays.len() {
        2 => IntersectionKind::L,
        3 => IntersectionKind::T,
        4 => IntersectionKind::X,
        _ => return None,
    };
    let rays = message.rays.iter().map(|ray| DVec2::new(ray.x, ray.y).normalize_or_zero());
    // Of a T the two opposite arms cancel each other, of an L the sum is between its arms.
    let heading = match kind {
        IntersectionKind::X => rays.take(1).sum::<DVec2>(),
        _ => rays.sum(),
    };
    let is_possible = heading.is_finite() && heading.length() > 0.1;
    is_possible.then_some((point(&message.center)?, kind, heading.to_angle()))
}
