//! Rigid transforms: of messages and back, between two of them, and applied to values in a frame.

use downbeat_msgs::geometry_msgs::msg::{
    Point, Point32, PointStamped, Pose, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped,
    Quaternion, QuaternionStamped, Transform, Twist, TwistStamped, TwistWithCovariance,
    TwistWithCovarianceStamped, Vector3, Vector3Stamped, Wrench, WrenchStamped,
};
use downbeat_msgs::std_msgs::msg::Header;
use glam::{DMat3, DQuat, DVec3, DVec4};
use std::ops::Mul;

/// A rotation followed by a translation: maps coordinates of one frame to another one.
///
/// Named `target_from_source`, so that a chain reads `world_from_body * body_from_foot`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Isometry {
    /// The origin of the source in the target, in metres.
    pub translation: DVec3,
    /// The orientation of the source in the target; has norm 1.
    pub rotation: DQuat,
}

impl Isometry {
    /// The identity.
    pub const IDENTITY: Self = Self { translation: DVec3::ZERO, rotation: DQuat::IDENTITY };

    /// A pure translation, in metres.
    #[must_use]
    pub const fn from_translation(x: f64, y: f64, z: f64) -> Self {
        Self { translation: DVec3::new(x, y, z), rotation: DQuat::IDENTITY }
    }

    /// The inverse transform.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self { translation: -(rotation * self.translation), rotation }
    }

    /// The coordinates of a point in the target.
    #[must_use]
    pub fn transform_point(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }
}

impl Default for Isometry {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Mul for Isometry {
    type Output = Self;

    /// First `rhs`, then `self`. The rotation keeps norm 1 in spite of rounding, however long the chain.
    fn mul(self, rhs: Self) -> Self {
        Self {
            translation: self.transform_point(rhs.translation),
            rotation: (self.rotation * rhs.rotation).normalize(),
        }
    }
}

/// How far the square of a quaternion's norm may be from 1 (`QUATERNION_NORMALIZATION_TOLERANCE` in tf2).
const NORM_TOLERANCE: f64 = 10e-3;

/// The rigid transform of a message, its rotation normalised.
///
/// # Errors
/// The norm of the quaternion if it is not approximately 1; NaN if any number of the message is not finite.
pub fn isometry(transform: &Transform) -> Result<Isometry, f64> {
    let Transform { translation: Vector3 { x, y, z }, rotation } = transform;
    let translation = DVec3::new(*x, *y, *z);
    let rotation = DQuat::from_xyzw(rotation.x, rotation.y, rotation.z, rotation.w);
    if !(translation.is_finite() && rotation.is_finite()) {
        return Err(f64::NAN);
    }
    if (rotation.length_squared() - 1.0).abs() >= NORM_TOLERANCE {
        return Err(rotation.length());
    }
    Ok(Isometry { translation, rotation: rotation.normalize() })
}

/// The message of a rigid transform.
#[must_use]
pub fn transform_message(isometry: &Isometry) -> Transform {
    let Isometry { translation, rotation } = isometry;
    Transform {
        translation: Vector3 { x: translation.x, y: translation.y, z: translation.z },
        rotation: Quaternion { x: rotation.x, y: rotation.y, z: rotation.z, w: rotation.w },
    }
}

/// Interpolates between two transforms, 0 for the first and 1 for the second: the translation linearly, the
/// rotation at constant speed about one axis in the shorter direction.
pub(super) fn interpolate(from: &Isometry, to: &Isometry, ratio: f64) -> Isometry {
    Isometry {
        translation: from.translation.lerp(to.translation, ratio),
        rotation: slerp(from.rotation, to.rotation, ratio),
    }
}

/// Shoemake's spherical linear interpolation, with the angle by Kahan's formula, which is also exact for
/// small angles.
///
/// # References
/// K. Shoemake, Animating rotation with quaternion curves, SIGGRAPH 1985.
fn slerp(from: DQuat, to: DQuat, ratio: f64) -> DQuat {
    let (from, to) = (DVec4::from(from), DVec4::from(to));
    // Both signs of a quaternion are the same rotation; the nearer one is the shorter direction.
    let to = if from.dot(to) < 0.0 { -to } else { to };
    let angle = 2.0 * libm::atan2((from - to).length(), (from + to).length());
    if angle < f64::EPSILON {
        return DQuat::from_vec4(from);
    }
    let between =
        (from * libm::sin((1.0 - ratio) * angle) + to * libm::sin(ratio * angle)) / libm::sin(angle);
    DQuat::from_vec4(between).normalize()
}

/// A value that can be expressed in another frame.
pub trait Transformable: Sized {
    /// The value in the target frame.
    #[must_use]
    fn transformed(&self, target_from_source: &Isometry) -> Self;
}

/// A message with the frame and the time of its value.
pub trait Stamped {
    /// The frame and the time.
    fn header(&self) -> &Header;
    /// The frame and the time, mutable.
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
    /// A direction: rotated, not translated.
    fn transformed(&self, target_from_source: &Isometry) -> Self {
        from_vector(target_from_source.rotation * to_vector(self))
    }
}

impl Transformable for Quaternion {
    /// An orientation. It is not normalised.
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
    /// The covariances of position and of rotations about fixed axes are each rotated, as in
    /// `transformCovariance` of tf2_geometry_msgs.
    fn transformed(&self, target_from_source: &Isometry) -> Self {
        let map = Blocks { rotation: DMat3::from_quat(target_from_source.rotation), lever: DMat3::ZERO };
        Self { pose: self.pose.transformed(target_from_source), covariance: map.covariance(&self.covariance) }
    }
}

impl Transformable for Twist {
    /// The velocity of a rigid body, converted from its point at the origin of the source, in the axes of the
    /// source, to its point at the origin of the target, in the axes of the target:
    ///
    /// - (1) ω' = R ω
    /// - (2) v' = R v + p × ω'
    ///
    /// with the rotation R and the translation p of `target_from_source`; as in `doTransform` of
    /// tf2_geometry_msgs for velocities. The two frames are assumed not to move relative to each other.
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
    /// A force and the torque, converted from the origin of the source to the origin of the target:
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
            /// Keeps the header; [`TransformBuffer::transform`](super::TransformBuffer::transform) also
            /// updates it.
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

/// A linear map of six coordinates: the rotation on the diagonal, the lever to the right of the first, zero
/// below.
struct Blocks {
    rotation: DMat3,
    lever: DMat3,
}

impl Blocks {
    /// Maps a covariance, which messages store row by row.
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

/// The angle between -π and π with the same direction, rad.
#[must_use]
pub fn wrapped(angle: f64) -> f64 {
    use std::f64::consts::TAU;
    angle - (angle / TAU).round() * TAU
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    #[test]
    fn rotations_take_the_shorter_direction_at_constant_speed() {
        let (from, to) = (DQuat::from_rotation_z(0.9 * PI), DQuat::from_rotation_z(-0.9 * PI));
        for ratio in [0.0, 0.25, 0.5, 1.0] {
            let expected = DQuat::from_rotation_z(0.9 * PI + ratio * 0.2 * PI);
            for to in [to, -to] {
                assert!(slerp(from, to, ratio).dot(expected).abs() > 1.0 - 1e-15);
            }
        }
    }

    #[test]
    fn the_smallest_and_the_greatest_rotations_are_interpolated() {
        let about_x = DQuat::from_rotation_x;
        let tiny = slerp(about_x(0.0), about_x(1e-9), 0.5);
        assert!((tiny.x - 0.25e-9).abs() < 1e-20, "{tiny}");
        let half_turn = slerp(about_x(0.0), about_x(PI), 0.5);
        assert!(half_turn.abs_diff_eq(about_x(FRAC_PI_2), 1e-15));
        assert_eq!(slerp(tiny, tiny, 0.3), tiny);
    }

    #[test]
    fn a_nearly_unit_quaternion_is_normalised_and_others_are_refused() {
        let with_w =
            |w| Transform { rotation: Quaternion { x: 0.0, y: 0.0, z: 0.0, w }, ..Transform::default() };
        assert_eq!(isometry(&with_w(1.004)).unwrap(), Isometry::IDENTITY);
        assert_eq!(isometry(&with_w(0.5)), Err(0.5));
        assert_eq!(isometry(&with_w(0.0)), Err(0.0));
        assert!(isometry(&with_w(f64::INFINITY)).unwrap_err().is_nan());
        let mut far = with_w(1.0);
        far.translation.y = f64::NAN;
        assert!(isometry(&far).unwrap_err().is_nan());
    }
}
