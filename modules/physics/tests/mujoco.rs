//! MuJoCo as a second opinion. Tests are skipped, with a message, where its library is missing
//! (`cargo xtask test` installs it).
#![cfg(feature = "mujoco")]
#![allow(clippy::unwrap_used)]

use downbeat_physics::tasks::{Conditions, Task, WalkingRobot};
use downbeat_physics::{
    Ball, Engine, EngineError, Request, SimulatedRobot, Simulation, SimulationError, SimulationOptions,
    Variation,
};
use glam::DVec3;
use std::time::Duration;

const SECOND: Duration = Duration::from_secs(1);

/// A Darwin OP in MuJoCo; `None` without its library.
fn options() -> Option<SimulationOptions> {
    let options = SimulationOptions { engine: Engine::Mujoco, ..SimulationOptions::darwin_op() };
    match Simulation::new(options.clone()) {
        Ok(_) => Some(options),
        Err(SimulationError::Engine(error @ EngineError::NoLibrary { .. })) => {
            test_machine::missing("the library of MuJoCo", &error.to_string());
            None
        }
        Err(error) => panic!("{error}"),
    }
}

#[test]
fn both_engines_agree_on_the_walk() {
    let Some(options) = options() else { return };
    let walk = |engine| {
        let simulation = SimulationOptions { engine, ..options.clone() };
        let mut robot = WalkingRobot::new(Conditions { simulation, ..Conditions::described(1) }).unwrap();
        let start = robot.place().position;
        robot.walk_until([0.1, 0.0, 0.0], 20.0, |_| false).unwrap();
        robot.place().position - start
    };
    let [rapier, mujoco] = [Engine::Rapier, Engine::Mujoco].map(walk);
    assert!((rapier.x - mujoco.x).abs() < 0.3 * rapier.x, "{rapier} and {mujoco} m");
    assert!(rapier.x > 1.5 && mujoco.y.abs() < 0.3, "{rapier} and {mujoco} m");
}

#[test]
fn both_engines_agree_that_it_stands_and_stays_on_its_feet_when_it_is_pushed() {
    let Some(options) = options() else { return };
    for task in [Task::Stand, Task::Push] {
        task.run(Conditions { simulation: options.clone(), ..Conditions::described(1) }).unwrap();
    }
}

#[test]
fn it_gets_up_in_this_engine_too() {
    let Some(options) = options() else { return };
    for task in [Task::GetUpFront, Task::GetUpBack] {
        let done = task.run(Conditions { simulation: options.clone(), ..Conditions::described(1) });
        assert_eq!(done.unwrap().attempts, 1, "{task}");
    }
}

#[test]
fn a_push_throws_it_over_and_it_lies_on_its_shapes() {
    let Some(options) = options() else { return };
    let mut robot = SimulatedRobot::new(options, 1).unwrap();
    robot.run_for(2 * SECOND).unwrap();
    robot.push("torso", [0.0, 2.0, 0.0]);
    robot.run_for(2 * SECOND).unwrap();
    let height = robot.snapshot().robot.world_from_body.translation.z;
    assert!(!robot.is_upright() && (0.02..0.15).contains(&height), "{height}");
}

#[test]
fn the_same_run_gives_the_same_bits() {
    let Some(options) = options() else { return };
    let run = |variation| {
        let mut robot = SimulatedRobot::new(SimulationOptions { variation, ..options.clone() }, 1).unwrap();
        robot.run_for(2 * SECOND).unwrap();
        robot.simulation().hash()
    };
    assert_eq!(run(Variation::default()), run(Variation::default()));
    assert_ne!(run(Variation::default()), run(Variation::of_seed(1)));
}

#[test]
fn a_ball_rolls_and_stops() {
    let Some(mut options) = options() else { return };
    options.world.ball = Some(Ball::default());
    let mut robot = SimulatedRobot::new(options, 1).unwrap();
    robot.run_for(SECOND).unwrap();
    let ball = |robot: &SimulatedRobot| robot.snapshot().things[0].2;
    let mut motion = ball(&robot);
    assert!((motion.world_from_body.translation - DVec3::new(0.5, 0.0, 0.05)).length() < 1e-3, "{motion:?}");
    motion.linear = DVec3::new(1.0, 0.0, 0.0);
    robot.simulation().request(Request::SetMotion { thing: Some("ball".into()), motion });
    robot.run_for(SECOND).unwrap();
    let rolling = ball(&robot);
    assert!(rolling.world_from_body.translation.x > 1.0 && rolling.angular.y > 1.0, "{rolling:?}");
    robot.run_for(4 * SECOND).unwrap();
    let stopped = ball(&robot);
    assert!(stopped.linear.length() < 1e-2 && stopped.world_from_body.translation.x < 2.5, "{stopped:?}");
}

#[test]
fn a_robot_that_starts_in_a_box_is_refused() {
    let Some(mut options) = options() else { return };
    let boxes = "[[box]]\nname = \"table\"\nposition = [0, 0, 0.2]\nsize = [0.2, 0.2, 0.2]";
    options.world = downbeat_physics::WorldFile::parse(boxes, "world.toml").unwrap();
    let error = Simulation::new(options).err().unwrap().to_string();
    assert!(error.contains("inside \"table\" of the world \"world\""), "{error}");
}
