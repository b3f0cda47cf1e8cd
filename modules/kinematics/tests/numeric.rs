//! Frames, Jacobians, centre of mass and inverse kinematics of the Darwin OP.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_kinematics::nalgebra::{Matrix3xX, Matrix6xX};
use downbeat_kinematics::{InverseKinematics, Masses, Pose, Robot, Search};
use downbeat_transforms::Isometry;
use fuzzing::{Random, most_in};
use glam::DVec3;

fn darwin_op() -> Robot {
    Robot::read("../../robots/darwin_op.urdf").unwrap()
}

fn unit(random: &mut Random) -> f64 {
    (random.bits() >> 11) as f64 / (1_u64 << 53) as f64
}

/// Positions within the limits.
fn random_positions(robot: &Robot, random: &mut Random) -> Vec<f64> {
    let ranges = robot.coordinates().iter().map(|&id| robot.joint(id).range());
    ranges.map(|range| range.start() + unit(random) * (range.end() - range.start())).collect()
}

fn difference(one: &Isometry, other: &Isometry) -> (DVec3, DVec3) {
    let turned = one.rotation * other.rotation.conjugate();
    (one.translation - other.translation, turned.xyz() * 2.0 * turned.w.signum())
}

#[test]
fn jacobians_are_the_derivatives_of_poses_and_of_the_centre_of_mass() {
    const STEP: f64 = 1e-6;
    let (robot, mut random) = (darwin_op(), Random::new(1));
    let mut masses = Masses::new(&robot).unwrap();
    let (mut before, mut after) = (Pose::new(&robot), Pose::new(&robot));
    let (mut of_link, mut of_mass) = (Matrix6xX::zeros(0), Matrix3xX::zeros(0));
    for _ in 0..20 {
        let mut positions = random_positions(&robot, &mut random);
        let mut pose = Pose::new(&robot);
        pose.update(&robot, &positions);
        masses.jacobian(&robot, &pose, &mut of_mass);
        for name in ["l_sole", "r_hand", "camera_optical_frame"] {
            let link = robot.link_id(name).unwrap();
            pose.jacobian(&robot, link, &mut of_link);
            for index in 0..positions.len() {
                let position = positions[index];
                positions[index] = position - STEP;
                before.update(&robot, &positions);
                positions[index] = position + STEP;
                after.update(&robot, &positions);
                positions[index] = position;
                let (linear, angular) = difference(&after.base_from_link(link), &before.base_from_link(link));
                let numeric = [linear, angular].map(|part| part / (2.0 * STEP));
                let mass = (masses.center_of_mass(&after) - masses.center_of_mass(&before)) / (2.0 * STEP);
                for row in 0..3 {
                    assert!((of_link[(row, index)] - numeric[0][row]).abs() < 1e-8, "{name} {index}");
                    assert!((of_link[(row + 3, index)] - numeric[1][row]).abs() < 1e-8, "{name} {index}");
                    assert!((of_mass[(row, index)] - mass[row]).abs() < 1e-8, "{index}");
                }
            }
        }
    }
}

#[test]
fn any_chain_reaches_poses_within_its_limits() {
    let (robot, mut random) = (darwin_op(), Random::new(2));
    for (base, tip) in
        [("base_link", "l_sole"), ("torso", "r_sole"), ("r_sole", "l_hand"), ("l_sole", "r_sole")]
    {
        let [base, tip] = [base, tip].map(|name| robot.link_id(name).unwrap());
        let mut chain = InverseKinematics::new(&robot, base, tip).unwrap();
        let mut pose = Pose::new(&robot);
        for _ in 0..50 {
            pose.update(&robot, &random_positions(&robot, &mut random));
            let wanted = pose.target_from_source(base, tip);
            let mut positions = random_positions(&robot, &mut random);
            let found = chain.solve(&wanted, &mut positions, &Search { starts: 100, ..Search::default() });
            assert!(found.is_reached, "{found:?}");
            pose.update(&robot, &positions);
            let (distance, angle) = difference(&pose.target_from_source(base, tip), &wanted);
            assert!(distance.length() < 1e-8 && angle.length() < 1e-7);
            for (position, &id) in positions.iter().zip(robot.coordinates()) {
                assert!(robot.joint(id).range().contains(position));
            }
        }
    }
}

#[test]
fn only_the_joints_of_the_chain_move() {
    let robot = darwin_op();
    let [torso, hand] = ["torso", "l_hand"].map(|name| robot.link_id(name).unwrap());
    let mut arm = InverseKinematics::new(&robot, torso, hand).unwrap();
    let names: Vec<&str> =
        arm.coordinates().map(|index| &*robot.joint(robot.coordinates()[index]).name).collect();
    assert_eq!(names, ["l_sho_pitch", "l_sho_roll", "l_el"]);
    let mut positions = vec![0.05; 20];
    let anywhere = Isometry::from_translation(0.1, 0.1, 0.0);
    arm.solve(&anywhere, &mut positions, &Search::default());
    assert_eq!(positions.iter().filter(|&&position| position != 0.05).count(), 3);
}

#[test]
fn a_position_can_be_reached_without_an_orientation() {
    let robot = darwin_op();
    let [torso, hand] = ["torso", "l_hand"].map(|name| robot.link_id(name).unwrap());
    let mut arm = InverseKinematics::new(&robot, torso, hand).unwrap();
    let mut pose = Pose::new(&robot);
    pose.update(&robot, &[0.4; 20]);
    let position = pose.target_from_source(torso, hand).translation;
    let in_front = Isometry { translation: position, ..Isometry::IDENTITY };
    let search = Search { angle_weight: 0.0, ..Search::default() };
    let found = arm.solve(&in_front, &mut [0.0; 20], &search);
    assert!(found.is_reached, "{found:?}");
    // The shoulder cannot roll far enough inwards. A search of all angles in steps of 2° comes as near as 8.7
    // mm.
    let across = Isometry::from_translation(0.12, 0.1, 0.02);
    let found = arm.solve(&across, &mut [0.0; 20], &search);
    assert!((found.distance - 0.00846).abs() < 1e-5, "{found:?}");
}

#[test]
fn the_nearest_pose_to_an_unreachable_one_is_found() {
    let robot = darwin_op();
    let [base, sole] = ["base_link", "r_sole"].map(|name| robot.link_id(name).unwrap());
    let mut leg = InverseKinematics::new(&robot, base, sole).unwrap();
    let mut positions = vec![0.0; 20];
    // 80.5 mm below the sole of a straight leg.
    let too_far = Isometry::from_translation(0.0, -0.037, -0.3);
    let found = leg.solve(&too_far, &mut positions, &Search::default());
    assert!(!found.is_reached);
    assert!((found.distance - 0.0805).abs() < 1e-6 && found.angle < 1e-3, "{found:?}");
    assert_eq!(found.starts, 20);
    let knee = positions[robot.coordinate("r_knee").unwrap()];
    assert!(knee.abs() < 1e-2, "{knee}");
}

#[test]
fn equal_searches_have_equal_results() {
    let robot = darwin_op();
    let [base, tip] = ["r_sole", "l_hand"].map(|name| robot.link_id(name).unwrap());
    let target = Isometry::from_translation(0.05, 0.2, 0.3);
    let run = || {
        let mut positions = vec![0.0; 20];
        let mut chain = InverseKinematics::new(&robot, base, tip).unwrap();
        let found = chain.solve(&target, &mut positions, &Search::default());
        (found, positions)
    };
    assert_eq!(run(), run());
}

#[test]
fn a_control_cycle_allocates_nothing() {
    let (robot, mut random) = (darwin_op(), Random::new(3));
    let [base, sole] = ["base_link", "l_sole"].map(|name| robot.link_id(name).unwrap());
    let mut leg = InverseKinematics::new(&robot, base, sole).unwrap();
    let mut masses = Masses::new(&robot).unwrap();
    let (mut pose, mut positions) = (Pose::new(&robot), random_positions(&robot, &mut random));
    let (mut of_link, mut of_mass) = (Matrix6xX::zeros(20), Matrix3xX::zeros(20));
    let (bytes, ()) = most_in(|| {
        pose.update(&robot, &positions);
        pose.jacobian(&robot, sole, &mut of_link);
        masses.jacobian(&robot, &pose, &mut of_mass);
        let wanted = pose.target_from_source(base, sole);
        positions.fill(0.1);
        leg.solve(&wanted, &mut positions, &Search::default());
    });
    assert_eq!(bytes, 0);
}

#[test]
fn a_chain_that_does_not_move_and_a_pose_that_is_not_finite_are_refused() {
    let robot = darwin_op();
    let [base, torso, sole] = ["base_link", "torso", "l_sole"].map(|name| robot.link_id(name).unwrap());
    let error = InverseKinematics::new(&robot, base, torso).unwrap_err().to_string();
    assert!(
        error.ends_with(
            "link \"torso\" does not move relative to \"base_link\": all joints between them are fixed"
        ),
        "{error}"
    );
    let mut leg = InverseKinematics::new(&robot, base, sole).unwrap();
    let mut positions = vec![0.25; 20];
    let found =
        leg.solve(&Isometry::from_translation(f64::NAN, 0.0, 0.0), &mut positions, &Search::default());
    assert!(!found.is_reached && found.distance.is_infinite());
    assert_eq!(positions, [0.25; 20]);
}

#[test]
fn a_joint_that_follows_another_moves_with_it() {
    let urdf = r#"<robot name="gripper">
      <link name="palm"/>
      <joint name="left" type="prismatic"><parent link="palm"/><child link="left"/><axis xyz="0 1 0"/>
        <limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>
      <link name="left"/>
      <joint name="right" type="prismatic"><parent link="palm"/><child link="right"/><axis xyz="0 1 0"/>
        <limit lower="-0.05" upper="0" effort="1" velocity="1"/><mimic joint="left" multiplier="-1"/></joint>
      <link name="right"/>
    </robot>"#;
    let robot = Robot::from_urdf(urdf, "gripper.urdf").unwrap();
    let [left, right] = ["left", "right"].map(|name| robot.link_id(name).unwrap());
    let mut pose = Pose::new(&robot);
    pose.update(&robot, &[0.03]);
    assert_eq!(pose.target_from_source(right, left).translation.y, 0.06);
    let mut chain = InverseKinematics::new(&robot, right, left).unwrap();
    let mut positions = [0.0];
    let search = Search { angle_weight: 0.0, ..Search::default() };
    assert!(chain.solve(&Isometry::from_translation(0.0, 0.08, 0.0), &mut positions, &search).is_reached);
    assert!((positions[0] - 0.04).abs() < 1e-8);
    let too_wide = chain.solve(&Isometry::from_translation(0.0, 0.16, 0.0), &mut positions, &search);
    assert!(!too_wide.is_reached && (positions[0] - 0.05).abs() < 1e-12, "the right finger is at its limit");
}
