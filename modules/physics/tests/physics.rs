//! A Darwin OP in a world, with the module that drives a real one.
#![allow(clippy::unwrap_used)]

use downbeat_darwin_op::stand_nod_wave::StandNodWave;
use downbeat_executor::{Inbox, ModuleOptions, Received};
use downbeat_kinematics::Robot;
use downbeat_msgs::sensor_msgs::msg::{Imu, JointState};
use downbeat_msgs::std_msgs::msg::Float64MultiArray;
use downbeat_physics::{
    Ball, Model, Posture, SimulatedRobot, SimulationError, SimulationOptions, Start, Variation, WorldFile,
};
use glam::DVec3;
use std::sync::{Arc, Mutex};
use std::time::Duration;

const SECOND: Duration = Duration::from_secs(1);

fn robot() -> SimulatedRobot {
    SimulatedRobot::new(SimulationOptions::darwin_op(), 1).unwrap()
}

/// The last message of a topic.
fn last<T: Clone + Send + Sync + 'static>(robot: &mut SimulatedRobot, topic: &str) -> Arc<Mutex<Option<T>>> {
    let kept = Arc::<Mutex<Option<T>>>::default();
    let keeper = Arc::clone(&kept);
    let keep = move |message: Received<'_, T>| *keeper.lock().unwrap() = Some(message.clone());
    robot.core().outlet(topic, Inbox::KeepAll, keep).unwrap().keep();
    kept
}

fn take<T>(kept: &Mutex<Option<T>>) -> T {
    kept.lock().unwrap().take().expect("a message")
}

#[test]
fn it_stands_for_a_minute() {
    let mut robot = robot();
    robot.run_for(SECOND).unwrap();
    let start = robot.snapshot().robot.world_from_body;
    robot.run_for(60 * SECOND).unwrap();
    let moved = robot.snapshot().robot.world_from_body;
    // Resting contacts creep by about half a millimetre per second in steps of 4 ms.
    assert!((moved.translation - start.translation).length() < 0.05, "{start:?} {moved:?}");
    assert!(robot.is_upright());
    let forces = robot.snapshot().foot_forces.unwrap();
    let weight: f64 = forces.left.iter().chain(&forces.right).sum();
    assert!((weight / 9.806_65 - 2.925).abs() < 0.15, "{weight} N on {forces:?}");
}

#[test]
fn the_feet_measure_the_weight() {
    let mut robot = robot();
    let settings = [("foot_sensors".to_owned(), true.into())].into();
    robot.add_hardware(ModuleOptions { settings, ..ModuleOptions::default() }).unwrap();
    let feet =
        ["foot_pressure/right", "foot_pressure/left"].map(|foot| last::<Float64MultiArray>(&mut robot, foot));
    robot.run_for(3 * SECOND).unwrap();
    let feet = feet.map(|foot| take(&foot).data);
    let weight: f64 = feet.iter().flat_map(|foot| &foot[..4]).sum();
    // A corner with less than half a newton measures nothing.
    assert!((weight / 9.806_65 - 2.925).abs() < 0.5, "{weight} N on {feet:?}");
    assert!(feet.iter().all(|foot| foot[4..].iter().all(|centre| centre.abs() <= 1.01)), "{feet:?}");
}

#[test]
fn the_hardware_module_measures_the_stand() {
    let mut robot = robot();
    robot.add_hardware(ModuleOptions::default()).unwrap();
    let (joints, imu) =
        (last::<JointState>(&mut robot, "joint_states"), last::<Imu>(&mut robot, "imu/data_raw"));
    robot.run_for(3 * SECOND).unwrap();
    let (joints, imu) = (take(&joints), take(&imu));
    let knee = joints.name.iter().position(|name| name == "r_knee").unwrap();
    // The ready stand has 53 degrees, and the servo is soft.
    assert!((0.85..1.1).contains(&joints.position[knee]), "{}", joints.position[knee]);
    assert!(joints.effort[knee].abs() > 0.02, "it carries the robot: {}", joints.effort[knee]);
    let force = imu.linear_acceleration;
    let size = (force.x * force.x + force.y * force.y + force.z * force.z).sqrt();
    assert!((size - 9.81).abs() < 0.4 && force.x < -1.0, "it leans forward: {force:?}");
}

#[test]
fn it_follows_a_motion() {
    let mut robot = robot();
    robot.hardware_listens_to("motion/joint_commands").unwrap();
    robot.add("motion", StandNodWave::default()).unwrap();
    robot.run_for(20 * SECOND).unwrap();
    assert!(robot.is_upright());
}

#[test]
fn a_push_throws_it_over() {
    let mut robot = robot();
    robot.run_for(2 * SECOND).unwrap();
    robot.push("torso", [0.0, 2.0, 0.0]);
    robot.run_for(2 * SECOND).unwrap();
    assert!(!robot.is_upright());
    let height = robot.snapshot().robot.world_from_body.translation.z;
    assert!((0.02..0.15).contains(&height), "it lies on its shapes: {height}");
}

#[test]
fn without_torque_it_collapses() {
    let mut robot = robot();
    robot.run_for(2 * SECOND).unwrap();
    let standing = robot.snapshot().robot.world_from_body.translation.z;
    for id in 1..=20 {
        let fault = format!("dead-servo:{id}").parse().unwrap();
        robot.emulator().inject(fault);
    }
    robot.run_for(2 * SECOND).unwrap();
    assert!(robot.snapshot().robot.world_from_body.translation.z < standing - 0.05);
}

#[test]
fn two_worlds_of_one_process_are_equal_bit_for_bit() {
    let run = |seed, variation| {
        let mut options = SimulationOptions { variation, ..SimulationOptions::darwin_op() };
        options.world.ball = Some(Ball { position: [0.07, 0.3], ..Ball::default() });
        let mut robot = SimulatedRobot::new(options, seed).unwrap();
        robot.run_for(SECOND).unwrap();
        robot.push("torso", [0.0, 2.0, 0.0]);
        let mut hashes = Vec::new();
        for _ in 0..40 {
            robot.run_for(SECOND / 20).unwrap();
            hashes.push(robot.simulation().hash());
        }
        hashes
    };
    let plain = run(1, Variation::default());
    assert_eq!(plain, run(1, Variation::default()));
    assert_ne!(plain, run(1, Variation { friction: 0.9, ..Variation::default() }));
}

#[test]
fn a_ball_rolls_and_stops() {
    let mut options = SimulationOptions::darwin_op();
    options.world.ball = Some(Ball::default());
    let mut robot = SimulatedRobot::new(options, 1).unwrap();
    robot.run_for(SECOND).unwrap();
    let ball = |robot: &SimulatedRobot| robot.snapshot().things[0].2;
    let mut motion = ball(&robot);
    assert!((motion.world_from_body.translation - DVec3::new(0.5, 0.0, 0.05)).length() < 1e-3, "{motion:?}");
    motion.linear = DVec3::new(1.0, 0.0, 0.0);
    robot.simulation().request(downbeat_physics::Request::SetMotion { thing: Some("ball".into()), motion });
    robot.run_for(SECOND).unwrap();
    let rolling = ball(&robot);
    assert!(rolling.world_from_body.translation.x > 1.0 && rolling.angular.y > 1.0, "{rolling:?}");
    robot.run_for(4 * SECOND).unwrap();
    let stopped = ball(&robot);
    assert!(stopped.linear.length() < 1e-3 && stopped.world_from_body.translation.x < 2.5, "{stopped:?}");
}

#[test]
fn a_fallen_robot_can_be_where_it_starts() {
    for (posture, forward) in [(Posture::Prone, -9.8), (Posture::Supine, 9.8)] {
        let start = Start { posture, angles: Vec::new(), ..Start::walking_ready() };
        let options = SimulationOptions { start, ..SimulationOptions::darwin_op() };
        let mut robot = SimulatedRobot::new(options, 1).unwrap();
        robot.add_hardware(ModuleOptions::default()).unwrap();
        let imu = last::<Imu>(&mut robot, "imu/data_raw");
        robot.run_for(2 * SECOND).unwrap();
        let force = take(&imu).linear_acceleration;
        assert!((force.x - forward).abs() < 2.0, "{posture:?}: {force:?}");
    }
}

#[test]
fn a_robot_that_starts_in_a_box_is_refused() {
    let boxes = "[[box]]\nname = \"table\"\nposition = [0, 0, 0.2]\nsize = [0.2, 0.2, 0.2]";
    let world = WorldFile::parse(boxes, "world.toml").unwrap();
    let refused = SimulatedRobot::new(SimulationOptions { world, ..SimulationOptions::darwin_op() }, 1);
    let error = refused.err().unwrap().to_string();
    assert!(error.contains("inside \"table\" of the world \"world\""), "{error}");
}

#[test]
fn a_robot_without_a_servos_joint_is_refused() {
    let urdf = downbeat_physics::DARWIN_OP.replace("\"head_tilt\"", "\"nod\"");
    let model = Model::new(&Robot::from_urdf(&urdf, "darwin_op.urdf").unwrap()).unwrap();
    let options = SimulationOptions { model, ..SimulationOptions::darwin_op() };
    let Err(error) = SimulatedRobot::new(options, 1) else { panic!("it was accepted") };
    assert!(matches!(&error, SimulationError::Joint { joint, .. } if joint == "head_tilt"), "{error}");
}
