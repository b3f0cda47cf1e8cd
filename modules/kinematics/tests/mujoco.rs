//! The description of the Darwin OP and what is computed from it, compared with MuJoCo.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_kinematics::darwin_op;
use downbeat_kinematics::leg::{Reach, Side};
use downbeat_kinematics::{InverseKinematics, Masses, Pose, Robot, Root, Search, to_mjcf};
use downbeat_transforms::Isometry;
use fuzzing::Random;
use glam::{DQuat, DVec3};
use python_peer::Python;
use serde_json::{Value, json};

fn darwin_op() -> Robot {
    Robot::read("../../robots/darwin_op.urdf").unwrap()
}

/// What MuJoCo says about the robot, in a model in MJCF or URDF, at these positions; `None` without Python.
fn mujoco(robot: &Robot, model: &str, poses: &[Vec<f64>]) -> Option<Value> {
    let joints: Vec<&str> = robot.coordinates().iter().map(|&id| &*robot.joint(id).name).collect();
    let asked = json!({"model": model, "joints": joints, "poses": poses});
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/mujoco_peer.py");
    Some(serde_json::from_str(&Python::find()?.ask(script, "pose", &asked.to_string())).unwrap())
}

fn numbers<const N: usize>(value: &Value) -> [f64; N] {
    let numbers: Vec<f64> = value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect();
    numbers.try_into().unwrap()
}

fn isometry(value: &Value) -> Isometry {
    let [x, y, z, qx, qy, qz, qw] = numbers(value);
    Isometry { translation: DVec3::new(x, y, z), rotation: DQuat::from_xyzw(qx, qy, qz, qw) }
}

/// The greater of the distance in m and twice the sine of half the angle.
fn difference(one: &Isometry, other: &Isometry) -> f64 {
    let turned = one.rotation * other.rotation.conjugate();
    (one.translation - other.translation).length().max(2.0 * turned.xyz().length())
}

fn random_positions(robot: &Robot, random: &mut Random) -> Vec<f64> {
    let unit = |random: &mut Random| (random.bits() >> 11) as f64 / (1_u64 << 53) as f64;
    let ranges = robot.coordinates().iter().map(|&id| robot.joint(id).range());
    ranges.map(|range| range.start() + unit(random) * (range.end() - range.start())).collect()
}

#[test]
fn frames_masses_and_shapes_agree_with_mujoco() {
    let (robot, mut random) = (darwin_op(), Random::new(4));
    let poses: Vec<Vec<f64>> = (0..1000).map(|_| random_positions(&robot, &mut random)).collect();
    // What MuJoCo reads from the URDF does not depend on how we read it.
    let options =
        "<robot name=\"darwin_op\"><mujoco><compiler fusestatic=\"false\" discardvisual=\"true\"/></mujoco>";
    let urdf = std::fs::read_to_string(robot.file()).unwrap().replace("<robot name=\"darwin_op\">", options);
    for model in [to_mjcf(&robot, Root::Fixed).unwrap(), urdf] {
        let Some(theirs) = mujoco(&robot, &model, &poses) else { return };
        compare(&robot, &poses, &theirs);
    }
}

fn compare(robot: &Robot, poses: &[Vec<f64>], theirs: &Value) {
    let masses = Masses::new(robot).unwrap();
    assert!((theirs["mass"].as_f64().unwrap() - masses.total()).abs() < 1e-12);
    assert!((masses.total() - 2.925).abs() < 5e-4);
    assert_eq!(theirs["contacts"], json!([]), "shapes of neighbours touch");
    let mut pose = Pose::new(robot);
    let (mut of_frames, mut of_mass) = (0.0_f64, 0.0_f64);
    for (positions, theirs) in poses.iter().zip(theirs["poses"].as_array().unwrap()) {
        pose.update(robot, positions);
        for link in robot.links() {
            let base_from_link = pose.base_from_link(robot.link_id(&link.name).unwrap());
            of_frames = of_frames.max(difference(&base_from_link, &isometry(&theirs["frames"][&link.name])));
        }
        let center_of_mass = DVec3::from_array(numbers(&theirs["center_of_mass"]));
        of_mass = of_mass.max((masses.center_of_mass(&pose) - center_of_mass).length());
    }
    assert!(of_frames < 1e-12, "frames differ by {of_frames}");
    assert!(of_mass < 1e-12, "centres of mass differ by {of_mass} m");
}

#[test]
fn solutions_of_inverse_kinematics_reach_their_targets_in_mujoco() {
    let (robot, mut random) = (darwin_op(), Random::new(5));
    let base = robot.link_id("base_link").unwrap();
    let mut pose = Pose::new(&robot);
    let mut wanted = Vec::new();
    let mut solutions = Vec::new();
    for (name, side) in [("l_sole", Side::Left), ("r_sole", Side::Right)] {
        let (sole, leg) = (robot.link_id(name).unwrap(), darwin_op::leg(side));
        let mut numeric = InverseKinematics::new(&robot, base, sole).unwrap();
        for _ in 0..200 {
            pose.update(&robot, &random_positions(&robot, &mut random));
            let base_from_sole = pose.base_from_link(sole);

            let solution = leg.inverse(&(leg.base_from_hip().inverse() * base_from_sole));
            assert_eq!(solution.reach, Reach::Exact);
            let mut positions = vec![0.0; 20];
            for (joint, angle) in darwin_op::leg_joint_names(side).into_iter().zip(solution.angles) {
                positions[robot.coordinate(joint).unwrap()] = angle;
            }
            solutions.push(positions);
            wanted.push((name, base_from_sole, 1e-9));

            let mut positions = vec![0.0; 20];
            let search = Search { starts: 100, ..Search::default() };
            let found = numeric.solve(&base_from_sole, &mut positions, &search);
            assert!(found.is_reached, "{found:?}");
            solutions.push(positions);
            wanted.push((name, base_from_sole, 1.1e-7));
        }
    }
    let Some(theirs) = mujoco(&robot, &to_mjcf(&robot, Root::Fixed).unwrap(), &solutions) else { return };
    for ((name, wanted, tolerance), theirs) in wanted.iter().zip(theirs["poses"].as_array().unwrap()) {
        assert!(difference(wanted, &isometry(&theirs["frames"][*name])) < *tolerance);
    }
}

#[test]
fn the_mjcf_of_the_darwin_op_is_up_to_date() {
    let file = "../../robots/darwin_op.xml";
    let mjcf = to_mjcf(&darwin_op(), Root::Free).unwrap();
    if std::env::var_os("DOWNBEAT_UPDATE").is_some() {
        std::fs::write(file, &mjcf).unwrap();
    }
    assert!(
        std::fs::read_to_string(file).is_ok_and(|written| written == mjcf),
        "run `cargo run -- description mjcf robots/darwin_op.urdf > robots/darwin_op.xml`"
    );
}

#[test]
fn what_urdf_has_is_in_the_mjcf() {
    let urdf = r#"<robot name="a &amp; b">
      <link name="palm"/>
      <joint name="left" type="prismatic"><parent link="palm"/><child link="left"/><axis xyz="0 1 0"/>
        <limit lower="0" upper="0.1" effort="3" velocity="1"/><dynamics damping="2" friction="1"/></joint>
      <link name="left">
        <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>
        <visual><geometry><mesh filename="package://hand/finger.stl" scale="1 1 2"/></geometry></visual>
        <collision><geometry><cylinder radius="0.01" length="0.1"/></geometry></collision>
      </link>
      <joint name="wheel" type="continuous"><parent link="palm"/><child link="wheel"/>
        <mimic joint="left" multiplier="-2" offset="0.5"/></joint>
      <link name="wheel"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>
    </robot>"#;
    let robot = Robot::from_urdf(urdf, "hand.urdf").unwrap();
    let mjcf = to_mjcf(&robot, Root::Fixed).unwrap();
    for part in [
        "<mujoco model=\"a &amp; b\">",
        "<mesh name=\"package://hand/finger.stl\" file=\"hand/finger.stl\" scale=\"1 1 2\"/>",
        "<joint name=\"left\" type=\"slide\" axis=\"0 1 0\" limited=\"true\" range=\"0 0.1\" damping=\"2\" frictionloss=\"1\"/>",
        "<joint name=\"wheel\" type=\"hinge\" axis=\"1 0 0\"/>",
        "<geom type=\"cylinder\" size=\"0.01 0.05\" group=\"3\"/>",
        "<joint joint1=\"wheel\" joint2=\"left\" polycoef=\"0.5 -2 0 0 0\"/>",
        "<motor name=\"left\" joint=\"left\" ctrllimited=\"true\" ctrlrange=\"-3 3\"/>",
    ] {
        assert!(mjcf.contains(part), "{part} in {mjcf}");
    }
    assert!(!mjcf.contains("freejoint"));
}
