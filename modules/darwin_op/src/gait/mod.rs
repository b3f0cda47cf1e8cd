//! Walks with the velocity on `cmd_vel`.
//!
//! | name | type | |
//! | --- | --- | --- |
//! | `cmd_vel` (in) | `geometry_msgs/Twist` | velocity of the body: `linear.x`, `linear.y` in m/s, `angular.z` in rad/s; without commands for `command_timeout` the robot stops |
//! | `gait/kick` (in) | `std_msgs/String` | `left` or `right`: this foot kicks with its next step |
//! | `gait/start`, `gait/stop` | services `std_srvs/Trigger` | the robot gets ready and follows `cmd_vel`; it stops and stands |
//! | `joint_states`, `joint_goals` (in) | `sensor_msgs/JointState` | the start pose, and odometry |
//! | `imu/data` (in) | `sensor_msgs/Imu` | for balance and heading |
//! | `robot_state` (in) | `std_msgs/String` | pauses the gait while it is not `upright`; see [`falls`](crate::falls) |
//! | `motions/playing` (in) | `std_msgs/String` | pauses the gait while a motion plays; see [`motions`](crate::motions) |
//! | `gait/joint_commands` | `sensor_msgs/JointState` | legs and arms, every 8 ms |
//! | `walking` | `std_msgs/Bool` | true until the robot stands with its feet side by side; when it changes and once a second |
//! | `odom`, `tf` | `nav_msgs/Odometry`, `tf2_msgs/TFMessage` | pose of `base_link` in `odom`, from the legs and the IMU |
//!
//! The robot starts and stops in phases in which both feet are on the ground, and changes its velocity with
//! limited acceleration. While it walks, its yaw follows the integral of the commanded turn rate. The
//! gyroscope acts on knees, ankles and hips against tipping over. With the setting `step_gain`, a robot that
//! is pushed catches itself with steps, also one that stands. A robot that fell continues its walk when it is
//! upright again.
//!
//! With a `stiffness` s, the goals of the legs are beyond their trajectory, by s - 1 times what the joints
//! lag behind or give way: they act as with s times the P gain.
//!
//! The setting `humanoid` names the file of the robot's numbers: see [`humanoid`](crate::humanoid). The
//! others are those of the [engine], with the names and defaults in `downbeat check --kinds`.
//!
//! # References
//! DARwIn-OP framework 1.6, module `Walking`, for the balance; see [`engine`] for the trajectories. J. Pratt,
//! J. Carff, S. Drakunov, A. Goswami, "Capture Point: A Step toward Humanoid Push Recovery", Humanoids 2006,
//! for the steps that answer pushes.

mod capture;
pub mod engine;
mod legs;
mod odometry;
mod settings;

use crate::attitude::world_from_trunk;
use crate::hardware::CYCLE;
use crate::humanoid::Humanoid;
use crate::present_pose::{PresentPose, command};
use capture::Capture;
use downbeat_executor::{Context, Module, Publication, Received, Setup, SetupError, Time};
use downbeat_kinematics::leg::Side;
use downbeat_kinematics::wrapped;
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::downbeat_interfaces::msg::RobotState;
use downbeat_msgs::geometry_msgs::msg::{Point, Quaternion, Transform, TransformStamped, Twist, Vector3};
use downbeat_msgs::nav_msgs::msg::Odometry as OdometryMessage;
use downbeat_msgs::sensor_msgs::msg::{Imu, JointState};
use downbeat_msgs::std_msgs::msg::{Bool, Header, String as Text};
use downbeat_msgs::std_srvs::srv::{TriggerRequest, TriggerResponse};
use downbeat_transforms::TransformBroadcaster;
use engine::{Correction, Engine, Parameters, Targets, Velocity};
use glam::{DQuat, DVec2, DVec3};
use odometry::{Odometry, pitch_of, yaw_of};
use settings::{SettingKeys, Settings};
use std::sync::Arc;
use std::time::Duration;

/// Walks; see the [module page](self).
#[derive(Debug, Default)]
pub struct Gait {
    stage: Stage,
    /// Whether the robot was told to get ready, and whether it follows `cmd_vel`.
    is_started: bool,
    follows: bool,
    command: Velocity,
    commanded_at: Option<Time>,
    is_down: bool,
    /// Until when a robot that got up stands, for it still sways.
    sways_until: Time,
    is_motion_playing: bool,
    humanoid: Arc<Humanoid>,
    pose: PresentPose,
    attitude: Option<Attitude>,
    engine: Engine,
    capture: Capture,
    /// Where the robot should be while it walks.
    reference: Option<Reference>,
    /// The smoothed pitch of the trunk, in rad.
    pitch: Option<f64>,
    /// The last angles without lead and balance.
    trajectory: Option<Vec<f64>>,
    /// From 0 to 1 after the robot got ready: the share of the stiffness.
    stiffened: f64,
    last_tick: Option<Time>,
    odometry: Odometry,
    odometry_at: Option<Time>,
    reported: Option<(Time, bool)>,
}

/// The keys of [`Gait`].
pub struct Ports {
    settings: SettingKeys,
    commands: Publication<JointState>,
    walking: Publication<Bool>,
    odom: Publication<OdometryMessage>,
    transforms: TransformBroadcaster,
}

#[derive(Clone, Debug, Default)]
enum Stage {
    /// Commands nothing.
    #[default]
    Off,
    /// On the way to the stand.
    GettingReady { start: Vec<f64>, begun: Time, duration: f64 },
    /// Stands or walks.
    On,
}

/// What the IMU says.
#[derive(Clone, Copy, Debug)]
struct Attitude {
    /// The orientation; `None` for data without it.
    world_from_trunk: Option<DQuat>,
    /// In rad/s.
    rate: DVec3,
    yaw_variance: f64,
}

/// Where a robot would be that follows all commands: position in odom, in m, and yaw, in rad.
#[derive(Clone, Copy, Debug)]
struct Reference {
    position: DVec2,
    yaw: f64,
}

/// Time constant of the pitch of the trunk, in s: half a step.
const PITCH_SMOOTHING: f64 = 0.15;

/// For how long the stiffness rises after the robot got ready, in s.
const STIFFENING: f64 = 0.4;
/// For how long a robot sways that got up.
const SWAYING: Duration = Duration::from_millis(1200);

const REPORT: Duration = Duration::from_secs(1);

impl Gait {
    fn on_command(&mut self, twist: Received<'_, Twist>, ctx: &mut Context<'_, Ports>) {
        let command = Velocity { forward: twist.linear.x, left: twist.linear.y, turn: twist.angular.z };
        if [command.forward, command.left, command.turn].iter().all(|value| value.is_finite()) {
            self.command = command;
            self.commanded_at = Some(ctx.now());
        }
    }

    fn on_kick(&mut self, foot: Received<'_, Text>, _: &mut Context<'_, Ports>) {
        let side = match foot.data.as_str() {
            "left" => Side::Left,
            "right" => Side::Right,
            other => {
                let other: String = other.chars().take(64).collect();
                return tracing::warn!("gait/kick names the foot \"{other}\"; the feet are left and right");
            }
        };
        if matches!(self.stage, Stage::On) && !self.is_down && !self.is_motion_playing {
            self.engine.kick(side);
        }
    }

    fn on_imu(&mut self, imu: Received<'_, Imu>, _: &mut Context<'_, Ports>) {
        let w = &imu.angular_velocity;
        self.attitude = Some(Attitude {
            world_from_trunk: world_from_trunk(&imu),
            rate: DVec3::new(w.x, w.y, w.z),
            yaw_variance: imu.orientation_covariance[8],
        });
    }

    fn on_joint_states(&mut self, states: Received<'_, JointState>, ctx: &mut Context<'_, Ports>) {
        self.pose.take_states(&states);
        let Some((attitude, world_from_trunk)) =
            self.attitude.and_then(|attitude| Some((attitude, attitude.world_from_trunk?)))
        else {
            return;
        };
        let soles = legs::soles(&self.humanoid, &self.pose.measured_or_stand());
        let now = ctx.now();
        let dt = self.odometry_at.replace(now).map_or(0.0, |last| now.saturating_since(last).as_secs_f64());
        let settings = ctx.ports.settings.values(ctx);
        let shares = DVec2::new(settings.odometry_forward, settings.odometry_side);
        self.odometry.update(soles, world_from_trunk, shares, dt);
        if self.engine.is_walking() {
            let aside = self.engine.velocity().left.abs() * dt;
            self.odometry.drift(settings.odometry_drift * aside, world_from_trunk);
        }
        if settings.step_gain > 0.0 {
            let level_from_base = DQuat::from_rotation_z(-yaw_of(world_from_trunk)) * world_from_trunk;
            let masses = soles.map(|sole| self.humanoid.centre_of_mass() - sole);
            self.capture.measure(masses, level_from_base, attitude.rate, dt);
        } else {
            self.capture.reset();
        }
        let stamp = states.header.stamp;
        let base = self.humanoid.base();
        publish_odometry(&self.odometry, base, world_from_trunk, attitude, stamp, ctx);
    }

    fn tick(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        let dt = self.last_tick.replace(now).map_or(CYCLE, |last| now.saturating_since(last).min(CYCLE * 4));
        let settings = ctx.ports.settings.values(ctx);
        let may_move = !self.is_down && !self.is_motion_playing;
        let humanoid = Arc::clone(&self.humanoid);
        match &self.stage {
            Stage::Off => {
                if self.is_started && may_move && self.pose.is_known() {
                    self.get_ready(now, &settings);
                }
            }
            Stage::GettingReady { .. } if !may_move => self.stage = Stage::Off,
            Stage::GettingReady { start, begun, duration } => {
                let goal = legs::pose(&humanoid, &standing(&settings), &settings);
                let s = (now.saturating_since(*begun).as_secs_f64() / duration).min(1.0);
                let share = s * s * s * (10.0 + s * (-15.0 + s * 6.0));
                let way = start.iter().zip(&goal);
                let pose: Vec<f64> = way.map(|(start, goal)| start + (goal - start) * share).collect();
                publish_command(&humanoid, &pose, ctx);
                if s >= 1.0 {
                    self.stage = Stage::On;
                }
            }
            Stage::On if self.is_down => self.switch_off(),
            Stage::On => {
                let timeout = Duration::from_secs_f64(settings.command_timeout);
                let is_fresh = self.commanded_at.is_some_and(|at| now.saturating_since(at) < timeout);
                let is_wanted = self.follows && may_move && is_fresh && now >= self.sways_until;
                let wanted = if is_wanted { self.command } else { Velocity::default() };
                let wanted = self.corrected(wanted, dt.as_secs_f64(), &settings);
                let seconds = dt.as_secs_f64();
                let parameters = self.leaning(settings.parameters(), seconds, &settings);
                let correction = if may_move {
                    self.correction(seconds, &parameters, &settings)
                } else {
                    Correction::default()
                };
                let targets = self.engine.step(seconds, wanted, correction, &parameters);
                let trajectory = legs::pose(&humanoid, &targets, &settings);
                let last = self.trajectory.replace(trajectory.clone());
                let last = last.as_deref().unwrap_or(&trajectory);
                let lead = if dt.is_zero() { 0.0 } else { settings.servo_lead / seconds };
                let way = trajectory.iter().zip(last);
                let mut pose: Vec<f64> = way.map(|(now, last)| now + (now - last) * lead).collect();
                let rate = self.attitude.map_or(DVec3::ZERO, |attitude| attitude.rate);
                legs::balance(&humanoid, &mut pose, rate, &settings);
                self.stiffened = (self.stiffened + seconds / STIFFENING).min(1.0);
                let stiffness = 1.0 + (settings.stiffness - 1.0) * self.stiffened;
                if stiffness > 1.0 {
                    let measured = self.pose.measured(&pose);
                    legs::stiffen(&humanoid, &mut pose, &measured, stiffness);
                }
                publish_command(&humanoid, &pose, ctx);
                if !may_move && !self.engine.is_walking() {
                    self.switch_off();
                }
            }
        }
        self.report(ctx);
    }

    fn get_ready(&mut self, now: Time, settings: &Settings) {
        let start = self.pose.start(now);
        let humanoid = &self.humanoid;
        let goal = legs::pose(humanoid, &standing(settings), settings);
        let joints = humanoid.joints().iter().zip(start.iter().zip(&goal));
        let way = joints
            .filter(|(joint, _)| joint.is_of_gait)
            .map(|(_, (start, goal))| (goal - start).abs())
            .fold(0.0, f64::max);
        // The peak of the speed of a movement with minimum jerk.
        let duration = (1.875 * way / settings.ready_speed).max(0.1);
        self.stage = Stage::GettingReady { start, begun: now, duration };
    }

    fn switch_off(&mut self) {
        self.stage = Stage::Off;
        self.engine = Engine::default();
        self.reference = None;
        self.pitch = None;
        self.trajectory = None;
        self.stiffened = 0.0;
        self.capture.reset();
    }

    /// What keeps the robot on its feet now.
    fn correction(&mut self, dt: f64, parameters: &Parameters, settings: &Settings) -> Correction {
        let capture = settings.capture(&self.humanoid);
        match self.engine.step_in_progress(parameters) {
            Some(step) => {
                let (forward, is_catching) = (self.engine.velocity().forward, self.engine.is_catching());
                self.capture.stepping(step, forward, is_catching, dt, &capture)
            }
            None if self.engine.is_walking() => Correction::default(),
            None => self.capture.standing(dt, &capture),
        }
    }

    /// The velocity that leads back to where the robot would be if it had followed all commands.
    fn corrected(&mut self, wanted: Velocity, dt: f64, settings: &Settings) -> Velocity {
        let yaw = self.attitude.and_then(|attitude| attitude.world_from_trunk).map(yaw_of);
        let position = self.odometry.position.truncate();
        let (Some(yaw), true) = (yaw, self.engine.is_walking() && wanted != Velocity::default()) else {
            self.reference = None;
            return wanted;
        };
        let limited = settings.parameters().limits.limited(wanted);
        let Reference { position: reference, yaw: heading } =
            self.reference.unwrap_or(Reference { position, yaw });
        let step = DVec2::new(limited.forward, limited.left) * dt;
        let ahead = (reference + DVec2::from_angle(heading).rotate(step) - position)
            .clamp_length_max(settings.path_leash);
        let turned =
            wrapped(heading + limited.turn * dt - yaw).clamp(-settings.heading_leash, settings.heading_leash);
        self.reference = Some(Reference { position: position + ahead, yaw: yaw + turned });
        let correction = DVec2::from_angle(-yaw).rotate(ahead) * settings.path_gain;
        Velocity {
            forward: limited.forward + correction.x,
            left: limited.left + correction.y,
            turn: limited.turn + turned * settings.heading_gain,
        }
    }

    /// Puts the feet to where the trunk leans: forward if it leans more than it should.
    fn leaning(&mut self, mut parameters: Parameters, dt: f64, settings: &Settings) -> Parameters {
        if let Some(orientation) = self.attitude.and_then(|attitude| attitude.world_from_trunk) {
            let measured = pitch_of(orientation);
            let last = self.pitch.unwrap_or(measured);
            let pitch = last + (measured - last) * (dt / PITCH_SMOOTHING).min(1.0);
            self.pitch = Some(pitch);
            if self.engine.is_walking() {
                parameters.stance[0] += settings.lean_gain * (pitch - settings.hip_pitch);
            }
        }
        parameters
    }

    fn report(&mut self, ctx: &mut Context<'_, Ports>) {
        let (now, is_walking) = (ctx.now(), self.engine.is_walking());
        if self.reported.is_none_or(|(at, was_walking)| at + REPORT <= now || was_walking != is_walking) {
            self.reported = Some((now, is_walking));
            ctx.publish(ctx.ports.walking, Bool { data: is_walking });
        }
    }
}

impl Module for Gait {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let settings = SettingKeys::declare(setup)?;
        self.humanoid = Humanoid::declare(setup)?;
        self.pose = PresentPose::new(Arc::clone(self.humanoid.joints()));
        let starts = setup.value(settings.start).copied().unwrap_or_default();
        (self.is_started, self.follows) = (starts, starts);
        let ports = Ports {
            settings,
            commands: setup.publish("gait/joint_commands")?,
            walking: setup.publish("walking")?,
            odom: setup.publish("odom")?,
            transforms: TransformBroadcaster::declare(setup)?,
        };
        setup.subscribe("cmd_vel", Self::on_command)?;
        setup.subscribe("imu/data", Self::on_imu)?;
        setup.subscribe("joint_states", Self::on_joint_states)?;
        setup.subscribe("joint_goals", |gait: &mut Self, goals: Received<'_, JointState>, ctx| {
            gait.pose.take_goals(&goals, ctx.now());
        })?;
        setup.subscribe("gait/kick", Self::on_kick)?;
        setup.subscribe("robot_state", |gait: &mut Self, state: Received<'_, Text>, ctx| {
            let was_down = std::mem::replace(&mut gait.is_down, state.data != RobotState::UPRIGHT);
            if was_down && !gait.is_down {
                gait.sways_until = ctx.now() + SWAYING;
            }
        })?;
        setup.subscribe("motions/playing", |gait: &mut Self, name: Received<'_, Text>, _| {
            gait.is_motion_playing = !name.data.is_empty();
        })?;
        setup.serve::<TriggerRequest, TriggerResponse, _>("gait/start", |gait, _, _| {
            (gait.is_started, gait.follows) = (true, true);
            Ok(TriggerResponse { success: true, message: String::new() })
        })?;
        setup.serve::<TriggerRequest, TriggerResponse, _>("gait/stop", |gait, _, _| {
            gait.follows = false;
            Ok(TriggerResponse { success: true, message: String::new() })
        })?;
        setup.every(CYCLE, Self::tick)?;
        Ok(ports)
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}

/// The targets of a robot that stands.
fn standing(settings: &Settings) -> Targets {
    Engine::default().step(0.0, Velocity::default(), Correction::default(), &settings.parameters())
}

fn publish_command(humanoid: &Humanoid, pose: &[f64], ctx: &mut Context<'_, Ports>) {
    let joints = humanoid.joints();
    let message = command(ctx.now(), joints, pose, |index| joints[index].is_of_gait);
    ctx.publish(ctx.ports.commands, message);
}

/// The standard deviation of the position, as a fraction of the way.
const SLIP: f64 = 0.1;

fn publish_odometry(
    odometry: &Odometry,
    base: &str,
    world_from_trunk: DQuat,
    attitude: Attitude,
    stamp: builtin_interfaces::msg::Time,
    ctx: &mut Context<'_, Ports>,
) {
    let DQuat { x, y, z, w } = world_from_trunk;
    let rotation = Quaternion { x, y, z, w };
    let DVec3 { x, y, z } = odometry.position;
    let header = Header { stamp, frame_id: "odom".to_owned() };
    let base_link = base.to_owned();
    let velocity = world_from_trunk.conjugate() * odometry.velocity;
    let mut message =
        OdometryMessage { header: header.clone(), child_frame_id: base_link.clone(), ..Default::default() };
    message.pose.pose.position = Point { x, y, z };
    message.pose.pose.orientation = rotation;
    let variance = (SLIP * odometry.way).powi(2) + 1e-6;
    for axis in 0..3 {
        message.pose.covariance[axis * 7] = variance;
        message.twist.covariance[axis * 7] = 1e-3;
        message.pose.covariance[21 + axis * 7] = attitude.yaw_variance;
        message.twist.covariance[21 + axis * 7] = 1e-2;
    }
    message.twist.twist.linear = Vector3 { x: velocity.x, y: velocity.y, z: velocity.z };
    let rate = attitude.rate;
    message.twist.twist.angular = Vector3 { x: rate.x, y: rate.y, z: rate.z };
    ctx.publish(ctx.ports.odom, message);
    let transform = Transform { translation: Vector3 { x, y, z }, rotation };
    let transform = TransformStamped { header, child_frame_id: base_link, transform };
    ctx.ports.transforms.send(ctx, [transform]);
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::testing::{Collector, core_at_zero};
    use downbeat_executor::{Core, Inlet, ManualClock};

    struct Robot {
        core: Core,
        clock: ManualClock,
        cmd_vel: Inlet<Twist>,
        robot_state: Inlet<Text>,
        commands: Collector<JointState>,
        walking: Collector<Bool>,
    }

    impl Robot {
        fn new() -> Self {
            let (mut core, clock) = core_at_zero();
            core.add("gait", Gait::default()).unwrap();
            let humanoid = Humanoid::darwin_op();
            let joints = humanoid.joints();
            let states = core.inlet("joint_states").unwrap();
            states.publish(command(Time::ZERO, joints, &joints.stand(), |_| true)).unwrap();
            let (cmd_vel, robot_state) = (core.inlet("cmd_vel").unwrap(), core.inlet("robot_state").unwrap());
            let commands = Collector::add(&mut core, "gait/joint_commands");
            let walking = Collector::add(&mut core, "walking");
            Self { core, clock, cmd_vel, robot_state, commands, walking }
        }

        fn call(&mut self, service: &str) {
            let caller = self.core.caller::<TriggerRequest, TriggerResponse>(service).unwrap();
            caller
                .call(TriggerRequest::default(), REPORT, |answer| assert!(answer.unwrap().success))
                .unwrap();
        }

        fn run(&mut self, seconds: f64) {
            for _ in 0..(seconds / 0.008).round() as usize {
                self.clock.advance(CYCLE);
                (0..3).for_each(|_| self.core.cycle().unwrap());
            }
        }

        /// Commands a velocity forward for a time.
        fn walk(&mut self, seconds: f64) {
            for _ in 0..(seconds / 0.1).round() as usize {
                let mut twist = Twist::default();
                twist.linear.x = 0.1;
                self.cmd_vel.publish(twist).unwrap();
                self.run(0.1);
            }
        }

        fn is_walking(&self) -> bool {
            self.walking.take().last().unwrap().data
        }
    }

    #[test]
    fn it_commands_nothing_before_it_is_started_and_walks_when_commanded() {
        let mut robot = Robot::new();
        robot.walk(1.0);
        robot.run(1.0);
        assert_eq!(robot.commands.take(), []);
        robot.call("gait/start");
        robot.run(1.0);
        assert!(robot.commands.take().iter().all(|command| command.name.len() == 18));
        assert!(!robot.is_walking());
        robot.walk(2.0);
        assert!(robot.is_walking());
    }

    #[test]
    fn it_stops_after_the_last_command_and_when_told_to() {
        let mut robot = Robot::new();
        robot.call("gait/start");
        robot.run(1.0);
        robot.walk(2.0);
        robot.run(4.0);
        assert!(!robot.is_walking());
        robot.walk(2.0);
        assert!(robot.is_walking());
        robot.call("gait/stop");
        robot.walk(4.0);
        assert!(!robot.is_walking());
        assert!(!robot.commands.take().is_empty(), "it stands");
    }

    #[test]
    fn it_commands_nothing_while_the_robot_is_down_and_walks_on_afterwards() {
        let mut robot = Robot::new();
        robot.call("gait/start");
        robot.run(1.0);
        robot.walk(2.0);
        robot.robot_state.publish(Text { data: "falling".to_owned() }).unwrap();
        robot.walk(0.1);
        robot.commands.take();
        robot.walk(1.0);
        assert_eq!(robot.commands.take(), []);
        robot.robot_state.publish(Text { data: "upright".to_owned() }).unwrap();
        robot.walk(1.0);
        assert!(
            !robot.is_walking() && !robot.commands.take().is_empty(),
            "it stands until it no longer sways"
        );
        robot.walk(2.0);
        assert!(robot.is_walking());
    }
}
