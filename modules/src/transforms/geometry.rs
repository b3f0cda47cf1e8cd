//! Messages to rigid transforms and back, and what lies between two of them.

use super::Isometry;
use downbeat_msgs::geometry_msgs::msg::{Quaternion, Transform, Vector3};
use glam::{DQuat, DVec3, DVec4};

/// How far the square of a quaternion's norm may be from 1 (`QUATERNION_NORMALIZATION_TOLERANCE` in tf2).
const NORM_TOLERANCE: f64 = 10e-3;

/// The rigid transform of a message, its rotation normalised.
///
/// # Errors
/// The norm of the quaternion where it is not about 1; not a number where any number of the message is not finite.
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

/// Between two transforms, 0 for the first and 1 for the second: the translation along a line, the rotation at constant speed
/// about one axis the shorter way round.
pub(super) fn interpolate(from: &Isometry, to: &Isometry, ratio: f64) -> Isometry {
    Isometry {
        translation: from.translation.lerp(to.translation, ratio),
        rotation: slerp(from.rotation, to.rotation, ratio),
    }
}

/// Shoemake's spherical linear interpolation, with the angle by Kahan's formula, which is exact for small angles too.
///
/// # References
/// K. Shoemake, Animating rotation with quaternion curves, SIGGRAPH 1985.
fn slerp(from: DQuat, to: DQuat, ratio: f64) -> DQuat {
    let (from, to) = (DVec4::from(from), DVec4::from(to));
    // Both signs of a quaternion are one rotation; the nearer one is the shorter way.
    let to = if from.dot(to) < 0.0 { -to } else { to };
    let angle = 2.0 * (from - to).length().atan2((from + to).length());
    if angle < f64::EPSILON {
        return DQuat::from_vec4(from);
    }
    let between = (from * ((1.0 - ratio) * angle).sin() + to * (ratio * angle).sin()) / angle.sin();
    DQuat::from_vec4(between).normalize()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    #[test]
    fn rotations_go_the_shorter_way_round_at_constant_speed() {
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
    fn a_quaternion_that_is_nearly_one_is_normalised_and_another_is_refused() {
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
