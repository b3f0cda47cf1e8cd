//! Where the head looks.

use downbeat_transforms::Isometry;
use glam::{DQuat, DVec3};

/// The head of the Darwin OP: two servos whose axes meet, and a camera that looks 40° down at tilt 0.
///
/// ```
/// use downbeat_kinematics::darwin_op::Head;
/// use glam::DVec3;
///
/// // A ball on the ground, half a metre ahead and a little to the left.
/// let ball = DVec3::new(0.5, 0.1, -0.2);
/// let look = Head.look_at(ball);
/// assert!(look.is_exact && look.pan > 0.0);
/// let camera_from_base = Head.base_from_camera(look.pan, look.tilt).inverse();
/// let seen = camera_from_base.transform_point(ball);
/// assert!(seen.x > 0.4 && seen.y.abs() < 1e-9 && seen.z.abs() < 1e-9);
/// ```
///
/// # References
/// Position of the camera: drewnoakes/bold-humanoid, `DarwinBodyModel`; 33.2 mm ahead and 34.4 mm above the
/// axes when it looks straight ahead.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Head;

/// Angles of the head.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeadSolution {
    /// The angle of `head_pan` in rad, positive to the left; within its limits.
    pub pan: f64,
    /// The angle of `head_tilt` in rad, positive upwards; within its limits.
    pub tilt: f64,
    /// Whether the camera's axis passes through the point. Otherwise the point is beyond a limit, at which
    /// the joint is, or within the head.
    pub is_exact: bool,
}

/// Where the axes of pan and tilt meet, in base_link, in m.
const NECK: DVec3 = DVec3::new(0.005, 0.0, 0.1727);
/// The camera in the frame of the head, in m.
const CAMERA: DVec3 = DVec3::new(0.047_545, 0.0, 0.005_011);
/// By how much the camera looks down at tilt 0, in degrees.
const CAMERA_PITCH_DEG: f64 = 40.0;
const PAN_LIMIT_DEG: f64 = 135.0;
const TILT_LIMITS_DEG: [f64; 2] = [-25.0, 55.0];
/// How far rounding may put an angle beyond its limits, in rad.
const TOLERANCE: f64 = 1e-9;

impl Head {
    /// The pose of `camera_link` (x along the optical axis, z up) for these angles, in rad.
    #[must_use]
    pub fn base_from_camera(&self, pan: f64, tilt: f64) -> Isometry {
        let base_from_head = Isometry {
            translation: NECK,
            rotation: DQuat::from_rotation_z(pan) * DQuat::from_rotation_y(-tilt),
        };
        let rotation = DQuat::from_rotation_y(CAMERA_PITCH_DEG.to_radians());
        base_from_head * Isometry { translation: CAMERA, rotation }
    }

    /// The angles with which the camera looks at a point in base_link. A point that is not finite gives NaN.
    #[must_use]
    pub fn look_at(&self, point: DVec3) -> HeadSolution {
        let from_neck = point - NECK;
        let wanted_pan = libm::atan2(from_neck.y, from_neck.x);
        let pan_limit = PAN_LIMIT_DEG.to_radians();
        let pan = wanted_pan.clamp(-pan_limit, pan_limit);
        // The optical axis passes the axis of tilt at this height, seen along the optical axis.
        let (sin, cos) = libm::sincos(CAMERA_PITCH_DEG.to_radians());
        let (height, ahead) = (CAMERA.x * sin + CAMERA.z * cos, CAMERA.x * cos - CAMERA.z * sin);
        let forward = from_neck.x * libm::cos(pan) + from_neck.y * libm::sin(pan);
        let distance = libm::hypot(forward, from_neck.z);
        let elevation = libm::atan2(from_neck.z, forward) - libm::asin((height / distance).clamp(-1.0, 1.0));
        let wanted_tilt = elevation + CAMERA_PITCH_DEG.to_radians();
        let [min, max] = TILT_LIMITS_DEG.map(f64::to_radians);
        let tilt = wanted_tilt.clamp(min, max);
        let is_within = (wanted_pan - pan).abs() <= TOLERANCE && (wanted_tilt - tilt).abs() <= TOLERANCE;
        HeadSolution { pan, tilt, is_exact: is_within && distance > libm::hypot(ahead, height) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_camera_looks_at_every_point_that_it_can_see(pan in -2.35..2.35, tilt in -0.43..0.95, distance in 0.01..9.0) {
            let point = Head.base_from_camera(pan, tilt).transform_point(DVec3::X * distance);
            let look = Head.look_at(point);
            prop_assert!(look.is_exact);
            prop_assert!((look.pan - pan).abs() < 1e-9 && (look.tilt - tilt).abs() < 1e-9, "{:?}", look);
        }
    }

    #[test]
    fn what_is_behind_or_above_is_flagged() {
        let behind = Head.look_at(DVec3::new(-1.0, -0.2, 0.0));
        assert!(!behind.is_exact && (behind.pan.to_degrees() + 135.0).abs() < 1e-9);
        let above = Head.look_at(DVec3::new(0.1, 0.0, 5.0));
        assert!(!above.is_exact && (above.tilt.to_degrees() - 55.0).abs() < 1e-9);
        assert!(!Head.look_at(NECK).is_exact, "within the head");
        assert!(!Head.look_at(DVec3::NAN).is_exact);
    }
}
