//! Forward and inverse kinematics of a leg.

use crate::wrapped;
use downbeat_transforms::Isometry;
use glam::{DMat3, DQuat, DVec3};

/// A leg of the Darwin OP.
///
/// The frame of the hip has the axes of base_link and its origin where the three axes of the hip meet
/// ([`Leg::base_from_hip`]); the sole is on the ground below the ankle (`r_sole`, `l_sole`).
///
/// ```
/// use downbeat_kinematics::darwin_op::{Leg, Reach, Side};
/// use downbeat_transforms::Isometry;
///
/// // The foot 20 mm up and 10 mm forward of where it is with the leg straight.
/// let leg = Leg::new(Side::Right);
/// let hip_from_sole = Isometry::from_translation(0.01, 0.0, -0.1995);
/// let solution = leg.inverse(&hip_from_sole);
/// assert_eq!(solution.reach, Reach::Exact);
/// assert!((leg.forward(&solution.angles).translation - hip_from_sole.translation).length() < 1e-12);
///
/// let knee = Leg::joint_names(Side::Right).iter().position(|name| *name == "r_knee").unwrap();
/// assert!((solution.angles[knee].to_degrees() - 53.2).abs() < 0.1);
/// ```
///
/// # References
/// The chain (z, x, y of the hip, y of the knee, y and x of the ankle) and its lengths: `Walking::computeIK`
/// of ROBOTIS' framework. The solution goes from the foot to the hip, as that of UPenn (`OPKinematics`), with
/// half angles instead of inverse cosines, which keeps it exact when the leg is straight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Leg {
    side: Side,
}

/// The right or the left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Side {
    /// The right.
    Right,
    /// The left.
    Left,
}

/// The angles of a leg for a pose of the sole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LegSolution {
    /// In rad, in the order of [`Leg::joint_names`], within the limits.
    pub angles: [f64; 6],
    /// Whether the sole reaches the pose with these angles.
    pub reach: Reach,
}

/// Whether a leg reaches a pose. If several of them apply, it is the last one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reach {
    /// It reaches the pose.
    Exact,
    /// The pose is too far away: the leg is straight and points to it; the sole has the orientation.
    TooFar,
    /// The pose is nearer to the hip than the knee can bend: the sole has the orientation and the direction.
    TooClose,
    /// A joint would exceed its limits: it is at its limit.
    BeyondLimits,
}

/// From the hip to the knee and from the knee to the ankle, in m.
const SHANK: f64 = 0.093;
/// From the ankle to the sole, in m.
const FOOT: f64 = 0.0335;
/// From the middle to the hip, in m.
const HIP_OFFSET: f64 = 0.037;
/// The smallest and greatest angles of the right leg, in degrees. Those of the left leg are their negatives.
const LIMITS_DEG: [[f64; 2]; 6] =
    [[-123.0, 53.0], [-45.0, 59.0], [-100.0, 29.0], [-6.0, 130.0], [-72.0, 80.0], [-44.0, 63.0]];
/// How far rounding may put a pose beyond what is reachable, in m and rad.
const TOLERANCE: f64 = 1e-9;

impl Leg {
    /// The leg on this side.
    #[must_use]
    pub const fn new(side: Side) -> Self {
        Self { side }
    }

    /// The names of its joints, in the order of angles: hip yaw, hip roll, hip pitch, knee, ankle pitch,
    /// ankle roll.
    #[must_use]
    pub const fn joint_names(side: Side) -> [&'static str; 6] {
        match side {
            Side::Right => ["r_hip_yaw", "r_hip_roll", "r_hip_pitch", "r_knee", "r_ank_pitch", "r_ank_roll"],
            Side::Left => ["l_hip_yaw", "l_hip_roll", "l_hip_pitch", "l_knee", "l_ank_pitch", "l_ank_roll"],
        }
    }

    /// The smallest and the greatest angles of its joints, in rad.
    #[must_use]
    pub fn limits(&self) -> [[f64; 2]; 6] {
        LIMITS_DEG.map(|[min, max]| match self.side {
            Side::Right => [min.to_radians(), max.to_radians()],
            Side::Left => [-max.to_radians(), -min.to_radians()],
        })
    }

    /// Where the hip is.
    #[must_use]
    pub fn base_from_hip(&self) -> Isometry {
        Isometry::from_translation(0.0, if self.side == Side::Right { -HIP_OFFSET } else { HIP_OFFSET }, 0.0)
    }

    /// By which the rotations about z, x, y, y, y, x are multiplied to obtain the angles of the servos.
    const fn signs(self) -> [f64; 6] {
        match self.side {
            Side::Right => [-1.0, -1.0, 1.0, 1.0, -1.0, 1.0],
            Side::Left => [-1.0, -1.0, -1.0, -1.0, 1.0, 1.0],
        }
    }

    /// `hip_from_sole` for these angles, in rad.
    #[must_use]
    pub fn forward(&self, angles: &[f64; 6]) -> Isometry {
        let [yaw, roll, pitch, knee, ankle_pitch, ankle_roll] = product(angles, &self.signs());
        let about_y = DQuat::from_rotation_y;
        let hip_from_thigh = DQuat::from_rotation_z(yaw) * DQuat::from_rotation_x(roll) * about_y(pitch);
        let hip_from_shin = hip_from_thigh * about_y(knee);
        let rotation = hip_from_shin * about_y(ankle_pitch) * DQuat::from_rotation_x(ankle_roll);
        let ankle = hip_from_thigh * (DVec3::NEG_Z * SHANK) + hip_from_shin * (DVec3::NEG_Z * SHANK);
        Isometry { translation: ankle + rotation * (DVec3::NEG_Z * FOOT), rotation }
    }

    /// The angles with which the sole reaches a pose, or comes near it; see [`Reach`]. Takes less than 300
    /// ns; [`Leg::nearest`] takes longer and comes nearest.
    ///
    /// The solution with the knee bent forward is preferred. For a pose that is not finite, all angles are
    /// NaN.
    #[must_use]
    pub fn inverse(&self, hip_from_sole: &Isometry) -> LegSolution {
        if !(hip_from_sole.translation.is_finite() && hip_from_sole.rotation.is_finite()) {
            return LegSolution { angles: [f64::NAN; 6], reach: Reach::BeyondLimits };
        }
        let mut solutions = self.solutions(hip_from_sole);
        let preferred = solutions.next();
        if let Some(preferred) = preferred.filter(|solution| solution.reach < Reach::BeyondLimits) {
            return preferred;
        }
        // Near the ends of the joints, only another solution may be within the limits.
        let other = solutions.find(|other| other.reach < Reach::BeyondLimits).or(preferred);
        other.unwrap_or(LegSolution { angles: [f64::NAN; 6], reach: Reach::BeyondLimits })
    }

    /// All four solutions, the preferred one first.
    pub(super) fn solutions(self, hip_from_sole: &Isometry) -> impl Iterator<Item = LegSolution> {
        let hip_from_sole_axes = DMat3::from_quat(hip_from_sole.rotation);
        let ankle = hip_from_sole.translation + hip_from_sole_axes.z_axis * FOOT;
        // The hip as seen from the ankle.
        let sole_from_hip = hip_from_sole_axes.transpose() * -ankle;
        let all = [
            (Knee::Forward, Shin::Up),
            (Knee::Forward, Shin::Down),
            (Knee::Backward, Shin::Up),
            (Knee::Backward, Shin::Down),
        ];
        all.into_iter().map(move |(knee, shin)| self.solve(&hip_from_sole_axes, sole_from_hip, knee, shin))
    }

    /// `hip_from_sole` for these angles, and for each joint its axis and a point on it, both in the hip. The
    /// sole turns about the axis as the angle of the servo grows.
    pub(super) fn axes(self, angles: &[f64; 6]) -> (Isometry, [(DVec3, DVec3); 6]) {
        let [yaw, roll, pitch, knee, ankle_pitch, ankle_roll] = product(angles, &self.signs());
        let about_y = DQuat::from_rotation_y;
        let after_yaw = DQuat::from_rotation_z(yaw);
        let after_roll = after_yaw * DQuat::from_rotation_x(roll);
        let hip_from_thigh = after_roll * about_y(pitch);
        let hip_from_shin = hip_from_thigh * about_y(knee);
        let hip_from_foot = hip_from_shin * about_y(ankle_pitch);
        let rotation = hip_from_foot * DQuat::from_rotation_x(ankle_roll);
        let knee = hip_from_thigh * (DVec3::NEG_Z * SHANK);
        let ankle = knee + hip_from_shin * (DVec3::NEG_Z * SHANK);
        let hip_from_sole = Isometry { translation: ankle + rotation * (DVec3::NEG_Z * FOOT), rotation };
        let across = after_roll * DVec3::Y;
        let axes = [
            (DVec3::Z, DVec3::ZERO),
            (after_yaw * DVec3::X, DVec3::ZERO),
            (across, DVec3::ZERO),
            (across, knee),
            (across, ankle),
            (hip_from_foot * DVec3::X, ankle),
        ];
        let signs = self.signs();
        (hip_from_sole, std::array::from_fn(|joint| (axes[joint].0 * signs[joint], axes[joint].1)))
    }

    /// One of the four solutions.
    ///
    /// Rotations of the chain are Rz(yaw) Rx(roll) Ry(pitch) Ry(knee) Ry(ankle_pitch) Rx(ankle_roll).
    fn solve(&self, hip_from_sole_axes: &DMat3, sole_from_hip: DVec3, knee: Knee, shin: Shin) -> LegSolution {
        // (1) The ankle roll turns the hip into the plane in which knee and ankle pitch bend the leg.
        let across = sole_from_hip.y.hypot(sole_from_hip.z);
        let up = if shin == Shin::Up { across } else { -across };
        let (sin, cos) = if across > 0.0 { (sole_from_hip.y / up, sole_from_hip.z / up) } else { (0.0, 1.0) };
        let ankle_roll = sin.atan2(cos);
        // (2) With equal shanks, the distance from hip to ankle is 2 SHANK cos(knee / 2).
        let distance = sole_from_hip.length();
        let bend = ((2.0 * SHANK - distance) * (2.0 * SHANK + distance)).max(0.0).sqrt();
        let bend = 2.0 * bend.atan2(distance);
        let [min, max] = LIMITS_DEG[3].map(f64::to_radians);
        let wanted = if knee == Knee::Forward { bend } else { -bend };
        let knee = wanted.clamp(min, max);
        // (3) Seen from the ankle, the hip is at the angle -knee / 2 - ankle_pitch from z to x.
        let ankle_pitch = -knee / 2.0 - sole_from_hip.x.atan2(up);
        // (4) What remains of the rotation is that of the hip: Rz(yaw) Rx(roll) Ry(pitch + knee +
        // ankle_pitch).
        let DMat3 { x_axis, y_axis, z_axis } = *hip_from_sole_axes;
        let y = y_axis * cos - z_axis * sin;
        let z = y_axis * sin + z_axis * cos;
        let yaw = (-y.x).atan2(y.y);
        let roll = y.z.atan2(y.x.hypot(y.y));
        let pitch = (-x_axis.z).atan2(z.z);
        let pitch = wrapped(pitch - knee - ankle_pitch);
        let wanted_angles = [yaw, roll, pitch, knee, wrapped(ankle_pitch), ankle_roll];
        let wanted_angles = product(&wanted_angles, &self.signs());
        let limits = self.limits();
        let angles =
            std::array::from_fn(|index| wanted_angles[index].clamp(limits[index][0], limits[index][1]));
        let is_beyond = |index: usize| (wanted_angles[index] - angles[index]).abs() > TOLERANCE;
        let reach = if (0..6).any(is_beyond) || wanted < min - TOLERANCE {
            Reach::BeyondLimits
        } else if wanted > max + TOLERANCE {
            Reach::TooClose
        } else if distance > 2.0 * SHANK + TOLERANCE {
            Reach::TooFar
        } else {
            Reach::Exact
        };
        LegSolution { angles, reach }
    }
}

/// In which direction the knee points.
#[derive(Clone, Copy, PartialEq)]
enum Knee {
    Forward,
    Backward,
}

/// On which side of the foot the hip is.
#[derive(Clone, Copy, PartialEq)]
enum Shin {
    Up,
    Down,
}

fn product(left: &[f64; 6], right: &[f64; 6]) -> [f64; 6] {
    std::array::from_fn(|index| left[index] * right[index])
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use proptest::prelude::*;

    fn sides() -> impl Strategy<Value = Leg> {
        prop_oneof![Just(Leg::new(Side::Right)), Just(Leg::new(Side::Left))]
    }

    /// Angles within the limits.
    fn angles(leg: Leg) -> impl Strategy<Value = [f64; 6]> {
        leg.limits().map(|[min, max]| min..=max)
    }

    fn distance(one: &Isometry, other: &Isometry) -> f64 {
        let turned = one.rotation * other.rotation.conjugate();
        (one.translation - other.translation).length().max(2.0 * turned.xyz().length())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        #[test]
        fn every_pose_within_the_limits_is_reached((leg, angles) in sides().prop_flat_map(|leg| (Just(leg), angles(leg)))) {
            let hip_from_sole = leg.forward(&angles);
            let solution = leg.inverse(&hip_from_sole);
            prop_assert_eq!(solution.reach, Reach::Exact);
            let error = distance(&leg.forward(&solution.angles), &hip_from_sole);
            prop_assert!(error < 1e-9, "{}", error);
        }

        #[test]
        fn any_pose_has_angles_within_the_limits(
            leg in sides(), x in -0.3..0.3, y in -0.3..0.3, z in -0.3..0.3, roll in -4.0..4.0, pitch in -4.0..4.0,
            yaw in -4.0..4.0,
        ) {
            let rotation = DQuat::from_euler(glam::EulerRot::ZYX, yaw, pitch, roll);
            let hip_from_sole = Isometry { translation: DVec3::new(x, y, z), rotation };
            let solution = leg.inverse(&hip_from_sole);
            for (angle, [min, max]) in solution.angles.into_iter().zip(leg.limits()) {
                prop_assert!((min..=max).contains(&angle));
            }
            let is_reached = distance(&leg.forward(&solution.angles), &hip_from_sole) < 1e-8;
            prop_assert_eq!(is_reached, solution.reach == Reach::Exact);
        }
    }

    #[test]
    fn a_straight_leg_is_exact() {
        for side in [Side::Right, Side::Left] {
            let leg = Leg::new(side);
            let straight = Isometry::from_translation(0.0, 0.0, -0.2195);
            assert_eq!(leg.inverse(&straight), LegSolution { angles: [0.0; 6], reach: Reach::Exact });
        }
    }

    #[test]
    fn the_walking_ready_pose_is_that_of_the_motion_file() {
        // Page 9: hip pitch, knee and ankle pitch of the right leg, in ticks.
        let angle = |ticks: f64| (ticks - 2048.0) * std::f64::consts::TAU / 4096.0;
        let ready = [0.0, 0.0, angle(1637.0), angle(2653.0), angle(2389.0), 0.0];
        let leg = Leg::new(Side::Right);
        let solution = leg.inverse(&leg.forward(&ready));
        for (found, expected) in solution.angles.into_iter().zip(ready) {
            assert!((found - expected).abs() < 1e-9, "{solution:?}");
        }
    }

    #[test]
    fn a_pose_that_is_too_far_is_approached_with_a_straight_leg_and_the_wanted_orientation() {
        let leg = Leg::new(Side::Left);
        let rotation = DQuat::from_rotation_z(0.2);
        let target = Isometry { translation: DVec3::new(0.05, 0.02, -0.3), rotation };
        let solution = leg.inverse(&target);
        assert_eq!((solution.reach, solution.angles[3]), (Reach::TooFar, -0.0));
        let reached = leg.forward(&solution.angles);
        assert!((reached.rotation * rotation.conjugate()).xyz().length() < 1e-12);
        let foot = DVec3::new(0.0, 0.0, FOOT);
        let (ankle, wanted) = (reached.translation + foot, target.translation + foot);
        assert!((ankle.length() - 0.186).abs() < 1e-12 && ankle.angle_between(wanted) < 1e-7);
    }

    #[test]
    fn a_pose_that_is_too_close_bends_the_knee_to_its_limit() {
        let solution = Leg::new(Side::Right).inverse(&Isometry::from_translation(0.0, 0.0, -0.1));
        assert_eq!(solution.reach, Reach::TooClose);
        assert!((solution.angles[3].to_degrees() - 130.0).abs() < 1e-9);
    }

    #[test]
    fn a_pose_beyond_the_limits_of_a_joint_is_flagged() {
        let rotation = DQuat::from_rotation_z(1.5);
        let target = Isometry { translation: DVec3::new(0.0, 0.0, -0.2), rotation };
        let solution = Leg::new(Side::Left).inverse(&target);
        assert_eq!(solution.reach, Reach::BeyondLimits);
        assert!((solution.angles[0] + 53_f64.to_radians()).abs() < 1e-9);
    }

    #[test]
    fn a_pose_that_is_not_finite_gives_nan() {
        let solution = Leg::new(Side::Left).inverse(&Isometry::from_translation(f64::NAN, 0.0, -0.2));
        assert!(solution.angles.iter().all(|angle| angle.is_nan()), "{solution:?}");
        assert_eq!(solution.reach, Reach::BeyondLimits);
    }
}
