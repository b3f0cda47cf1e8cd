//! Legs in closed form: of any lengths, and as a description has them.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_kinematics::leg::{Leg, LegGeometry, Reach, Side};
use downbeat_kinematics::{Robot, darwin_op};
use glam::DVec3;
use proptest::prelude::*;

const JOINTS: [&str; 6] = ["r_hip_yaw", "r_hip_roll", "r_hip_pitch", "r_knee", "r_ank_pitch", "r_ank_roll"];

fn darwin_op_urdf() -> String {
    std::fs::read_to_string("../../robots/darwin_op.urdf").unwrap()
}

fn leg_of(urdf: &str) -> Result<Leg, String> {
    let robot = Robot::from_urdf(urdf, "robot.urdf").unwrap();
    Leg::of(&robot, "base_link", JOINTS, "r_sole").map_err(|error| error.to_string())
}

/// The error for a description of the Darwin OP in which the joint has this instead of that.
fn refused(joint: &str, from: &str, to: &str) -> String {
    let urdf = darwin_op_urdf();
    let (before, after) = urdf.split_once(&format!("<joint name=\"{joint}\"")).unwrap();
    assert!(after.contains(from));
    leg_of(&format!("{before}<joint name=\"{joint}\"{}", after.replacen(from, to, 1))).unwrap_err()
}

#[test]
fn the_description_of_the_darwin_op_has_the_legs_of_its_closed_form() {
    let robot = Robot::from_urdf(&darwin_op_urdf(), "darwin_op.urdf").unwrap();
    for (side, sole) in [(Side::Right, "r_sole"), (Side::Left, "l_sole")] {
        let described = Leg::of(&robot, "base_link", darwin_op::leg_joint_names(side), sole).unwrap();
        let (described, known) = (*described.geometry(), *darwin_op::leg(side).geometry());
        assert_eq!(described.signs, known.signs);
        assert!((described.hip - known.hip).length() < 1e-12);
        let lengths = |of: LegGeometry| [of.thigh, of.shank, of.foot];
        for (length, known) in lengths(described).into_iter().zip(lengths(known)) {
            assert!((length - known).abs() < 1e-12);
        }
        for (limit, known) in described.limits.as_flattened().iter().zip(known.limits.as_flattened()) {
            assert!((limit - known).abs() < 1e-9);
        }
    }
}

#[test]
fn a_leg_without_closed_form_is_refused_with_its_line_and_the_reason() {
    let axis = refused("r_knee", "<axis xyz=\"0 1 0\"/>", "<axis xyz=\"1 0 0\"/>");
    assert!(
        axis.contains("joint \"r_knee\" turns about (1.000, 0.000, 0.000) of \"base_link\" and not about y")
    );
    assert!(axis.starts_with("robot.urdf:"), "{axis}");
    let knee = refused("r_knee", "<origin xyz=\"0 0 -0.093\"/>", "<origin xyz=\"0.01 0 -0.093\"/>");
    assert!(knee.contains("the axis of the knee is 10.0 mm off"), "{knee}");
    let fixed = refused("r_ank_roll", "type=\"revolute\"", "type=\"fixed\"");
    assert!(
        fixed.contains("the joints r_hip_yaw, r_hip_roll, r_hip_pitch, r_knee, r_ank_pitch move"),
        "{fixed}"
    );
    let above = refused("r_knee", "<origin xyz=\"0 0 -0.093\"/>", "<origin xyz=\"0 0 0.093\"/>");
    assert!(above.contains("the knee is"), "{above}");
}

/// Lengths, signs and the angles of a pose.
fn legs() -> impl Strategy<Value = (Leg, [f64; 6])> {
    let lengths = [0.05..0.5_f64, 0.05..0.5, 0.0..0.1];
    let signs = proptest::array::uniform6(prop_oneof![Just(1.0), Just(-1.0)]);
    let turned = [-1.0..1.0, -0.6..0.6, -1.2..1.2, 0.01..2.2, -0.9..0.9, -0.8..0.8];
    (lengths, signs, turned).prop_map(|([thigh, shank, foot], signs, turned)| {
        let angles = std::array::from_fn(|joint| signs[joint] * turned[joint]);
        let hip = DVec3::new(0.0, 0.05, -0.01);
        let limits = [[-2.5, 2.5]; 6];
        (Leg::new(LegGeometry { hip, thigh, shank, foot, signs, limits }), angles)
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10_000))]

    #[test]
    fn legs_of_any_lengths_reach_what_their_angles_reach((leg, angles) in legs()) {
        let hip_from_sole = leg.forward(&angles);
        let solution = leg.inverse(&hip_from_sole);
        prop_assert_eq!(solution.reach, Reach::Exact);
        let reached = leg.forward(&solution.angles);
        let off = (reached.translation - hip_from_sole.translation).length();
        let turned = 2.0 * (reached.rotation * hip_from_sole.rotation.conjugate()).xyz().length();
        prop_assert!(off < 1e-8 && turned < 1e-8, "{} m, {} rad", off, turned);
    }
}
