//! The gait, the motions and the falls of a Darwin OP in a world, one seed each.
#![allow(clippy::unwrap_used)]

use downbeat_executor::{Inbox, Inlet, ModuleOptions, Received};
use downbeat_modules::falls::Falls;
use downbeat_modules::gait::Gait;
use downbeat_modules::imu_filter::ImuFilter;
use downbeat_modules::joint_command_mux::JointCommandMux;
use downbeat_modules::motions::MotionPlayer;
use downbeat_msgs::geometry_msgs::msg::Twist;
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::sensor_msgs::msg::Imu;
use downbeat_msgs::std_msgs::msg::String as Text;
use downbeat_physics::{Ball, Posture, SimulatedRobot, SimulationOptions};
use glam::{DQuat, DVec3};
use std::sync::{Arc, Mutex};
use std::time::Duration;

struct Robot {
    robot: SimulatedRobot,
    cmd_vel: Inlet<Twist>,
    play: Inlet<Text>,
    states: Arc<Mutex<Vec<String>>>,
}

/// Where the robot is: position in m and yaw in rad.
#[derive(Clone, Copy)]
struct Place {
    position: DVec3,
    yaw: f64,
}

impl Robot {
    /// A robot with the modules of `robots/darwin_op_walks.toml`, ready to walk.
    fn new(options: SimulationOptions) -> Self {
        let mut robot = SimulatedRobot::new(options, 1).unwrap();
        robot.hardware_listens_to("joint_goals").unwrap();
        robot.add("imu_filter", ImuFilter::default()).unwrap();
        let settings = [("start".to_owned(), true.into())].into();
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        robot.core().add_with("gait", Gait::default(), options).unwrap();
        robot.add("motions", MotionPlayer::default()).unwrap();
        robot.add("falls", Falls::default()).unwrap();
        robot.add("mux", JointCommandMux::default()).unwrap();
        let cmd_vel = robot.core().inlet("cmd_vel").unwrap();
        let play = robot.core().inlet("motions/play").unwrap();
        let states = Arc::<Mutex<Vec<String>>>::default();
        let collected = Arc::clone(&states);
        let collect = move |state: Received<'_, Text>| {
            let mut states = collected.lock().unwrap();
            if states.last() != Some(&state.data) {
                states.push(state.data.clone());
            }
        };
        robot.core().outlet("robot_state", Inbox::KeepAll, collect).unwrap().keep();
        let mut robot = Self { robot, cmd_vel, play, states };
        robot.run(2.0);
        robot
    }

    fn standing() -> Self {
        Self::new(SimulationOptions::darwin_op())
    }

    fn run(&mut self, seconds: f64) {
        self.robot.run_for(Duration::from_secs_f64(seconds)).unwrap();
    }

    /// Commands a velocity until a condition holds, at most for some seconds of simulated time, and returns how
    /// long that took.
    fn walk_until(&mut self, velocity: [f64; 3], at_most: f64, is_there: impl Fn(Place) -> bool) -> f64 {
        let mut time = 0.0;
        while time < at_most && !is_there(self.place()) {
            let mut twist = Twist::default();
            [twist.linear.x, twist.linear.y, twist.angular.z] = velocity;
            self.cmd_vel.publish(twist).unwrap();
            self.run(0.1);
            time += 0.1;
        }
        time
    }

    fn play(&mut self, motion: &str, seconds: f64) {
        self.play.publish(Text { data: motion.to_owned() }).unwrap();
        self.run(seconds);
    }

    fn place(&self) -> Place {
        let pose = self.robot.snapshot().robot.world_from_body;
        let ahead = pose.rotation * DVec3::X;
        Place { position: pose.translation, yaw: ahead.y.atan2(ahead.x) }
    }

    /// Asserts that it stands without having fallen, and does not move.
    fn assert_stands(&mut self) {
        let before = self.place().position;
        self.run(1.0);
        assert!((self.place().position - before).length() < 0.01, "it does not move");
        assert!(self.robot.is_upright());
        assert_eq!(*self.states.lock().unwrap(), ["upright"]);
    }
}

#[test]
fn it_walks_three_metres_at_8_centimetres_a_second_and_stops() {
    let mut robot = Robot::standing();
    let start = robot.place().position;
    let time = robot.walk_until([0.12, 0.0, 0.0], 37.5, |place| place.position.x - start.x >= 3.0);
    let there = robot.place();
    assert!(there.position.x - start.x >= 3.0, "{:?} after {time} s", there.position);
    assert!(there.position.y.abs() < 0.3 && there.yaw.abs() < 0.2, "{:?} {}", there.position, there.yaw);
    robot.run(4.0);
    robot.assert_stands();
}

#[test]
fn it_turns_by_180_degrees_on_the_spot() {
    let mut robot = Robot::standing();
    let time = robot.walk_until([0.0, 0.0, 0.6], 10.0, |place| place.yaw < -0.1 || place.yaw > 3.1);
    assert!(time < 10.0);
    assert!(robot.place().position.truncate().length() < 0.2, "{:?}", robot.place().position);
    robot.run(3.0);
    robot.assert_stands();
}

#[test]
fn it_steps_a_metre_to_each_side() {
    for side in [1.0, -1.0] {
        let mut robot = Robot::standing();
        let time = robot.walk_until([0.0, 0.05 * side, 0.0], 60.0, |place| place.position.y * side >= 1.0);
        assert!(time < 60.0, "{:?}", robot.place().position);
        robot.run(3.0);
        robot.assert_stands();
    }
}

#[test]
fn it_walks_backward() {
    let mut robot = Robot::standing();
    let time = robot.walk_until([-0.06, 0.0, 0.0], 20.0, |place| place.position.x < -0.5);
    assert!(time < 20.0, "{:?}", robot.place().position);
    robot.run(3.0);
    robot.assert_stands();
}

#[test]
fn it_survives_a_push_of_half_a_newton_second_from_all_sides() {
    for impulse in [[0.5, 0.0, 0.0], [-0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, -0.5, 0.0]] {
        let mut robot = Robot::standing();
        robot.robot.push("torso", impulse);
        robot.run(2.0);
        robot.assert_stands();
    }
}

/// A robot that lies.
fn lying(posture: Posture) -> Robot {
    let mut options = SimulationOptions::darwin_op();
    options.start.posture = posture;
    Robot::new(options)
}

#[test]
fn it_gets_up_from_its_front_and_its_back_and_walks_on() {
    for (posture, seconds) in [(Posture::Prone, 12.0), (Posture::Supine, 40.0)] {
        let mut robot = lying(posture);
        robot.run(seconds);
        assert_eq!(robot.states.lock().unwrap().last().unwrap(), "upright", "{posture:?}");
        let start = robot.place().position;
        robot.walk_until([0.1, 0.0, 0.0], 5.0, |_| false);
        let way = (robot.place().position - start).truncate().length();
        assert!(way > 0.2 && robot.robot.is_upright(), "{posture:?}: {way} m");
    }
}

#[test]
fn it_kicks_a_ball_about_a_metre_far_with_either_foot() {
    for (motion, y) in [("kick_right", -0.045), ("kick_left", 0.045)] {
        let mut options = SimulationOptions::darwin_op();
        options.world.ball = Some(Ball { position: [0.11, y], ..Ball::default() });
        let mut robot = Robot::new(options);
        robot.play(motion, 9.0);
        let ball = robot.robot.snapshot().things[0].2.world_from_body.translation;
        assert!(ball.x - 0.11 > 0.95, "{motion}: {ball}");
        robot.assert_stands();
    }
}

#[test]
fn odometry_and_orientation_agree_with_the_world() {
    let mut robot = Robot::standing();
    let odometry = Arc::<Mutex<Odometry>>::default();
    let orientation = Arc::<Mutex<DQuat>>::default();
    let (kept, kept_orientation) = (Arc::clone(&odometry), Arc::clone(&orientation));
    let keep = move |message: Received<'_, Odometry>| *kept.lock().unwrap() = message.clone();
    robot.robot.core().outlet("odom", Inbox::KeepAll, keep).unwrap().keep();
    let keep = move |imu: Received<'_, Imu>| {
        let q = imu.orientation;
        *kept_orientation.lock().unwrap() = DQuat::from_xyzw(q.x, q.y, q.z, q.w);
    };
    robot.robot.core().outlet("imu/data", Inbox::KeepAll, keep).unwrap().keep();
    robot.run(0.1);
    let (world_start, start) = (robot.place().position, odometry.lock().unwrap().pose.pose.position);
    let mut worst: f64 = 0.0;
    for _ in 0..100 {
        robot.walk_until([0.1, 0.0, 0.1], 0.2, |_| false);
        let world_from_body = robot.robot.snapshot().robot.world_from_body.rotation;
        let up = |rotation: DQuat| rotation.conjugate() * DVec3::Z;
        worst = worst.max(up(world_from_body).angle_between(up(*orientation.lock().unwrap())));
    }
    assert!(worst < 0.1, "the tilt of the filter is off by at most {worst} rad");
    let (world_end, end) = (robot.place().position, odometry.lock().unwrap().pose.pose.position);
    let (way, odometry_way) =
        ((world_end - world_start).truncate(), DVec3::new(end.x - start.x, end.y - start.y, 0.0).truncate());
    assert!((way - odometry_way).length() < 0.15 * way.length(), "{way} and {odometry_way}");
}
