//! The frames of PX4 and those of ROS.
//!
//! | | world | body |
//! | --- | --- | --- |
//! | PX4 | NED: north, east, down | FRD: forward, right, down |
//! | ROS | ENU: east, north, up | FLU: forward, left, up |
//!
//! Each function is its own inverse, because both pairs of frames are half a turn apart: the worlds about the
//! axis between north and east, the bodies about the forward axis. So there is one function for both ways.
//!
//! A rotation is `world_from_body`: it maps coordinates in the body to coordinates in the world, as the
//! quaternions of PX4 (in the order w, x, y, z) and of ROS (x, y, z, w) do.
//!
//! ```
//! use downbeat_px4::frames::{ned_enu, rotation_ned_enu};
//! use glam::{DQuat, DVec3};
//!
//! assert_eq!(ned_enu(DVec3::new(1.0, 0.0, -2.0)), DVec3::new(0.0, 1.0, 2.0)); // 1 m north, 2 m up
//!
//! // Level, and facing north: no rotation in PX4, a quarter of a turn to the left of east in ROS.
//! let north = rotation_ned_enu(DQuat::IDENTITY);
//! assert!((north * DVec3::X - DVec3::Y).length() < 1e-12);
//! ```
//!
//! # References
//! - REP-103 "Standard Units of Measure and Coordinate Conventions", for ENU and FLU; REP-147 "A Standard
//!   interface for Aerial Vehicles", for what an odometry of an aerial vehicle is.
//! - PX4 user guide, "ROS 2 User Guide", section "ROS 2 & PX4 Frame Conventions".
//! - `VehicleOdometry.msg` of px4_msgs: quaternions and frames.

use glam::{DMat3, DQuat, DVec3};
use std::f64::consts::FRAC_1_SQRT_2;

/// A vector of the world in NED, given in ENU, or the other way round.
#[must_use]
pub fn ned_enu(vector: DVec3) -> DVec3 {
    DVec3::new(vector.y, vector.x, -vector.z)
}

/// A vector of the body in FRD, given in FLU, or the other way round: velocities, accelerations, angular
/// rates. Also one of a world whose heading is arbitrary, such as PX4's `POSE_FRAME_FRD`.
#[must_use]
pub fn frd_flu(vector: DVec3) -> DVec3 {
    DVec3::new(vector.x, -vector.y, -vector.z)
}

/// The orientation of the FRD body in the NED world, given that of the FLU body in the ENU world, or the
/// other way round.
///
/// With the half turns e about the axis (1, 1, 0) of the worlds and f about the axis (1, 0, 0) of the bodies:
///
/// (1)  q' = e q f = (w + z, x + y, x - y, w - z) / √2,  in the order w, x, y, z, up to the sign of all
#[must_use]
pub fn rotation_ned_enu(world_from_body: DQuat) -> DQuat {
    let DQuat { x, y, z, w } = world_from_body;
    DQuat::from_xyzw(x + y, x - y, w - z, w + z) * FRAC_1_SQRT_2
}

/// The orientation of the FRD body in an FRD world, given that of the FLU body in the FLU world of the same
/// heading, or the other way round.
#[must_use]
pub fn rotation_frd_flu(world_from_body: DQuat) -> DQuat {
    let DQuat { x, y, z, w } = world_from_body;
    DQuat::from_xyzw(x, -y, -z, w)
}

/// The covariance of a vector of the world in NED, given in ENU, or the other way round.
#[must_use]
pub fn covariance_ned_enu(covariance: DMat3) -> DMat3 {
    let turn = DMat3::from_cols(DVec3::Y, DVec3::X, -DVec3::Z);
    turn * covariance * turn
}

/// The covariance of a vector of the body in FRD, given in FLU, or the other way round.
#[must_use]
pub fn covariance_frd_flu(covariance: DMat3) -> DMat3 {
    let turn = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    turn * covariance * turn
}

/// The covariance of a vector in the target frame: R C Rᵀ.
#[must_use]
pub fn rotated_covariance(target_from_source: DQuat, covariance: DMat3) -> DMat3 {
    let rotation = DMat3::from_quat(target_from_source);
    rotation * covariance * rotation.transpose()
}

/// The heading of the body in PX4, in rad clockwise from north, given that in ROS, in rad counter-clockwise
/// from east, or the other way round; within -π and π.
#[must_use]
pub fn heading_ned_enu(yaw: f64) -> f64 {
    downbeat_transforms::wrapped(std::f64::consts::FRAC_PI_2 - yaw)
}

/// The yaw of an orientation, in rad: the direction of the body's x axis in the plane of the world's x and y.
#[must_use]
pub fn yaw(world_from_body: DQuat) -> f64 {
    let ahead = world_from_body * DVec3::X;
    libm::atan2(ahead.y, ahead.x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    /// The rotation matrices of the definitions: rows are the axes of the target in the source.
    const ENU_FROM_NED: DMat3 = DMat3::from_cols(DVec3::Y, DVec3::X, DVec3::NEG_Z);
    const FRD_FROM_FLU: DMat3 = DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z);

    fn angle_between(one: DQuat, two: DQuat) -> f64 {
        // Both signs are the same rotation.
        2.0 * (one - two).length().min((one + two).length())
    }

    fn rotations() -> impl Strategy<Value = DQuat> {
        prop::array::uniform4(-1.0..1.0_f64)
            .prop_map(DQuat::from_array)
            .prop_filter("not zero", |rotation| rotation.length() > 0.1)
            .prop_map(DQuat::normalize)
    }

    fn vectors() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-1e3..1e3_f64).prop_map(DVec3::from_array)
    }

    #[test]
    fn level_and_facing_the_four_directions() {
        // The yaw of PX4 is clockwise from north, that of ROS counter-clockwise from east.
        for (ned, enu) in [(0.0, FRAC_PI_2), (FRAC_PI_2, 0.0), (PI, -FRAC_PI_2), (-FRAC_PI_2, PI)] {
            let rotation = rotation_ned_enu(DQuat::from_rotation_z(ned));
            assert!(angle_between(rotation, DQuat::from_rotation_z(enu)) < 1e-12, "{ned}");
            assert!((downbeat_transforms::wrapped(yaw(rotation) - enu)).abs() < 1e-12, "{ned}");
            assert!((downbeat_transforms::wrapped(heading_ned_enu(ned) - enu)).abs() < 1e-12, "{ned}");
        }
    }

    #[test]
    fn nose_up_and_right_side_down() {
        // Facing north with the nose up by 0.3 rad: positive pitch in FRD, negative pitch in FLU.
        let nose_up = rotation_ned_enu(DQuat::from_rotation_y(0.3));
        let expected = DQuat::from_rotation_z(FRAC_PI_2) * DQuat::from_rotation_y(-0.3);
        assert!(angle_between(nose_up, expected) < 1e-12);
        assert!((nose_up * DVec3::X).z > 0.0, "x points up");
        // The right side down: positive roll in both.
        let right_down = rotation_ned_enu(DQuat::from_rotation_x(0.2));
        let expected = DQuat::from_rotation_z(FRAC_PI_2) * DQuat::from_rotation_x(0.2);
        assert!(angle_between(right_down, expected) < 1e-12);
    }

    #[test]
    fn a_turn_to_the_right_is_negative_in_ros() {
        assert_eq!(frd_flu(DVec3::new(0.0, 0.0, 0.5)), DVec3::new(0.0, 0.0, -0.5));
        assert_eq!(frd_flu(DVec3::new(0.0, 0.0, -9.81)), DVec3::new(0.0, 0.0, 9.81), "at rest");
    }

    #[test]
    fn variances_go_with_their_axes() {
        let covariance = DMat3::from_diagonal(DVec3::new(1.0, 2.0, 3.0));
        assert_eq!(covariance_ned_enu(covariance), DMat3::from_diagonal(DVec3::new(2.0, 1.0, 3.0)));
        assert_eq!(covariance_frd_flu(covariance), covariance);
        let quarter = rotated_covariance(DQuat::from_rotation_z(FRAC_PI_2), covariance);
        assert!((quarter.x_axis.x - 2.0).abs() < 1e-12 && (quarter.y_axis.y - 1.0).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn everything_comes_back(vector in vectors(), rotation in rotations(), yaw in -3.1..3.1_f64) {
            prop_assert_eq!(ned_enu(ned_enu(vector)), vector);
            prop_assert_eq!(frd_flu(frd_flu(vector)), vector);
            prop_assert!(angle_between(rotation_ned_enu(rotation_ned_enu(rotation)), rotation) < 1e-12);
            prop_assert_eq!(rotation_frd_flu(rotation_frd_flu(rotation)), rotation);
            prop_assert!((heading_ned_enu(heading_ned_enu(yaw)) - yaw).abs() < 1e-12);
        }

        #[test]
        fn a_rotation_is_that_of_the_matrices(rotation in rotations(), vector in vectors()) {
            let by_matrices = ENU_FROM_NED * (DMat3::from_quat(rotation) * (FRD_FROM_FLU * vector));
            let rotated = rotation_ned_enu(rotation);
            prop_assert!((rotated.length() - 1.0).abs() < 1e-12);
            prop_assert!((rotated * vector - by_matrices).length() < 1e-9);
            prop_assert!((ned_enu(vector) - ENU_FROM_NED * vector).length() == 0.0);
            let in_frd = FRD_FROM_FLU * (DMat3::from_quat(rotation) * (FRD_FROM_FLU * vector));
            prop_assert!((rotation_frd_flu(rotation) * vector - in_frd).length() < 1e-9);
        }

        #[test]
        fn a_covariance_stays_symmetric_and_keeps_its_trace(
            rotation in rotations(), a in vectors(), b in vectors(),
        ) {
            // Of samples a and b: positive semidefinite.
            let outer = |v: DVec3| DMat3::from_cols(v * v.x, v * v.y, v * v.z);
            let covariance = outer(a) + outer(b);
            for turned in [
                covariance_ned_enu(covariance),
                covariance_frd_flu(covariance),
                rotated_covariance(rotation, covariance),
            ] {
                let trace = |m: DMat3| m.x_axis.x + m.y_axis.y + m.z_axis.z;
                prop_assert!((trace(turned) - trace(covariance)).abs() <= 1e-9 * trace(covariance).max(1.0));
                let difference = turned - turned.transpose();
                prop_assert!(difference.to_cols_array().iter().all(|d| d.abs() <= 1e-9 * trace(covariance).max(1.0)));
            }
            prop_assert_eq!(covariance_ned_enu(outer(a)), outer(ned_enu(a)));
        }
    }
}
