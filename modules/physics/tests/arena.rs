//! Robots that share a world.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_darwin_op::gait::Gait;
use downbeat_darwin_op::hardware::DarwinOp;
use downbeat_executor::{Core, Inbox, ManualClock, ModuleOptions, Received, Time};
use downbeat_imu_filter::ImuFilter;
use downbeat_msgs::geometry_msgs::msg::Twist;
use downbeat_msgs::sensor_msgs::msg::Imu;
use downbeat_physics::{Arena, ArenaOptions, ArenaRobot, Ball, Posture};
use downbeat_servos::joint_command_mux::JointCommandMux;
use glam::{DQuat, DVec2, DVec3};
use parking_lot::Mutex;
use std::sync::Arc;
use std::time::Duration;

const START: Time = Time::from_nanos(1_000_000_000);
const CYCLE: Duration = Duration::from_millis(8);

/// A core with the modules of a walking robot.
fn walker(arena: &Arena, robot: usize, clock: &ManualClock) -> Core {
    let mut core = Core::new().with_clock(clock.clone());
    let mut hardware = ModuleOptions::default();
    hardware.remaps.insert("joint_commands".into(), "joint_goals".into());
    let bus = Box::new(arena.emulators()[robot].bus());
    core.add_with("hardware", DarwinOp::new(bus), hardware).unwrap();
    core.add("imu_filter", ImuFilter::default()).unwrap();
    let mut gait = ModuleOptions::default();
    gait.settings.insert("start".into(), true.into());
    core.add_with("gait", Gait::default(), gait).unwrap();
    core.add("mux", JointCommandMux::default()).unwrap();
    core
}

/// Robots that face each other with a ball between them walk towards it. Their cores run in this order.
fn meet(order: [usize; 2], seconds: u64) -> Arena {
    let mut options = ArenaOptions::darwin_op(["left", "right"].map(ArenaRobot::named));
    options.robots[0].start.position = [-0.35, 0.0];
    options.robots[1].start.position = [0.35, 0.0];
    options.robots[1].start.yaw = std::f64::consts::PI;
    options.world.ball = Some(Ball { position: [0.0, 0.0], ..Ball::default() });
    let arena = Arena::new(options).unwrap();
    let clock = ManualClock::new(START);
    let mut cores: Vec<Core> = (0..2).map(|robot| walker(&arena, robot, &clock)).collect();
    let inlets: Vec<_> = cores.iter_mut().map(|core| core.inlet::<Twist>("cmd_vel").unwrap()).collect();
    let mut twist = Twist::default();
    twist.linear.x = 0.1;
    let mut now = START;
    while now < START + Duration::from_secs(seconds) {
        clock.set(now);
        arena.advance_to(now);
        for robot in order {
            inlets[robot].publish(twist).unwrap();
            while cores[robot].next_event().is_some_and(|next| next <= now) {
                cores[robot].cycle().unwrap();
            }
        }
        now = now + CYCLE;
    }
    arena
}

#[test]
fn robots_touch_ball_and_each_other_and_the_order_of_their_cores_does_not_matter() {
    let (one, other) = (meet([0, 1], 8), meet([1, 0], 8));
    assert_eq!(one.snapshot(), other.snapshot());
    assert_eq!(one.hash(), other.hash());
    // Before they meet, for who falls may lie behind its start.
    let before = meet([0, 1], 4).snapshot();
    let x = |robot: usize| before.robots[robot].root.world_from_body.translation.x;
    assert!(x(0) > -0.33 && x(1) < 0.33, "both have walked: {} {}", x(0), x(1));
    let found = one.snapshot();
    assert!(found.last_touch.is_some());
    let apart = (found.robots[1].root.world_from_body.translation
        - found.robots[0].root.world_from_body.translation)
        .length();
    assert!(apart > 0.06, "they are not inside each other: {apart}");
}

#[test]
fn ball_and_robots_are_put_where_the_referee_says() {
    let arena = meet([0, 1], 3);
    arena.place_ball([2.0, 1.0]);
    arena.place_robot(1, [0.0, 3.0], 1.0);
    arena.advance_to(START + Duration::from_secs(3) + Duration::from_millis(40));
    let found = arena.snapshot();
    let ball = found.ball.unwrap().world_from_body.translation;
    assert!((ball.truncate() - DVec2::new(2.0, 1.0)).length() < 0.01, "{ball}");
    let placed = found.robots[1].root.world_from_body;
    assert!((placed.translation.truncate() - DVec2::new(0.0, 3.0)).length() < 0.1, "{placed:?}");
    assert!((placed.rotation * DVec3::Z).z > 0.9, "it stands");
    assert_eq!(found.last_touch, None);
}

#[test]
fn a_robot_that_lay_and_is_put_on_its_feet_feels_upright() {
    let mut options = ArenaOptions::darwin_op([ArenaRobot::named("fallen")]);
    options.robots[0].start.posture = Posture::Prone;
    let arena = Arena::new(options).unwrap();
    let clock = ManualClock::new(START);
    let mut core = walker(&arena, 0, &clock);
    let felt = Arc::new(Mutex::new(DQuat::IDENTITY));
    let take = {
        let felt = felt.clone();
        move |imu: Received<'_, Imu>| {
            let q = &imu.orientation;
            *felt.lock() = DQuat::from_xyzw(q.x, q.y, q.z, q.w);
        }
    };
    core.outlet("imu/data", Inbox::KeepAll, take).unwrap().keep();
    let mut now = START;
    let mut tilt_after = |seconds: u64| {
        let end = now + Duration::from_secs(seconds);
        while now < end {
            clock.set(now);
            arena.advance_to(now);
            while core.next_event().is_some_and(|next| next <= now) {
                core.cycle().unwrap();
            }
            now = now + CYCLE;
        }
        libm::acos((*felt.lock() * DVec3::Z).z)
    };
    let lying = tilt_after(3);
    assert!(lying > 1.2, "{lying}");
    arena.place_robot(0, [0.0, 1.0], 2.0);
    let standing = tilt_after(1);
    assert!(standing < 0.4, "it leans as in the stand: {standing}");
}

/// A robot at a port at which nobody is, and the folder of the port.
fn abandoned() -> (Arena, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let mut robot = ArenaRobot::named("abandoned");
    robot.link = Some(folder.path().join("port"));
    (Arena::new(ArenaOptions::darwin_op([robot])).unwrap(), folder)
}

#[test]
fn a_world_in_real_time_that_comes_late_stands_still_instead_of_hurrying() {
    let (arena, _folder) = abandoned();
    arena.advance_to(START);
    arena.advance_to(START + Duration::from_millis(90));
    assert_eq!(arena.left_out(), Duration::ZERO);
    arena.advance_to(START + Duration::from_millis(5_090));
    assert_eq!(arena.left_out(), Duration::from_millis(4_900));
}

#[test]
fn a_world_in_real_time_does_not_wait_for_ever_for_a_robot_that_never_comes() {
    let (arena, _folder) = abandoned();
    let mut now = START;
    let mut advance = |seconds: u64| {
        for _ in 0..seconds * 20 {
            now = now + Duration::from_millis(50);
            arena.advance_to(now);
        }
        arena.snapshot().elapsed
    };
    assert_eq!(advance(29), Duration::ZERO);
    assert!(advance(3) > Duration::from_secs(1));
}
