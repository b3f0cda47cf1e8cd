//! Plays key-frame motions by name: stand, sit, get up, kick, wave.
//!
//! | name | type | |
//! | --- | --- | --- |
//! | `play_motion` | action `downbeat_interfaces/PlayMotion` | plays a motion; it can be canceled |
//! | `motions/play` (in) | `std_msgs/String` | the same by topic; an empty name stops the motion |
//! | `motions/stop` (in) | `std_msgs/Empty` | stops the motion: for modules, so that `motions/play` is left to those outside |
//! | `motions/playing` | `std_msgs/String` | the motion that plays, or an empty name; when it changes and once a second |
//! | `motions/joint_commands` | `sensor_msgs/JointState` | positions of the joints that the motion moves, every 8 ms |
//! | `joint_states`, `joint_goals` (in) | `sensor_msgs/JointState` | where a motion starts |
//! | `motions/get`, `motions/set` | services `downbeat_interfaces/GetMotions`, `SetMotion` | for editors: the motions, and one changed until the program ends |
//! | `imu/data` (in) | `sensor_msgs/Imu` | with orientation: for motions that keep their balance |
//! | `walking` (in) | `std_msgs/Bool` | a motion waits until the robot has stopped |
//!
//! | setting | |
//! | --- | --- |
//! | `file` | file of motions, as described in [`mod@file`]; empty for the motions of the Darwin OP that are built in, and for no motions of another robot |
//! | `speed` | the speed of all motions, as a fraction of what the file says |
//! | `humanoid` | file of the robot's numbers; empty for the Darwin OP: see [`humanoid`](crate::humanoid) |
//! | `description`, `bus` | of a robot that is no humanoid, such as an arm: the file of its servos, and the name of their bus if it has several |
//!
//! The goals of a motion with a `stiffness` s are beyond its poses, by s - 1 times what the joints lag behind
//! or give way: they act as with s times the P gain.
//!
//! In a motion with `balance` the ankles turn against a fall: see [`mod@file`].
//!
//! A motion starts at the present pose. A new motion interrupts the one that plays and starts where it was.
//! After its last frame the joints keep their goals.

mod balance;
mod editing;
pub mod file;
mod motion;
mod path;

pub use file::{MotionFileError, Motions};
pub use motion::{Balance, Frame, Interpolation, Motion};
pub use path::Path;

use crate::hardware::CYCLE;
use crate::humanoid::Humanoid;
use crate::joints::Joints;
use crate::present_pose::{PresentPose, command};
use balance::Attitude;
use downbeat_actions::{ActionServer, CancelResponse, GoalId, GoalResponse};
use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat_msgs::downbeat_interfaces::action::{PlayMotion, PlayMotionFeedback, PlayMotionResult};
use downbeat_msgs::downbeat_interfaces::srv::{
    GetMotionsRequest, GetMotionsResponse, SetMotionRequest, SetMotionResponse,
};
use downbeat_msgs::sensor_msgs::msg::{Imu, JointState};
use downbeat_msgs::std_msgs::msg::{Bool, Empty, String as Text};
use downbeat_servos::servo_bus::Description;
use downbeat_servos::step::standstill;
use std::path::Path as FilePath;
use std::sync::Arc;
use std::time::Duration;

/// The panel of the page: it makes motions.
pub const PANEL: &str = include_str!("motions.panel.js");

/// The motions of the Darwin OP.
pub const DARWIN_OP: &str = include_str!("../../darwin_op_motions.toml");

const BUILT_IN: &str = "darwin_op_motions.toml";

/// Plays key-frame motions; see the [module page](self).
#[derive(Debug, Default)]
pub struct MotionPlayer {
    motions: Motions,
    /// The name of the file that they are from; empty if they are built in.
    file: String,
    server: ActionServer<PlayMotion>,
    pose: PresentPose,
    /// `None` of a robot that has no legs to balance with.
    humanoid: Option<Arc<Humanoid>>,
    attitude: Option<Attitude>,
    is_walking: bool,
    playing: Option<Playing>,
    /// When the topic of the motion that plays is published next.
    report_at: Time,
}

/// The keys of [`MotionPlayer`].
pub struct Ports {
    commands: Publication<JointState>,
    playing: Publication<Text>,
    speed: Setting<f64>,
}

/// A motion that plays or waits.
#[derive(Debug)]
struct Playing {
    name: String,
    motion: Arc<Motion>,
    /// The goal that asked for it; `None` if the topic did.
    goal: Option<GoalId>,
    /// `None` while it waits until the robot stands still.
    path: Option<Path>,
    /// When it was asked for, and when it last advanced.
    asked: Time,
    last: Time,
    /// The time in the motion, in s.
    time: f64,
    feedback_at: f64,
}

/// How long a motion waits for the robot to stop walking.
const PATIENCE: Duration = Duration::from_secs(5);
/// For how long the stiffness rises at the start of a motion and falls at its end, in s.
const RAMP_S: f64 = 0.4;
/// The period of feedback, in s.
const FEEDBACK_S: f64 = 0.1;
/// The period of the topic of the motion that plays.
const REPORT: Duration = Duration::from_secs(1);

impl MotionPlayer {
    fn on_play(&mut self, name: Received<'_, Text>, ctx: &mut Context<'_, Ports>) {
        if name.data.is_empty() {
            self.end("stopped", ctx);
        } else if self.is_known(&name.data) {
            self.play(&name.data, None, ctx);
        }
    }

    /// Returns true for names of motions; others are logged.
    fn is_known(&self, name: &str) -> bool {
        let is_known = self.motions.get(name).is_some();
        if !is_known {
            let names: Vec<&str> = self.motions.names().collect();
            let name: String = name.chars().take(64).collect();
            tracing::warn!("there is no motion \"{name}\"; the motions are {}", names.join(", "));
        }
        is_known
    }

    fn begin(&mut self, id: GoalId, ctx: &mut Context<'_, Ports>) {
        if let Some(name) = self.server.goal(id).map(|goal| goal.goal().name.clone()) {
            self.play(&name, Some(id), ctx);
        }
    }

    fn play(&mut self, name: &str, goal: Option<GoalId>, ctx: &mut Context<'_, Ports>) {
        let Some(motion) = self.motions.get(name).map(Arc::clone) else { return };
        self.end(&format!("interrupted by \"{name}\""), ctx);
        let (asked, last) = (ctx.now(), ctx.now());
        let name = name.to_owned();
        let path = None;
        self.playing = Some(Playing { name, motion, goal, path, asked, last, time: 0.0, feedback_at: 0.0 });
        self.report(ctx);
    }

    /// Ends the motion that plays, if any, before its end.
    fn end(&mut self, why: &str, ctx: &mut Context<'_, Ports>) {
        let Some(playing) = self.playing.take() else { return };
        tracing::info!("motion \"{}\": {why}", playing.name);
        let goal = playing.goal.and_then(|id| self.server.goal(id));
        if let Some((id, is_canceling)) = goal.map(|goal| (goal.id(), goal.is_canceling())) {
            let result = PlayMotionResult { message: why.to_owned() };
            let ended = match is_canceling {
                true => self.server.canceled(ctx, id, result),
                false => self.server.abort(ctx, id, result),
            };
            ended.unwrap_or_else(|error| tracing::error!("{error}"));
        }
        self.report(ctx);
    }

    fn on_canceling(&mut self, id: GoalId, ctx: &mut Context<'_, Ports>) {
        if self.playing.as_ref().is_some_and(|playing| playing.goal == Some(id)) {
            self.end("canceled", ctx);
        }
    }

    fn tick(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        if now >= self.report_at {
            self.report(ctx);
        }
        let speed = *ctx.get(ctx.ports.speed);
        let Some(playing) = &mut self.playing else { return };
        let Some(path) = &playing.path else {
            if self.is_walking && now.saturating_since(playing.asked) > PATIENCE {
                self.end("the robot did not stop walking", ctx);
            } else if !self.is_walking && self.pose.is_known() {
                let start = self.pose.start(now);
                // A start from far away is not urgent.
                let first_speed = self.pose.joints().max_speed() / 2.0;
                playing.path = Some(Path::new(&playing.motion, &start, first_speed));
                playing.last = now;
            }
            return;
        };
        if standstill(playing.last, now).is_zero() {
            playing.time += now.saturating_since(playing.last).as_secs_f64() * speed;
        }
        playing.last = now;
        let pose = path.pose(playing.time);
        // Goals beyond the pose, by a multiple of what is missing, act like a higher P gain.
        let ramp = (playing.time.min(path.duration() - playing.time) / RAMP_S).clamp(0.0, 1.0);
        let excess = (playing.motion.stiffness - 1.0) * ramp;
        let measured = self.pose.measured(&pose);
        let joints = self.pose.joints();
        let goals = joints.iter().zip(pose.iter().zip(&measured)).map(|(joint, (position, measured))| {
            let goal = position + (position - measured) * excess;
            let [min, max] = joint.limits;
            if excess > 0.0 { goal.clamp(min, max) } else { goal }
        });
        let mut goals: Vec<f64> = goals.collect();
        if let (Some(gains), Some(attitude), Some(humanoid)) =
            (playing.motion.balance, self.attitude, &self.humanoid)
        {
            balance::balance(humanoid, &mut goals, &pose, attitude, gains);
        }
        ctx.publish(ctx.ports.commands, command(now, joints, &goals, |index| path.moves()[index]));
        let is_over = playing.time >= path.duration();
        if let Some(id) = playing.goal.filter(|_| is_over || playing.time >= playing.feedback_at) {
            playing.feedback_at = playing.time + FEEDBACK_S;
            let progress = (playing.time / path.duration()).min(1.0) as f32;
            let published = self.server.publish_feedback(ctx, id, PlayMotionFeedback { progress });
            published.unwrap_or_else(|error| tracing::error!("{error}"));
        }
        if is_over {
            let goal = playing.goal;
            self.playing = None;
            if let Some(id) = goal {
                let ended = self.server.succeed(ctx, id, PlayMotionResult::default());
                ended.unwrap_or_else(|error| tracing::error!("{error}"));
            }
            self.report(ctx);
        }
    }

    fn get(
        &mut self,
        _: &GetMotionsRequest,
        _: &mut Context<'_, Ports>,
    ) -> Result<GetMotionsResponse, String> {
        let joints = self.pose.joints();
        let motions = self.motions.names().filter_map(|name| {
            let motion = self.motions.get(name)?;
            Some(editing::message(name, motion, self.motions.original_of(name)))
        });
        Ok(GetMotionsResponse {
            file: self.file.clone(),
            joints: joints.iter().map(|joint| joint.name.clone()).collect(),
            lower: joints.iter().map(|joint| joint.limits[0]).collect(),
            upper: joints.iter().map(|joint| joint.limits[1]).collect(),
            motions: motions.collect(),
        })
    }

    /// A motion that plays goes on as it was.
    fn set(
        &mut self,
        request: &SetMotionRequest,
        _: &mut Context<'_, Ports>,
    ) -> Result<SetMotionResponse, String> {
        let joints = self.pose.joints();
        let file = if self.file.is_empty() { BUILT_IN } else { &self.file };
        Ok(match editing::with(&self.motions, file, &request.motion, joints) {
            Ok(motions) => {
                let motion = motions.get(&request.motion.name);
                let (period, poses) = motion.map(|motion| editing::poses(motion, joints)).unwrap_or_default();
                let text = motions.text().to_owned();
                self.motions = motions;
                SetMotionResponse { success: true, text, period, poses, ..SetMotionResponse::default() }
            }
            Err(message) => SetMotionResponse { message, ..SetMotionResponse::default() },
        })
    }

    /// Declares which robot it is, and returns its joints.
    fn declare_robot(&mut self, setup: &mut Setup<'_, Self>) -> Result<Arc<Joints>, SetupError> {
        let description = setup.read_only_setting(
            "description",
            String::new(),
            "file of the servos of a robot that is no humanoid, relative to the robot file",
        )?;
        let bus = setup.read_only_setting(
            "bus",
            String::new(),
            "which bus of the description, if it has several",
        )?;
        let humanoid = Humanoid::declare(setup)?;
        let [path, bus] = [description, bus].map(|key| setup.value(key).cloned().unwrap_or_default());
        if path.is_empty() {
            let joints = Arc::clone(humanoid.joints());
            self.humanoid = Some(humanoid);
            return Ok(joints);
        }
        if !Arc::ptr_eq(&humanoid, &Humanoid::darwin_op()) {
            let problem = "`humanoid` names another robot: give one of them".to_owned();
            return Err(setup.refuse_value(description, problem));
        }
        let joints = Description::load(&path).and_then(|servos| servos.bus(&bus).map(Joints::of_servos));
        joints.map(Arc::new).map_err(|error| setup.refuse_value(description, error.to_string()))
    }

    fn report(&mut self, ctx: &mut Context<'_, Ports>) {
        self.report_at = ctx.now() + REPORT;
        let data = self.playing.as_ref().map(|playing| playing.name.clone()).unwrap_or_default();
        ctx.publish(ctx.ports.playing, Text { data });
    }
}

impl Module for MotionPlayer {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let joints = self.declare_robot(setup)?;
        let file = setup.read_only_setting(
            "file",
            String::new(),
            "file of motions, relative to the robot file; empty: those of the Darwin OP, none of another robot",
        )?;
        let motions = match setup.value(file).map(String::as_str).unwrap_or_default() {
            "" if Arc::ptr_eq(&joints, Humanoid::darwin_op().joints()) => {
                Motions::parse(BUILT_IN, DARWIN_OP, &joints)
            }
            "" => Ok(Motions::default()),
            path => Motions::read(path, &joints),
        };
        // Without its folder, which a replay may name in another way.
        let name = setup.value(file).and_then(|path| FilePath::new(path).file_name());
        self.file = name.map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        self.pose = PresentPose::new(joints);
        self.motions = motions.map_err(|error| setup.refuse_value(file, error.to_string()))?;
        if self.humanoid.is_none()
            && let Some(name) = self.motions.balancing()
        {
            let problem = format!("motion \"{name}\" keeps its balance, which only a humanoid can");
            return Err(setup.refuse_value(file, problem));
        }
        let ports = Ports {
            commands: setup.publish("motions/joint_commands")?,
            playing: setup.publish("motions/playing")?,
            speed: setup.setting_in(
                "speed",
                1.0,
                0.05..=1.0,
                "of all motions, as a fraction of what the file says",
            )?,
        };
        setup.subscribe("joint_states", |player: &mut Self, states: Received<'_, JointState>, _| {
            player.pose.take_states(&states);
        })?;
        setup.subscribe("joint_goals", |player: &mut Self, goals: Received<'_, JointState>, ctx| {
            player.pose.take_goals(&goals, ctx.now());
        })?;
        setup.subscribe("imu/data", |player: &mut Self, imu: Received<'_, Imu>, _| {
            player.attitude = Attitude::of(&imu);
        })?;
        setup.subscribe("walking", |player: &mut Self, walking: Received<'_, Bool>, _| {
            player.is_walking = walking.data;
        })?;
        setup.subscribe("motions/play", Self::on_play)?;
        setup.serve("motions/get", Self::get)?;
        setup.serve("motions/set", Self::set)?;
        setup.subscribe::<Empty, _>("motions/stop", |player, _, ctx| player.end("stopped", ctx))?;
        ActionServer::builder(|player: &mut Self| &mut player.server)
            .on_goal(|player, _, goal, _| match player.is_known(&goal.name) {
                true => GoalResponse::AcceptAndExecute,
                false => GoalResponse::Reject,
            })
            .on_accepted(Self::begin)
            .on_cancel(|_, _, _| CancelResponse::Accept)
            .on_canceling(Self::on_canceling)
            .declare(setup, "play_motion", &mut self.server)?;
        setup.every(CYCLE, Self::tick)?;
        Ok(ports)
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::testing::{Collector, core_at_zero};
    use downbeat_executor::{Core, Inlet, ManualClock, ModuleOptions};

    struct Robot {
        core: Core,
        clock: ManualClock,
        play: Inlet<Text>,
        walking: Inlet<Bool>,
        commands: Collector<JointState>,
        playing: Collector<Text>,
    }

    impl Robot {
        fn new() -> Self {
            Self::with_file("")
        }

        fn with_file(path: &str) -> Self {
            let (mut core, clock) = core_at_zero();
            let settings = [("file".to_owned(), path.to_owned().into())].into();
            let options = ModuleOptions { settings, ..ModuleOptions::default() };
            core.add_with("motions", MotionPlayer::default(), options).unwrap();
            let humanoid = Humanoid::darwin_op();
            let joints = humanoid.joints();
            let states = core.inlet("joint_states").unwrap();
            states.publish(command(Time::ZERO, joints, &joints.stand(), |_| true)).unwrap();
            let (play, walking) = (core.inlet("motions/play").unwrap(), core.inlet("walking").unwrap());
            let commands = Collector::add(&mut core, "motions/joint_commands");
            let playing = Collector::add(&mut core, "motions/playing");
            let mut robot = Self { core, clock, play, walking, commands, playing };
            robot.run(0.1);
            robot.playing.take();
            robot
        }

        fn run(&mut self, seconds: f64) {
            for _ in 0..(seconds / 0.008).round() as usize {
                self.clock.advance(CYCLE);
                (0..3).for_each(|_| self.core.cycle().unwrap());
            }
        }

        fn play(&self, name: &str) {
            self.play.publish(Text { data: name.to_owned() }).unwrap();
        }

        fn names_played(&self) -> Vec<String> {
            let mut names: Vec<String> = self.playing.take().into_iter().map(|name| name.data).collect();
            names.dedup();
            names
        }
    }

    #[test]
    fn the_built_in_motions_are_valid() {
        let motions =
            Motions::parse("darwin_op_motions.toml", DARWIN_OP, Humanoid::darwin_op().joints()).unwrap();
        for name in
            ["stand", "sit", "wave", "get_up_front", "get_up_back", "get_up_left", "kick_left", "kick_right"]
        {
            assert!(motions.get(name).is_some(), "{name}");
        }
    }

    #[test]
    fn a_motion_is_played_by_topic_from_the_present_pose_to_its_end() {
        let mut robot = Robot::new();
        robot.play("sit");
        robot.run(0.5);
        let commands = robot.commands.take();
        let knee = |command: &JointState| {
            command.position[command.name.iter().position(|name| name == "r_knee").unwrap()]
        };
        assert!(
            (knee(&commands[0]) - Humanoid::darwin_op().joints()[12].stand).abs() < 0.01,
            "it starts at the stand"
        );
        robot.run(30.0);
        assert!(knee(robot.commands.take().last().unwrap()) > 1.5, "it sits");
        assert_eq!(robot.names_played(), ["sit", ""]);
    }

    #[test]
    fn a_motion_waits_until_the_robot_has_stopped_walking() {
        let mut robot = Robot::new();
        robot.walking.publish(Bool { data: true }).unwrap();
        robot.run(0.1);
        robot.play("sit");
        robot.run(1.0);
        assert_eq!(robot.commands.take(), []);
        robot.walking.publish(Bool { data: false }).unwrap();
        robot.run(0.1);
        assert_ne!(robot.commands.take(), []);
        robot.walking.publish(Bool { data: true }).unwrap();
        robot.play("sit");
        robot.run(6.0);
        assert_eq!(robot.names_played(), ["sit", "", "sit", ""], "it gives up");
    }

    #[test]
    fn an_empty_name_stops_a_motion_and_another_one_interrupts_it() {
        let mut robot = Robot::new();
        robot.play("wave");
        robot.run(0.5);
        robot.play("sit");
        robot.run(0.5);
        robot.play("");
        robot.run(0.1);
        robot.commands.take();
        robot.run(0.5);
        assert_eq!(robot.commands.take(), []);
        assert_eq!(robot.names_played(), ["wave", "", "sit", ""]);
    }

    #[test]
    fn the_goals_of_a_stiff_motion_exceed_its_poses_by_what_the_joints_give_way() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let nod = "[[nod.frame]]\nduration_s = 1.0\npause_s = 2.0\nradians = { head_tilt = 0.2 }\n";
        std::fs::write(&file, format!("[nod]\nstiffness = 3.0\n{nod}")).unwrap();
        let path = file.path().to_str().unwrap().to_owned();
        let mut robot = Robot::with_file(&path);
        robot.play("nod");
        robot.run(1.5);
        let given_way = Humanoid::darwin_op().joints()[19].stand;
        let goal = robot.commands.take().last().unwrap().position[0];
        assert!((goal - (0.2 + 2.0 * (0.2 - given_way))).abs() < 1e-9, "{goal}");
        robot.run(2.0);
        let goal = robot.commands.take().last().unwrap().position[0];
        assert!((goal - 0.2).abs() < 0.02, "at the end it is the pose: {goal}");
    }

    const SO101: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../robots/servos/so101.toml");

    #[test]
    fn an_arm_has_motions_of_its_own_joints_within_their_limits_and_no_balance() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("motions.toml");
        let add = |motions: &str, further: &[(&str, &str)]| {
            std::fs::write(&path, motions).unwrap();
            let (mut core, clock) = core_at_zero();
            let given = [("description", SO101), ("file", path.to_str().unwrap())];
            let settings = given.iter().chain(further);
            let settings = settings.map(|(name, value)| ((*name).to_owned(), (*value).to_owned().into()));
            let options = ModuleOptions { settings: settings.collect(), ..ModuleOptions::default() };
            let added = core.add_with("motions", MotionPlayer::default(), options);
            added.map(|_| (core, clock)).map_err(|error| error.to_string())
        };
        let fold = "[[fold.frame]]\nduration_s = 1.0\ndegrees = { elbow_flex = 90, gripper = -10 }\n";
        let (mut core, clock) = add(fold, &[]).unwrap();
        let commands = Collector::<JointState>::add(&mut core, "motions/joint_commands");
        let name = ["gripper", "elbow_flex"].map(str::to_owned).to_vec();
        let states = JointState { name, position: vec![0.5, 0.0], ..JointState::default() };
        core.inlet("joint_states").unwrap().publish(states).unwrap();
        core.inlet("motions/play").unwrap().publish(Text { data: "fold".to_owned() }).unwrap();
        for _ in 0..500 {
            clock.advance(CYCLE);
            (0..3).for_each(|_| core.cycle().unwrap());
        }
        let commands = commands.take();
        assert_eq!(commands[0].name, ["elbow_flex", "gripper"]);
        assert!((commands[0].position[1] - 0.5).abs() < 0.01, "it starts where the arm is");
        let end = commands.last().unwrap().position.iter().map(|angle| angle.to_degrees().round());
        assert_eq!(end.collect::<Vec<_>>(), [90.0, -10.0]);

        let refused = |motions: &str, further: &[(&str, &str)]| add(motions, further).err().unwrap();
        let beyond = refused(&fold.replace("-10", "-20"), &[]);
        assert!(beyond.contains("gripper = -20 is beyond the limits of the joint"), "{beyond}");
        let balancing = refused(&format!("[fold]\nbalance = {{ tilt = 0.5, rate = 0.1 }}\n{fold}"), &[]);
        assert!(balancing.contains("which only a humanoid can"), "{balancing}");
        assert!(refused(fold, &[("bus", "legs")]).contains("legs"));
        assert!(
            refused("[[sit.frame]]\nduration_s = 1.0\ndegrees = { knee = 90 }\n", &[])
                .contains("no joint \"knee\"")
        );
    }

    #[test]
    fn a_bad_file_is_refused_with_its_line() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(&file, "[nod]\n[[nod.frame]]\nduration_s = 1.0\ndegrees = { head = 10 }\n").unwrap();
        let path = file.path().to_str().unwrap().to_owned();
        let options =
            ModuleOptions { settings: [("file".to_owned(), path.into())].into(), ..ModuleOptions::default() };
        let refused = core_at_zero().0.add_with("motions", MotionPlayer::default(), options).unwrap_err();
        assert!(refused.to_string().contains(":4: there is no joint \"head\""), "{refused}");
    }
}
