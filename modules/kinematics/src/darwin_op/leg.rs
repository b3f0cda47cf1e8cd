//! The legs of the Darwin OP.

use crate::leg::{Leg, LegGeometry, Side};
use glam::DVec3;

/// From the hip to the knee and from the knee to the ankle, in m.
const SHANK: f64 = 0.093;
/// From the ankle to the sole, in m.
const FOOT: f64 = 0.0335;
/// From the middle to the hip, in m.
const HIP_OFFSET: f64 = 0.037;
/// The smallest and greatest angles of the right leg, in degrees. Those of the left leg are their negatives.
const LIMITS_DEG: [[f64; 2]; 6] =
    [[-123.0, 53.0], [-45.0, 59.0], [-100.0, 29.0], [-6.0, 130.0], [-72.0, 80.0], [-44.0, 63.0]];

/// The leg on this side; the sole is the link `r_sole` or `l_sole`.
///
/// # References
/// The chain and its lengths: `Walking::computeIK` of ROBOTIS' framework.
#[must_use]
pub fn leg(side: Side) -> Leg {
    let (hip, signs, limits) = match side {
        Side::Right => (
            -HIP_OFFSET,
            [-1.0, -1.0, 1.0, 1.0, -1.0, 1.0],
            LIMITS_DEG.map(|[min, max]| [min.to_radians(), max.to_radians()]),
        ),
        Side::Left => (
            HIP_OFFSET,
            [-1.0, -1.0, -1.0, -1.0, 1.0, 1.0],
            LIMITS_DEG.map(|[min, max]| [-max.to_radians(), -min.to_radians()]),
        ),
    };
    Leg::new(LegGeometry {
        hip: DVec3::new(0.0, hip, 0.0),
        thigh: SHANK,
        shank: SHANK,
        foot: FOOT,
        signs,
        limits,
    })
}

/// The names of the joints of a leg, in the order of its angles.
#[must_use]
pub const fn leg_joint_names(side: Side) -> [&'static str; 6] {
    match side {
        Side::Right => ["r_hip_yaw", "r_hip_roll", "r_hip_pitch", "r_knee", "r_ank_pitch", "r_ank_roll"],
        Side::Left => ["l_hip_yaw", "l_hip_roll", "l_hip_pitch", "l_knee", "l_ank_pitch", "l_ank_roll"],
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::leg::{LegSolution, Reach};
    use downbeat_transforms::Isometry;
    use glam::DQuat;
    use proptest::prelude::*;

    fn sides() -> impl Strategy<Value = Leg> {
        prop_oneof![Just(leg(Side::Right)), Just(leg(Side::Left))]
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
            let leg = leg(side);
            let straight = Isometry::from_translation(0.0, 0.0, -0.2195);
            assert_eq!(leg.inverse(&straight), LegSolution { angles: [0.0; 6], reach: Reach::Exact });
        }
    }

    #[test]
    fn the_walking_ready_pose_is_that_of_the_motion_file() {
        // Page 9: hip pitch, knee and ankle pitch of the right leg, in ticks.
        let angle = |ticks: f64| (ticks - 2048.0) * std::f64::consts::TAU / 4096.0;
        let ready = [0.0, 0.0, angle(1637.0), angle(2653.0), angle(2389.0), 0.0];
        let leg = leg(Side::Right);
        let solution = leg.inverse(&leg.forward(&ready));
        for (found, expected) in solution.angles.into_iter().zip(ready) {
            assert!((found - expected).abs() < 1e-9, "{solution:?}");
        }
    }

    #[test]
    fn a_pose_that_is_too_far_is_approached_with_a_straight_leg_and_the_wanted_orientation() {
        let leg = leg(Side::Left);
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
        let solution = leg(Side::Right).inverse(&Isometry::from_translation(0.0, 0.0, -0.1));
        assert_eq!(solution.reach, Reach::TooClose);
        assert!((solution.angles[3].to_degrees() - 130.0).abs() < 1e-9);
    }

    #[test]
    fn a_pose_beyond_the_limits_of_a_joint_is_flagged() {
        let rotation = DQuat::from_rotation_z(1.5);
        let target = Isometry { translation: DVec3::new(0.0, 0.0, -0.2), rotation };
        let solution = leg(Side::Left).inverse(&target);
        assert_eq!(solution.reach, Reach::BeyondLimits);
        assert!((solution.angles[0] + 53_f64.to_radians()).abs() < 1e-9);
    }

    #[test]
    fn a_pose_that_is_not_finite_gives_nan() {
        let solution = leg(Side::Left).inverse(&Isometry::from_translation(f64::NAN, 0.0, -0.2));
        assert!(solution.angles.iter().all(|angle| angle.is_nan()), "{solution:?}");
        assert_eq!(solution.reach, Reach::BeyondLimits);
    }
}

#[cfg(test)]
mod nearest_tests {
    use super::leg;
    use crate::leg::{Leg, NearestLeg, Reach, Side};
    use downbeat_transforms::Isometry;
    use glam::{DQuat, DVec3, EulerRot};
    use proptest::prelude::*;

    fn legs() -> impl Strategy<Value = Leg> {
        prop_oneof![Just(leg(Side::Right)), Just(leg(Side::Left))]
    }

    fn poses() -> impl Strategy<Value = Isometry> {
        (-0.3..0.3, -0.3..0.3, -0.3..0.3, -4.0..4.0, -4.0..4.0, -4.0..4.0).prop_map(
            |(x, y, z, roll, pitch, yaw)| Isometry {
                translation: DVec3::new(x, y, z),
                rotation: DQuat::from_euler(EulerRot::ZYX, yaw, pitch, roll),
            },
        )
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100))]

        #[test]
        fn the_nearest_pose_is_never_worse_than_the_clamped_one(leg in legs(), target in poses()) {
            let solution = leg.inverse(&target);
            let clamped = NearestLeg::new(&leg, &target, solution.angles, solution.reach);
            let nearest = leg.nearest(&target);
            prop_assert!(nearest.error() <= clamped.error());
            prop_assert_eq!(nearest.reach, solution.reach);
            for (angle, [min, max]) in nearest.angles.into_iter().zip(leg.limits()) {
                prop_assert!((min..=max).contains(&angle));
            }
        }

        #[test]
        fn a_pose_within_the_limits_has_the_exact_angles(
            (leg, angles) in legs().prop_flat_map(|leg| (Just(leg), leg.limits().map(|[min, max]| min..=max))),
        ) {
            let target = leg.forward(&angles);
            let nearest = leg.nearest(&target);
            prop_assert_eq!(nearest.reach, Reach::Exact);
            prop_assert_eq!(nearest.angles, leg.inverse(&target).angles);
            prop_assert!(nearest.distance < 1e-9 && nearest.angle < 1e-7, "{:?}", nearest);
        }

        #[test]
        fn no_small_change_within_the_limits_comes_nearer(leg in legs(), target in poses(), change in proptest::array::uniform6(-1.0..1.0_f64)) {
            let nearest = leg.nearest(&target);
            for scale in [1e-2, 1e-3] {
                let limits = leg.limits();
                let angles = std::array::from_fn(|joint| {
                    (nearest.angles[joint] + scale * change[joint]).clamp(limits[joint][0], limits[joint][1])
                });
                let changed = NearestLeg::new(&leg, &target, angles, nearest.reach);
                prop_assert!(changed.error() > nearest.error() * (1.0 - 5e-3) - 1e-12, "{:?} {:?}", nearest, changed);
            }
        }
    }

    #[test]
    fn a_sole_straight_below_a_straight_leg_is_nearest_with_the_leg_straight() {
        for side in [Side::Right, Side::Left] {
            let nearest = leg(side).nearest(&Isometry::from_translation(0.0, 0.0, -0.25));
            assert!((nearest.distance - 0.0305).abs() < 1e-9 && nearest.angle < 1e-6, "{nearest:?}");
        }
    }

    #[test]
    fn a_pose_that_is_not_finite_gives_nan() {
        let nearest = leg(Side::Left).nearest(&Isometry::from_translation(f64::NAN, 0.0, -0.2));
        assert!(nearest.angles.iter().all(|angle| angle.is_nan()), "{nearest:?}");
    }
}
