//! Values in one frame expressed in another one.

use super::Isometry;
use downbeat_msgs::geometry_msgs::msg::{
    Point, Point32, PointStamped, Pose, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped,
    Quaternion, QuaternionStamped, Twist, TwistStamped, TwistWithCovariance, TwistWithCovarianceStamped,
    Vector3, Vector3Stamped, Wrench, WrenchStamped,
};
use downbeat_msgs::std_msgs::msg::Header;
use glam::{DMat3, DQuat, DVec3};

/// A value that has another look in another frame.
pub trait Transformable: Sized {
    /// The same value in the target.
    #[must_use]
    fn transformed(&self, target_from_source: &Isometry) -> Self;
}

/// A message with the frame and the time of its value.
pub trait Stamped {
    /// The frame and the time.
    fn header(&self) -> &Header;
    /// The frame and the time, to change them.
    fn header_mut(&mut self) -> &mut Header;
}

impl Transformable for Point {
    fn transformed(&self, target_from_source: &Isometry) -> Self {
        let point = target_from_source.transform_point(DVec3::new(self.x, self.y, self.z));
        Self { x: point.x, y: point.y, z: point.z }
    }
}

impl Transformable for Point32 {
    /// Computed in double precision.
    fn transformed(&self, target_from_source: &Isometry) -> Self {
        let point = DVec3::new(self.x.into(), self.y.into(), self.z.into());
        let point = target_from_source.transform_point(point);
        Self { x: point.x as f32, y: point.y as f32, z: point.z as f32 }
    }
}

impl Transformable for Vector3 {
    /// A direction: rotated, not moved.
    fn transformed(&self, target_from_source: &Isometry) -> Self {
        from_vector(target_from_source.rotation * to_vector(self))
    }
}

impl Transformable for Quaternion {
    /// An orientation. One that is not normalised stays so.
    fn transformed(&self, target_from_source: &Isometry) -> Self {
        let rotated = target_from_source.rotation * DQuat::from_xyzw(self.x, self.y, self.z, self.w);
        Self { x: rotated.x, y: rotated.y, z: rotated.z, w: rotated.w }
    }
}

impl Transformable for Pose {
    fn transformed(&self, target_from_source: &Isometry) -> Self {
        Self {
            position: self.position.transformed(target_from_source),
            orientation: self.orientation.transformed(target_from_source),
        }
    }
}

impl Transformable for PoseWithCovariance {
    /// The covariance is rotated, of the position and of the rotations about fixed axes each by itself, as
    /// `transformCovariance` of tf2_geometry_msgs does.
    fn transformed(&self, target_from_source: &Isometry) -> Self {
        let map = Blocks { rotation: DMat3::from_quat(target_from_source.rotation), lever: DMat3::ZERO };
        Self { pose: self.pose.transformed(target_from_source), covariance: map.covariance(&self.covariance) }
    }
}

impl Transformable for Twist {
    /// The velocity of a rigid body, given for the point of it that is at the origin of the source, in the axes of the source;
    /// then for the point that is at the origin of the target, in the axes of the target:
    ///
    /// - (1) ω' = R ω
    /// - (2) v' = R v + p × ω'
    ///
    /// with the rotation R and the translation p of `target_from_source`; as `doTransform` of tf2_geometry_msgs does for
    /// velocities. The two frames are taken not to move in each other.
    ///
    /// # References
    /// K. M. Lynch and F. C. Park, Modern Robotics, 2017, section 3.3.2.
    fn transformed(&self, target_from_source: &Isometry) -> Self {
        let angular = target_from_source.rotation * to_vector(&self.angular);
        let linear = target_from_source.rotation * to_vector(&self.linear);
        let linear = linear + target_from_source.translation.cross(angular);
        Self { linear: from_vector(linear), angular: from_vector(angular) }
    }
}

impl Transformable for TwistWithCovariance {
    /// The covariance follows equations (1) and (2) of [`Twist`].
    fn transformed(&self, target_from_source: &Isometry) -> Self {
        let rotation = DMat3::from_quat(target_from_source.rotation);
        let DVec3 { x, y, z } = target_from_source.translation;
        // The cross product as a matrix, by columns.
        let cross = DMat3::from_cols_array(&[0.0, z, -y, -z, 0.0, x, y, -x, 0.0]);
        let map = Blocks { rotation, lever: cross * rotation };
        Self {
            twist: self.twist.transformed(target_from_source),
            covariance: map.covariance(&self.covariance),
        }
    }
}

impl Transformable for Wrench {
    /// A force and the torque about the origin of the source; then about the origin of the target:
    ///
    /// - (3) f' = R f
    /// - (4) τ' = R τ + p × f'
    fn transformed(&self, target_from_source: &Isometry) -> Self {
        let force = target_from_source.rotation * to_vector(&self.force);
        let torque = target_from_source.rotation * to_vector(&self.torque);
        let torque = torque + target_from_source.translation.cross(force);
        Self { force: from_vector(force), torque: from_vector(torque) }
    }
}

macro_rules! stamped {
    ($($message:ident: $value:ident),* $(,)?) => {$(
        impl Stamped for $message {
            fn header(&self) -> &Header {
                &self.header
            }

            fn header_mut(&mut self) -> &mut Header {
                &mut self.header
            }
        }

        impl Transformable for $message {
            /// The header stays; [`TransformBuffer::transform`](super::TransformBuffer::transform) changes it too.
            fn transformed(&self, target_from_source: &Isometry) -> Self {
                Self { $value: self.$value.transformed(target_from_source), ..self.clone() }
            }
        }
    )*};
}

stamped! {
    PointStamped: point,
    Vector3Stamped: vector,
    QuaternionStamped: quaternion,
    PoseStamped: pose,
    PoseWithCovarianceStamped: pose,
    TwistStamped: twist,
    TwistWithCovarianceStamped: twist,
    WrenchStamped: wrench,
}

fn to_vector(vector: &Vector3) -> DVec3 {
    DVec3::new(vector.x, vector.y, vector.z)
}

fn from_vector(vector: DVec3) -> Vector3 {
    Vector3 { x: vector.x, y: vector.y, z: vector.z }
}

/// A linear map of six coordinates: the rotation on the diagonal, the lever to the right of the first, zero below.
struct Blocks {
    rotation: DMat3,
    lever: DMat3,
}

impl Blocks {
    /// The covariance of what is mapped; messages have the rows one after the other.
    fn covariance(&self, covariance: &[f64; 36]) -> [f64; 36] {
        let block = |row: usize, column: usize| {
            DMat3::from_cols_array(&std::array::from_fn(|index| {
                covariance[(row + index % 3) * 6 + column + index / 3]
            }))
        };
        let own = [[block(0, 0), block(0, 3)], [block(3, 0), block(3, 3)]];
        let map = [[self.rotation, self.lever], [DMat3::ZERO, self.rotation]];
        let mut mapped = [0.0; 36];
        for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let mut sum = DMat3::ZERO;
            for (left, right) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                sum += map[row][left] * own[left][right] * map[column][right].transpose();
            }
            for (index, value) in sum.to_cols_array().into_iter().enumerate() {
                mapped[(row * 3 + index % 3) * 6 + column * 3 + index / 3] = value;
            }
        }
        mapped
    }
}
