//! A simulated robot with the modules of a walking one.

use super::{Conditions, Failure};
use crate::harness::SimulatedRobot;
use downbeat_darwin_op::falls::Falls;
use downbeat_darwin_op::gait::Gait;
use downbeat_darwin_op::motions::MotionPlayer;
use downbeat_executor::{Inbox, Inlet, ModuleOptions, Received, SettingValue, Time};
use downbeat_imu_filter::ImuFilter;
use downbeat_msgs::downbeat_interfaces::msg::RobotState;
use downbeat_msgs::geometry_msgs::msg::Twist;
use downbeat_msgs::std_msgs::msg::String as Text;
use downbeat_servos::joint_command_mux::JointCommandMux;
use glam::DVec3;
use parking_lot::Mutex;
use std::sync::Arc;
use std::time::Duration;

/// A simulated robot with the modules of `robots/darwin_op_walks.toml`: it follows `cmd_vel`, plays motions
/// and gets up.
pub struct WalkingRobot {
    robot: SimulatedRobot,
    cmd_vel: Inlet<Twist>,
    play: Inlet<Text>,
    kick: Inlet<Text>,
    /// What `robot_state` was, and since when.
    states: Arc<Mutex<Vec<(Time, String)>>>,
    /// In s.
    elapsed: f64,
}

/// Where a robot is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// The position of its root link in the world, in m.
    pub position: DVec3,
    /// Its heading, in rad, from -π to π.
    pub yaw: f64,
}

/// The time in which a robot that stands gets ready to walk, in s.
const READY: f64 = 2.0;
/// The largest distance by which a robot that stands moves in a second, in m.
const STILL: f64 = 0.01;

impl WalkingRobot {
    /// A robot that was given two seconds to get ready.
    ///
    /// # Errors
    /// If it cannot be simulated.
    pub fn new(conditions: Conditions) -> Result<Self, Failure> {
        let Conditions { simulation, seed, motions, gait } = conditions;
        let mut robot = SimulatedRobot::new(simulation, seed)?;
        robot.hardware_listens_to("joint_goals")?;
        robot.add("imu_filter", ImuFilter::default())?;
        let with = |setting: &str, value: SettingValue| ModuleOptions {
            settings: [(setting.to_owned(), value)].into(),
            ..ModuleOptions::default()
        };
        let mut options = with("start", true.into());
        options.settings.extend(gait);
        robot.core().add_with("gait", Gait::default(), options)?;
        robot.core().add_with("motions", MotionPlayer::default(), with("file", motions.into()))?;
        robot.add("falls", Falls::default())?;
        robot.add("mux", JointCommandMux::default())?;
        let cmd_vel = robot.core().inlet("cmd_vel")?;
        let play = robot.core().inlet("motions/play")?;
        let kick = robot.core().inlet("gait/kick")?;
        let states = Arc::<Mutex<Vec<(Time, String)>>>::default();
        let collected = Arc::clone(&states);
        let collect = move |state: Received<'_, Text>| {
            let mut states = collected.lock();
            if states.last().is_none_or(|(_, last)| *last != state.data) {
                states.push((state.time(), state.data.clone()));
            }
        };
        robot.core().outlet("robot_state", Inbox::KeepAll, collect)?.keep();
        let mut robot = Self { robot, cmd_vel, play, kick, states, elapsed: 0.0 };
        robot.run(READY)?;
        Ok(robot)
    }

    /// The robot, for pushes, snapshots and other modules.
    pub fn simulated(&mut self) -> &mut SimulatedRobot {
        &mut self.robot
    }

    /// Runs for this simulated time, in s.
    ///
    /// # Errors
    /// If the core cannot run.
    pub fn run(&mut self, seconds: f64) -> Result<(), Failure> {
        self.elapsed += seconds;
        Ok(self.robot.run_for(Duration::from_secs_f64(seconds))?)
    }

    /// Commands a velocity (forward and to the left in m/s, turn to the left in rad/s) until a condition
    /// holds, at most for `at_most` s, and returns how long that took.
    ///
    /// # Errors
    /// If the robot falls, or the core cannot run.
    pub fn walk_until(
        &mut self,
        velocity: [f64; 3],
        at_most: f64,
        mut is_there: impl FnMut(Place) -> bool,
    ) -> Result<f64, Failure> {
        let mut time = 0.0;
        while time < at_most && !is_there(self.place()) {
            let mut twist = Twist::default();
            [twist.linear.x, twist.linear.y, twist.angular.z] = velocity;
            self.cmd_vel.publish(twist)?;
            self.run(0.1)?;
            self.has_not_fallen()?;
            time += 0.1;
        }
        Ok(time)
    }

    /// Plays a motion and runs for this simulated time, in s.
    ///
    /// # Errors
    /// If the core cannot run.
    pub fn play(&mut self, motion: &str, seconds: f64) -> Result<(), Failure> {
        self.play.publish(Text { data: motion.to_owned() })?;
        self.run(seconds)
    }

    /// Lets the `left` or the `right` foot kick with its next step.
    ///
    /// # Errors
    /// If the core does not take messages.
    pub fn kick(&mut self, foot: &str) -> Result<(), Failure> {
        Ok(self.kick.publish(Text { data: foot.to_owned() })?)
    }

    /// Where the robot is.
    #[must_use]
    pub fn place(&self) -> Place {
        let pose = self.robot.snapshot().robot.world_from_body;
        let ahead = pose.rotation * DVec3::X;
        Place { position: pose.translation, yaw: libm::atan2(ahead.y, ahead.x) }
    }

    /// The angle between the trunk and the vertical, in rad.
    #[must_use]
    pub fn tilt(&self) -> f64 {
        let up = self.robot.snapshot().robot.world_from_body.rotation * DVec3::Z;
        libm::acos(up.z.clamp(-1.0, 1.0))
    }

    /// What `robot_state` was, one after another, and since when.
    #[must_use]
    pub fn states(&self) -> Vec<(Time, String)> {
        self.states.lock().clone()
    }

    /// Lets a robot that has got up count as one that has not fallen.
    pub fn forget_falls(&mut self) {
        self.states.lock().clear();
    }

    /// Returns an error if the robot has fallen.
    ///
    /// # Errors
    /// [`Failure::Fell`].
    pub fn has_not_fallen(&self) -> Result<(), Failure> {
        let has_fallen = !self.robot.is_upright()
            || self.states.lock().iter().any(|(_, state)| state != RobotState::UPRIGHT);
        if has_fallen { Err(Failure::Fell { after: self.elapsed }) } else { Ok(()) }
    }

    /// Runs for a second in which the robot has to stand still.
    ///
    /// # Errors
    /// If it moves or falls, or the core cannot run.
    pub fn stands_still(&mut self) -> Result<(), Failure> {
        let before = self.place().position;
        self.run(1.0)?;
        let moved = (self.place().position - before).length();
        if !self.robot.is_upright() {
            return Err(Failure::Fell { after: self.elapsed });
        }
        if moved > STILL { Err(Failure::Moves { moved }) } else { Ok(()) }
    }
}
