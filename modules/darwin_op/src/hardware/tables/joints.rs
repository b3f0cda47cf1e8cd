//! The twenty joints of the Darwin OP.
//!
//! The joint angle is 0 at tick 2048, legs straight, upper arms 45 degrees out, forearms bent 90 degrees
//! forward.
//!
//! # References
//! Ids and names: DARwIn-OP framework (the names are those of ROBOTIS for its later robots in ROS, some of
//! whose joints turn the other way round). Limits and axes: drewnoakes/bold-humanoid,
//! `configuration-team.json` and `DarwinBodyModel`, turned to REP-103. Walking-ready pose: page 9 of the
//! factory's motion file.

use super::super::protocol::Id;
use super::units::ticks_from_radians;

/// The number of joints. Their ids are 1 to 20.
pub const COUNT: usize = 20;

/// One joint and the servo that moves it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// The address of its servo.
    pub id: Id,
    /// Its name in ROS.
    pub name: &'static str,
    /// The axis it turns about: forward, left, up.
    pub axis: [i8; 3],
    /// The smallest angle, in degrees.
    pub min_deg: f64,
    /// The largest angle, in degrees.
    pub max_deg: f64,
    /// Its position in the walking-ready stand, in ticks.
    pub walking_ready_ticks: u16,
}

impl Joint {
    /// The smallest angle, in rad.
    #[must_use]
    pub fn min_rad(&self) -> f64 {
        self.min_deg * (std::f64::consts::PI / 180.0)
    }

    /// The largest angle, in rad.
    #[must_use]
    pub fn max_rad(&self) -> f64 {
        self.max_deg * (std::f64::consts::PI / 180.0)
    }

    /// The goal in ticks for an angle in rad, which is clamped to the limits.
    ///
    /// `None` if the angle is not a number.
    #[must_use]
    pub fn goal_ticks(&self, angle_rad: f64, offset_ticks: i16) -> Option<u16> {
        if angle_rad.is_nan() {
            return None;
        }
        Some(ticks_from_radians(angle_rad.clamp(self.min_rad(), self.max_rad()), offset_ticks))
    }
}

const fn joint(id: u8, name: &'static str, axis: [i8; 3], limits_deg: (f64, f64), ready: u16) -> Joint {
    let Some(id) = Id::new(id) else { panic!("0xFF is no id") };
    let (min_deg, max_deg) = limits_deg;
    Joint { id, name, axis, min_deg, max_deg, walking_ready_ticks: ready }
}

/// All joints, in the order of their ids.
pub const JOINTS: [Joint; COUNT] = [
    joint(1, "r_sho_pitch", [0, -1, 0], (-180.0, 180.0), 1498),
    joint(2, "l_sho_pitch", [0, 1, 0], (-180.0, 180.0), 2518),
    joint(3, "r_sho_roll", [-1, 0, 0], (-75.0, 135.0), 1845),
    joint(4, "l_sho_roll", [-1, 0, 0], (-135.0, 75.0), 2248),
    joint(5, "r_el", [0, -1, 0], (-95.0, 70.0), 2381),
    joint(6, "l_el", [0, 1, 0], (-70.0, 95.0), 1712),
    joint(7, "r_hip_yaw", [0, 0, -1], (-123.0, 53.0), 2048),
    joint(8, "l_hip_yaw", [0, 0, -1], (-53.0, 123.0), 2048),
    joint(9, "r_hip_roll", [-1, 0, 0], (-45.0, 59.0), 2052),
    joint(10, "l_hip_roll", [-1, 0, 0], (-59.0, 45.0), 2044),
    joint(11, "r_hip_pitch", [0, 1, 0], (-100.0, 29.0), 1637),
    joint(12, "l_hip_pitch", [0, -1, 0], (-29.0, 100.0), 2459),
    joint(13, "r_knee", [0, 1, 0], (-6.0, 130.0), 2653),
    joint(14, "l_knee", [0, -1, 0], (-130.0, 6.0), 1443),
    joint(15, "r_ank_pitch", [0, -1, 0], (-72.0, 80.0), 2389),
    joint(16, "l_ank_pitch", [0, 1, 0], (-80.0, 72.0), 1707),
    joint(17, "r_ank_roll", [1, 0, 0], (-44.0, 63.0), 2057),
    joint(18, "l_ank_roll", [1, 0, 0], (-63.0, 44.0), 2039),
    joint(19, "head_pan", [0, 0, 1], (-135.0, 135.0), 2048),
    joint(20, "head_tilt", [0, -1, 0], (-25.0, 55.0), 2161),
];

/// The position of a joint in [`JOINTS`], by its name.
#[must_use]
pub fn index_of(name: &str) -> Option<usize> {
    JOINTS.iter().position(|joint| joint.name == name)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::units::radians_from_ticks;
    use super::*;

    #[test]
    fn ids_are_one_to_twenty_in_order() {
        let ids: Vec<u8> = JOINTS.iter().map(|joint| joint.id.raw()).collect();
        assert_eq!(ids, (1..=20).collect::<Vec<u8>>());
    }

    #[test]
    fn the_left_side_mirrors_the_right() {
        for pair in JOINTS[..18].chunks(2) {
            let (right, left) = (&pair[0], &pair[1]);
            assert_eq!(right.name.strip_prefix("r_"), left.name.strip_prefix("l_"));
            assert_eq!((right.min_deg, right.max_deg), (-left.max_deg, -left.min_deg), "{}", right.name);
        }
    }

    #[test]
    fn the_walking_ready_pose_is_inside_the_limits() {
        for joint in &JOINTS {
            let angle = radians_from_ticks(joint.walking_ready_ticks, 0);
            assert!((joint.min_rad()..=joint.max_rad()).contains(&angle), "{}", joint.name);
            assert_eq!(joint.goal_ticks(angle, 0), Some(joint.walking_ready_ticks));
        }
        let knee = &JOINTS[index_of("r_knee").unwrap()];
        assert!((radians_from_ticks(knee.walking_ready_ticks, 0).to_degrees() - 53.17).abs() < 0.01);
    }

    #[test]
    fn a_goal_outside_the_limits_is_clamped_and_nan_is_refused() {
        let tilt = &JOINTS[index_of("head_tilt").unwrap()];
        assert_eq!(tilt.goal_ticks(10.0, 0), tilt.goal_ticks(tilt.max_rad(), 0));
        assert_eq!(tilt.goal_ticks(f64::NEG_INFINITY, 0), tilt.goal_ticks(tilt.min_rad(), 0));
        assert_eq!(tilt.goal_ticks(f64::NAN, 0), None);
    }

    #[test]
    fn an_unknown_name_is_not_found() {
        assert_eq!(index_of("head_pan"), Some(18));
        assert_eq!(index_of("head-pan"), None);
    }
}
