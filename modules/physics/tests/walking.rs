//! What the Darwin OP can do in the world as described, one seed each; `cargo xtask physics` perturbs the
//! world.
#![allow(clippy::unwrap_used)]

use downbeat_executor::{Inbox, Received};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::sensor_msgs::msg::Imu;
use downbeat_physics::Variation;
use downbeat_physics::tasks::{Conditions, Failure, Task, WalkingRobot};
use glam::{DQuat, DVec3};
use std::sync::{Arc, Mutex};

fn standing() -> WalkingRobot {
    WalkingRobot::new(Conditions::described(1)).unwrap()
}

/// Does a task, to the right for even seeds, and returns how well.
fn does(task: Task, seed: u64) -> f64 {
    match task.run(Conditions::described(seed)) {
        Ok(success) => success.figure,
        Err(failure) => panic!("{task}, seed {seed}: {failure}"),
    }
}

#[test]
fn it_stands_ready_to_walk_for_a_minute() {
    does(Task::Stand, 1);
}

/// What turns it while it stands, its filter takes for the bias of its gyroscope.
#[test]
fn it_does_not_turn_while_it_stands() {
    let mut robot = standing();
    let before = robot.place().yaw;
    robot.run(10.0).unwrap();
    let turned = robot.place().yaw - before;
    assert!(turned.abs() < 0.01, "{turned} rad");
}

#[test]
fn it_walks_ten_metres_at_20_centimetres_a_second_and_stops() {
    assert!(does(Task::Walk, 1) >= 0.2);
}

#[test]
fn it_turns_by_180_degrees_on_the_spot() {
    does(Task::Turn, 1);
}

#[test]
fn it_steps_a_metre_to_each_side() {
    does(Task::SideStep, 1);
    does(Task::SideStep, 2);
}

#[test]
fn it_stops_within_half_a_metre() {
    assert!(does(Task::Stop, 1) < 0.5);
}

#[test]
fn it_walks_two_metres_backward() {
    assert!(does(Task::Backward, 1) >= 0.08);
}

#[test]
fn it_survives_a_push_of_half_a_newton_second_from_all_sides() {
    does(Task::Push, 1);
}

#[test]
fn a_push_that_is_too_strong_fails_the_task() {
    let mut robot = standing();
    robot.simulated().push("torso", [0.0, 2.0, 0.0]);
    robot.run(2.0).unwrap();
    assert!(matches!(robot.has_not_fallen(), Err(Failure::Fell { .. })));
}

#[test]
fn it_gets_up_from_its_front_and_its_back_and_walks_on() {
    does(Task::GetUpFront, 1);
    does(Task::GetUpBack, 1);
}

#[test]
fn it_gets_up_with_weak_servos() {
    for seed in 53..56 {
        let mut conditions = Conditions::perturbed(seed);
        conditions.simulation.variation.strength *= 0.8;
        let done = Task::GetUpFront.run(conditions);
        assert!(done.is_ok(), "seed {seed}: {}", done.unwrap_err());
    }
}

#[test]
fn it_kicks_a_ball_a_metre_far_with_either_foot() {
    does(Task::Kick, 1);
    does(Task::Kick, 2);
}

/// In worlds in which a trunk that does not lean falls on its back.
#[test]
fn it_kicks_out_of_the_walk_where_no_ball_is_and_walks_on() {
    for seed in [9, 12] {
        let done = Task::MissedKick.run(Conditions::perturbed(seed));
        assert!(done.is_ok(), "seed {seed}: {}", done.unwrap_err());
    }
}

#[test]
fn worlds_are_perturbed_within_their_bounds_and_alike_for_the_same_seed() {
    for seed in 0..1000 {
        let variation = Variation::of_seed(seed);
        assert!((variation.mass - 1.0).abs() <= 0.05 && (variation.friction - 1.0).abs() <= 0.25);
        assert!((variation.strength - 1.0).abs() <= 0.1 && variation.centre_of_mass.abs() <= 0.004);
        assert!(variation.latency.as_secs_f64() <= 0.004 && variation.backlash < 0.01);
        assert_eq!(variation, Variation::of_seed(seed));
    }
    assert_ne!(Variation::of_seed(1), Variation::of_seed(2));
}

#[test]
fn odometry_and_orientation_agree_with_the_world() {
    let mut robot = standing();
    let odometry = Arc::<Mutex<Odometry>>::default();
    let orientation = Arc::<Mutex<DQuat>>::default();
    let (kept, kept_orientation) = (Arc::clone(&odometry), Arc::clone(&orientation));
    let keep = move |message: Received<'_, Odometry>| *kept.lock().unwrap() = message.clone();
    robot.simulated().core().outlet("odom", Inbox::KeepAll, keep).unwrap().keep();
    let keep = move |imu: Received<'_, Imu>| {
        let q = imu.orientation;
        *kept_orientation.lock().unwrap() = DQuat::from_xyzw(q.x, q.y, q.z, q.w);
    };
    robot.simulated().core().outlet("imu/data", Inbox::KeepAll, keep).unwrap().keep();
    robot.run(0.1).unwrap();
    let (world_start, start) = (robot.place().position, odometry.lock().unwrap().pose.pose.position);
    let mut worst: f64 = 0.0;
    for _ in 0..100 {
        robot.walk_until([0.1, 0.0, 0.1], 0.2, |_| false).unwrap();
        let world_from_body = robot.simulated().snapshot().robot.world_from_body.rotation;
        let up = |rotation: DQuat| rotation.conjugate() * DVec3::Z;
        worst = worst.max(up(world_from_body).angle_between(up(*orientation.lock().unwrap())));
    }
    assert!(worst < 0.1, "the tilt of the filter is off by at most {worst} rad");
    let (world_end, end) = (robot.place().position, odometry.lock().unwrap().pose.pose.position);
    let (way, odometry_way) =
        ((world_end - world_start).truncate(), DVec3::new(end.x - start.x, end.y - start.y, 0.0).truncate());
    assert!((way - odometry_way).length() < 0.15 * way.length(), "{way} and {odometry_way}");
}
