//! Follows trajectories of joints, as the `joint_trajectory_controller` of ros2_control does.
//!
//! `NAME` is the name of the module:
//!
//! | name | type | |
//! | --- | --- | --- |
//! | `NAME/follow_joint_trajectory` | action control_msgs/FollowJointTrajectory | a trajectory with tolerances; a new goal replaces the one before, which is aborted |
//! | `NAME/joint_trajectory` (in) | trajectory_msgs/JointTrajectory | a trajectory without an answer |
//! | `NAME/controller_state` | control_msgs/JointTrajectoryControllerState | reference, feedback and error of all joints |
//! | `joint_states` (in) | sensor_msgs/JointState | rad or m |
//! | `joint_commands` | sensor_msgs/JointState | positions and velocities of all its joints, at `rate_hz`, from the first trajectory on |
//!
//! | setting | default | |
//! | --- | --- | --- |
//! | `joints` | | names of the joints |
//! | `rate_hz` | 125 | rate of commands |
//! | `state_rate_hz` | 25 | rate of the state and of feedback |
//! | `allow_partial_joints_goal` | false | trajectories may name some of the joints |
//! | `allow_nonzero_velocity_at_trajectory_end` | false | |
//! | `stamp_timeout` | 0.5 | s by which the stamp of a trajectory may lie in the past; 0 any |
//! | `state_timeout` | 1.5 | s without a fresh measured position of a joint after which a trajectory is given up, by the stamps of `joint_states`; 0 any |
//! | `max_deceleration` | 10 | rad/s² or m/s² with which joints in motion brake that a new trajectory would let swing, and join a late one |
//! | `constraints.goal_time` | 0 | s that the joints have to reach the goal after the end of the trajectory; 0 waits |
//! | `constraints.stopped_velocity_tolerance` | 0.01 | rad/s or m/s at the goal; 0 is not checked |
//! | `constraints.JOINT.trajectory`, `constraints.JOINT.goal` | 0 | tolerance of the position on the way and at the goal, rad or m; 0 is not checked |
//!
//! A trajectory begins at its stamp, or at once if that is zero; one whose stamp is older than
//! `stamp_timeout`, or more than a minute ahead, is refused: its beginning would be skipped, or the clocks
//! differ. It begins from the command so far, so that a replaced trajectory causes no jump; without one, and
//! after an activation, from the measured position. Joints in motion that would swing on the way to the first
//! point brake first, and a trajectory that is late, or whose first point is at its start, is joined without
//! a jump ([`motion`](super::motion)); its goal is then reached later if the way to its end is too long for
//! the time that is left. A goal that is cancelled or aborted holds the position in
//! which it ends. Deactivating the controller aborts its goal. Tolerances in a goal replace those of the
//! settings: 0 leaves them, -1 removes them.
//!
//! A position is fresh for `state_timeout`. Without a fresh position of each joint no trajectory begins, and
//! one under way is given up: whether its joints follow is not known then. The command stays where it was.
//! A joint whose position is fresh again afterwards is commanded to stay where it is, since a servo without
//! power may have been turned. A position is not fresh if `joint_states` has neither velocity nor effort
//! beside it but has one of them for other joints, as `servo_bus` shows servos that do not answer.
//!
//! Differences from ros2_control: only positions are commanded, with the velocity beside them; trajectories
//! of velocities alone are refused; `open_loop_control`, speed scaling, and joints of several degrees of
//! freedom do not exist.
//!
//! # References
//! `joint_trajectory_controller` of `ros-controls/ros2_controllers`, branch jazzy: `doc/userdoc.rst`,
//! `src/joint_trajectory_controller.cpp`.

use std::time::Duration;

use super::claims::OwnClaims;
use super::motion::Motion;
use super::spline::{Allowed, JointSample, Trajectory, TrajectoryError};
use super::{is_fresh, joint_names, own};
use crate::stamps::{Stale, header};
use crate::step::standstill;
use downbeat_actions::{ActionServer, CancelResponse, GoalId, GoalResponse};
use downbeat_executor::{
    Context, Module, Publication, Received, Setting, Setup, SetupError, Time, TransitionError,
};
use downbeat_msgs::builtin_interfaces::msg::Duration as DurationMessage;
use downbeat_msgs::control_msgs::action::{
    FollowJointTrajectory, FollowJointTrajectoryFeedback, FollowJointTrajectoryGoal,
    FollowJointTrajectoryResult,
};
use downbeat_msgs::control_msgs::msg::{JointTolerance, JointTrajectoryControllerState};
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::trajectory_msgs::msg::{JointTrajectory, JointTrajectoryPoint};

/// Follows trajectories of joints; see the [module page](self).
#[derive(Debug, Default)]
pub struct JointTrajectoryController {
    server: ActionServer<FollowJointTrajectory>,
    joints: Vec<String>,
    /// The last fresh measurement of each joint; `None` before the first one.
    measured: Vec<Option<Measured>>,
    /// What is commanded; empty before the first trajectory.
    commanded: Vec<JointSample>,
    following: Option<Following>,
    last_state: Option<Time>,
    stale: Stale,
    claims: OwnClaims,
}

/// How far ahead a trajectory may begin.
const LONGEST_WAIT: Duration = Duration::from_secs(60);

/// A measurement of a joint.
#[derive(Clone, Copy, Debug)]
struct Measured {
    state: JointSample,
    /// By the stamp, and never later than the message came.
    at: Time,
}

/// A trajectory on its way.
#[derive(Debug)]
struct Following {
    motion: Motion,
    start: Time,
    last: Time,
    /// `None` for one that came from the topic.
    goal: Option<GoalId>,
    tolerances: Tolerances,
}

/// How far joints may be from the trajectory; 0 for any distance. By joint.
#[derive(Clone, Debug, Default, PartialEq)]
struct Tolerances {
    path: Vec<Tolerance>,
    goal: Vec<Tolerance>,
    goal_time: Duration,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Tolerance {
    position: f64,
    velocity: f64,
}

/// The keys of [`JointTrajectoryController`].
pub struct Ports {
    commands: Publication<JointState>,
    state: Publication<JointTrajectoryControllerState>,
    state_rate_hz: Setting<f64>,
    allow_partial: Setting<bool>,
    allow_moving_end: Setting<bool>,
    stamp_timeout: Setting<f64>,
    state_timeout: Setting<f64>,
    max_deceleration: Setting<f64>,
    goal_time: Setting<f64>,
    stopped_velocity: Setting<f64>,
    /// Of the position on the way and at the goal, by joint.
    constraints: Vec<[Setting<f64>; 2]>,
}

impl JointTrajectoryController {
    fn on_joint_states(&mut self, state: Received<'_, JointState>, ctx: &mut Context<'_, Ports>) {
        let (now, stamp) = (ctx.now(), Time::from_nanos(state.header.stamp.as_nanos()));
        let at = if stamp == Time::ZERO { now } else { stamp.min(now) };
        for (index, name) in state.name.iter().enumerate().filter(|(index, _)| is_fresh(&state, *index)) {
            let Some(joint) = self.joints.iter().position(|joint| joint == name) else { continue };
            let Some(position) = state.position.get(index).copied() else { continue };
            let velocity = state.velocity.get(index).copied().filter(|velocity| velocity.is_finite());
            let measured = JointSample { position, velocity: velocity.unwrap_or(0.0), acceleration: 0.0 };
            let before = self.measured[joint].replace(Measured { state: measured, at });
            let was_stale = before.is_some_and(|before| self.is_too_old(before.at, now, ctx));
            if was_stale && self.following.is_none() && !self.is_too_old(at, now, ctx) {
                // Its servo may have had no power and been turned meanwhile: it stays where it is now.
                if let Some(command) = self.commanded.get_mut(joint) {
                    *command = JointSample { position, ..JointSample::default() };
                }
            }
        }
    }

    /// Whether a measurement from `at` is too old to tell where a joint is.
    fn is_too_old(&self, at: Time, now: Time, ctx: &Context<'_, Ports>) -> bool {
        let timeout_s = *ctx.get(ctx.ports.state_timeout);
        timeout_s > 0.0 && now.saturating_since(at) > Duration::from_secs_f64(timeout_s)
    }

    /// The first joint without a fresh position, as the reason for which it cannot follow a trajectory.
    fn without_state(&self, ctx: &Context<'_, Ports>) -> Result<(), Refusal> {
        let now = ctx.now();
        for (measured, joint) in self.measured.iter().zip(&self.joints) {
            let joint = joint.clone();
            let Some(Measured { at, .. }) = *measured else { return Err(Refusal::Unknown { joint }) };
            if self.is_too_old(at, now, ctx) {
                let age_s = now.saturating_since(at).as_secs_f64();
                let timeout_s = *ctx.get(ctx.ports.state_timeout);
                return Err(Refusal::NotFresh { joint, age_s, timeout_s });
            }
        }
        Ok(())
    }

    fn on_trajectory(&mut self, message: Received<'_, JointTrajectory>, ctx: &mut Context<'_, Ports>) {
        match self.follow(&message, None, ctx) {
            Ok(()) => {}
            Err(refusal @ (Refusal::Old { .. } | Refusal::Ahead { .. })) => {
                self.stale.drop_for("joint_trajectory", &refusal.to_string());
            }
            Err(refusal) => tracing::warn!("a trajectory from the topic is not followed: {refusal}"),
        }
    }

    fn on_goal(&mut self, goal: &FollowJointTrajectoryGoal, ctx: &Context<'_, Ports>) -> GoalResponse {
        match self.check(&goal.trajectory, ctx) {
            Ok(_) => GoalResponse::AcceptAndExecute,
            Err(refusal) => {
                if let Refusal::Old { .. } | Refusal::Ahead { .. } = refusal {
                    self.stale.drop_for("follow_joint_trajectory", &refusal.to_string());
                } else {
                    tracing::warn!("a goal is rejected: {refusal}");
                }
                GoalResponse::Reject
            }
        }
    }

    fn on_accepted(&mut self, id: GoalId, ctx: &mut Context<'_, Ports>) {
        let Some(goal) = self.server.goal(id).map(|goal| goal.goal().trajectory.clone()) else { return };
        // It was checked in the same run.
        if let Err(refusal) = self.follow(&goal, Some(id), ctx) {
            self.abort(id, FollowJointTrajectoryResult::INVALID_GOAL, refusal.to_string(), ctx);
        }
    }

    fn on_canceling(&mut self, id: GoalId, ctx: &mut Context<'_, Ports>) {
        if self.following.as_ref().is_some_and(|following| following.goal == Some(id)) {
            self.hold();
        }
        report(self.server.canceled(ctx, id, FollowJointTrajectoryResult::default()));
    }

    /// The trajectory, its start and the state in which it would begin.
    fn check(
        &self,
        message: &JointTrajectory,
        ctx: &Context<'_, Ports>,
    ) -> Result<(Trajectory, Time, Vec<JointSample>), Refusal> {
        let ports = ctx.ports;
        let allowed =
            Allowed { partial: *ctx.get(ports.allow_partial), moving_end: *ctx.get(ports.allow_moving_end) };
        let trajectory = Trajectory::new(message, &self.joints, allowed)?;
        self.without_state(ctx)?;
        let begin = match self.commanded.is_empty() {
            false => self.commanded.clone(),
            true => self.measured_state().unwrap_or_default(),
        };
        let stamp = Time::from_nanos(message.header.stamp.as_nanos());
        let start = if stamp == Time::ZERO { ctx.now() } else { stamp };
        if start + trajectory.duration() < ctx.now() {
            let late = ctx.now().saturating_since(start + trajectory.duration());
            return Err(Refusal::Past { late_s: late.as_secs_f64() });
        }
        let (age, ahead) = (ctx.now().saturating_since(start), start.saturating_since(ctx.now()));
        let timeout_s = *ctx.get(ports.stamp_timeout);
        if timeout_s > 0.0 && age > Duration::from_secs_f64(timeout_s) {
            return Err(Refusal::Old { age_s: age.as_secs_f64(), timeout_s });
        }
        if ahead > LONGEST_WAIT {
            return Err(Refusal::Ahead { ahead_s: ahead.as_secs_f64(), most_s: LONGEST_WAIT.as_secs() });
        }
        Ok((trajectory, start, begin))
    }

    fn follow(
        &mut self,
        message: &JointTrajectory,
        goal: Option<GoalId>,
        ctx: &mut Context<'_, Ports>,
    ) -> Result<(), Refusal> {
        let (trajectory, start, begin) = self.check(message, ctx)?;
        let tolerances = self.tolerances(goal, ctx);
        if let Some(before) = self.following.take().and_then(|before| before.goal) {
            let reason = "a new trajectory has replaced it";
            self.abort(before, FollowJointTrajectoryResult::SUCCESSFUL, reason.to_owned(), ctx);
        }
        let (now, deceleration) = (ctx.now(), *ctx.get(ctx.ports.max_deceleration));
        let motion = Motion::new(trajectory, &begin, seconds_after(start, now), deceleration);
        self.commanded = begin;
        self.following = Some(Following { motion, start, last: now, goal, tolerances });
        Ok(())
    }

    /// The tolerances of the settings, and of the goal where it has some.
    fn tolerances(&self, goal: Option<GoalId>, ctx: &Context<'_, Ports>) -> Tolerances {
        let velocity = *ctx.get(ctx.ports.stopped_velocity);
        let of = |which: usize, velocity: f64| {
            let constraints = ctx.ports.constraints.iter();
            constraints.map(|keys| Tolerance { position: *ctx.get(keys[which]), velocity }).collect()
        };
        let goal_time = Duration::from_secs_f64(*ctx.get(ctx.ports.goal_time));
        let mut tolerances = Tolerances { path: of(0, 0.0), goal: of(1, velocity), goal_time };
        if let Some(goal) = goal.and_then(|id| self.server.goal(id)).map(|goal| goal.goal()) {
            apply(&goal.path_tolerance, &self.joints, &mut tolerances.path);
            apply(&goal.goal_tolerance, &self.joints, &mut tolerances.goal);
            let goal_time = u64::try_from(goal.goal_time_tolerance.as_nanos()).unwrap_or(0);
            if goal_time > 0 {
                tolerances.goal_time = Duration::from_nanos(goal_time);
            }
        }
        tolerances
    }

    fn tick(&mut self, ctx: &mut Context<'_, Ports>) {
        if !self.claims.are_granted(ctx) {
            return;
        }
        self.advance(ctx);
        if !self.commanded.is_empty() {
            let mut command = JointState { header: header(ctx.now(), ""), ..JointState::default() };
            command.name.clone_from(&self.joints);
            command.position.extend(self.commanded.iter().map(|state| state.position));
            command.velocity.extend(self.commanded.iter().map(|state| state.velocity));
            ctx.publish(ctx.ports.commands, command);
        }
        let period = Duration::from_secs_f64(1.0 / *ctx.get(ctx.ports.state_rate_hz));
        if self.last_state.is_none_or(|last| ctx.now() >= last + period) {
            self.last_state = Some(ctx.now());
            self.publish_state(ctx);
        }
    }

    /// Moves the command on along the trajectory, and ends it where it ends.
    fn advance(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        if let Some(following) = &mut self.following {
            let pause = standstill(std::mem::replace(&mut following.last, now), now);
            following.start = following.start + pause;
            // Nothing was measured in the pause either.
            for measured in self.measured.iter_mut().flatten() {
                measured.at = (measured.at + pause).min(now);
            }
        }
        let Some(following) = &self.following else { return };
        if let Err(reason) = self.without_state(ctx) {
            let is_over = now >= following.start + following.motion.duration();
            let code = match is_over {
                true => FollowJointTrajectoryResult::GOAL_TOLERANCE_VIOLATED,
                false => FollowJointTrajectoryResult::PATH_TOLERANCE_VIOLATED,
            };
            return self.give_up(following.goal, code, reason.to_string(), ctx);
        }
        let Following { motion, start, goal, tolerances, .. } = following;
        let end = *start + motion.duration();
        motion.sample(seconds_after(*start, now), &mut self.commanded);
        let (commanded, measured) = (&self.commanded, self.measured_state());
        let Some(measured) = measured else { return };
        let outside = |tolerances: &[Tolerance]| violation(&self.joints, commanded, &measured, tolerances);
        let (goal, is_over) = (*goal, now >= end);
        if !is_over {
            if let Some(violation) = outside(&tolerances.path) {
                self.give_up(goal, FollowJointTrajectoryResult::PATH_TOLERANCE_VIOLATED, violation, ctx);
            }
            return;
        }
        let late = now.saturating_since(end);
        match outside(&tolerances.goal) {
            None => {
                self.following = None;
                if let Some(id) = goal {
                    let result = FollowJointTrajectoryResult {
                        error_string: "the goal is reached".to_owned(),
                        ..FollowJointTrajectoryResult::default()
                    };
                    report(self.server.succeed(ctx, id, result));
                }
            }
            Some(violation) if tolerances.goal_time > Duration::ZERO && late > tolerances.goal_time => {
                let violation =
                    format!("{violation}, {:.3} s after the end of the trajectory", late.as_secs_f64());
                self.give_up(goal, FollowJointTrajectoryResult::GOAL_TOLERANCE_VIOLATED, violation, ctx);
            }
            // A trajectory of the topic has nobody who waits for it to be reached.
            Some(_) if goal.is_none() => self.following = None,
            Some(_) => {}
        }
    }

    fn give_up(&mut self, goal: Option<GoalId>, code: i32, reason: String, ctx: &mut Context<'_, Ports>) {
        tracing::warn!("a trajectory is given up: {reason}");
        self.hold();
        if let Some(id) = goal {
            self.abort(id, code, reason, ctx);
        }
    }

    /// Stays where the command is.
    fn hold(&mut self) {
        self.following = None;
        for state in &mut self.commanded {
            *state = JointSample { position: state.position, ..JointSample::default() };
        }
    }

    fn abort(&mut self, id: GoalId, error_code: i32, error_string: String, ctx: &mut Context<'_, Ports>) {
        let result = FollowJointTrajectoryResult { error_code, error_string };
        report(self.server.abort(ctx, id, result));
    }

    /// `None` while the position of a joint is not known.
    fn measured_state(&self) -> Option<Vec<JointSample>> {
        self.measured.iter().map(|measured| Some(measured.as_ref()?.state)).collect()
    }

    fn publish_state(&self, ctx: &mut Context<'_, Ports>) {
        let Some(measured) = self.measured_state() else { return };
        let reference = if self.commanded.is_empty() { &measured } else { &self.commanded };
        let since_start = self.following.as_ref().map_or(Duration::ZERO, |following| {
            ctx.now().saturating_since(following.start).min(following.motion.duration())
        });
        let point = |states: &[JointSample]| point(states, since_start);
        let error: Vec<_> =
            reference.iter().zip(&measured).map(|(to, from)| difference(*to, *from)).collect();
        let (reference, feedback, error) = (point(reference), point(&measured), point(&error));
        if let Some(id) = self.following.as_ref().and_then(|following| following.goal) {
            let feedback = FollowJointTrajectoryFeedback {
                header: header(ctx.now(), ""),
                joint_names: self.joints.clone(),
                desired: reference.clone(),
                actual: feedback.clone(),
                error: error.clone(),
                ..FollowJointTrajectoryFeedback::default()
            };
            report(self.server.publish_feedback(ctx, id, feedback));
        }
        let state = JointTrajectoryControllerState {
            header: header(ctx.now(), ""),
            joint_names: self.joints.clone(),
            output: reference.clone(),
            reference,
            feedback,
            error,
            speed_scaling_factor: 1.0,
            ..JointTrajectoryControllerState::default()
        };
        ctx.publish(ctx.ports.state, state);
    }
}

impl Module for JointTrajectoryController {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        self.joints = joint_names(setup, "joints", "names of the joints, as `joint_states` has them")?;
        self.measured = vec![None; self.joints.len()];
        let rate_hz: Setting<f64> =
            setup.read_only_setting("rate_hz", 125.0, "Hz; how often joints are commanded")?;
        let rate = setup.value(rate_hz).copied().unwrap_or(0.0);
        if !(1.0..=10_000.0).contains(&rate) {
            return Err(setup.refuse_value(rate_hz, format!("{rate} Hz is not within 1 and 10000 Hz")));
        }
        let mut constraints = Vec::with_capacity(self.joints.len());
        for joint in &self.joints {
            let mut tolerance = |part: &str, when: &str| {
                let description =
                    format!("rad or m; largest distance of {joint} from the trajectory {when}; 0 for any");
                setup.setting_in(&format!("constraints.{joint}.{part}"), 0.0, 0.0..=1e6, &description)
            };
            constraints.push([tolerance("trajectory", "on the way")?, tolerance("goal", "at the goal")?]);
        }
        let (trajectories, state) = (own(setup, "joint_trajectory"), own(setup, "controller_state"));
        let ports = Ports {
            commands: setup.publish("joint_commands")?,
            state: setup.publish(&state)?,
            state_rate_hz: setup.setting_in(
                "state_rate_hz",
                25.0,
                0.1..=10_000.0,
                "Hz; rate of state and feedback",
            )?,
            allow_partial: setup.setting(
                "allow_partial_joints_goal",
                false,
                "trajectories may name some of the joints; the others hold their positions",
            )?,
            allow_moving_end: setup.setting(
                "allow_nonzero_velocity_at_trajectory_end",
                false,
                "trajectories may end in motion; the joints stop there at once",
            )?,
            stamp_timeout: setup.setting_in(
                "stamp_timeout",
                0.5,
                0.0..=3600.0,
                "s; by how much the stamp of a trajectory may lie in the past; 0 for any",
            )?,
            state_timeout: setup.setting_in(
                "state_timeout",
                // `servo_bus` asks a servo that has missed two answers again after a second.
                1.5,
                0.0..=3600.0,
                "s; how old the last fresh position of a joint may be while it follows a trajectory; 0 for any",
            )?,
            max_deceleration: setup.setting_in(
                "max_deceleration",
                10.0,
                0.1..=1e4,
                "rad/s² or m/s²; with which joints brake that a new trajectory would let swing, and join a late one",
            )?,
            goal_time: setup.setting_in(
                "constraints.goal_time",
                0.0,
                0.0..=3600.0,
                "s; time to reach the goal after the end of the trajectory; 0 waits without limit",
            )?,
            stopped_velocity: setup.setting_in(
                "constraints.stopped_velocity_tolerance",
                0.01,
                0.0..=1e6,
                "rad/s or m/s; largest velocity at the goal; 0 for any",
            )?,
            constraints,
        };
        setup.subscribe("joint_states", Self::on_joint_states)?;
        setup.subscribe(&trajectories, Self::on_trajectory)?;
        let action = own(setup, "follow_joint_trajectory");
        ActionServer::builder(|module: &mut Self| &mut module.server)
            .on_goal(|module, _, goal, ctx| module.on_goal(goal, ctx))
            .on_accepted(Self::on_accepted)
            .on_cancel(|_, _, _| CancelResponse::Accept)
            .on_canceling(Self::on_canceling)
            .declare(setup, &action, &mut self.server)?;
        setup.every(Duration::from_secs_f64(1.0 / rate), Self::tick)?;
        self.claims = OwnClaims::declare(setup, "joint_commands", &self.joints);
        Ok(ports)
    }

    fn activate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        self.claims.take(ctx)?;
        // Joints may have been elsewhere since: the first trajectory begins where they are now.
        self.commanded.clear();
        self.measured.fill(None);
        Ok(())
    }

    fn deactivate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        if let Some(goal) = self.following.take().and_then(|following| following.goal) {
            let reason = "the controller was deactivated".to_owned();
            self.abort(goal, FollowJointTrajectoryResult::SUCCESSFUL, reason, ctx);
        }
        self.claims.give_back(ctx);
        Ok(())
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}

/// Why a trajectory is not begun.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    #[error("the trajectory ended {late_s:.3} s ago; use a later stamp, or a stamp of 0 to begin at once")]
    Past { late_s: f64 },
    #[error(
        "its stamp is {age_s:.3} s old, more than the stamp_timeout of {timeout_s} s; use a stamp of 0 to begin at once"
    )]
    Old { age_s: f64, timeout_s: f64 },
    #[error(
        "its stamp is {ahead_s:.3} s in the future, more than {most_s} s; check the clocks, or use a stamp of 0"
    )]
    Ahead { ahead_s: f64, most_s: u64 },
    #[error(
        "the position of the joint \"{joint}\" is not known: `joint_states` has had no fresh one yet; see in `diagnostics` whether \
         its servo answers, and whether the module of the hardware runs"
    )]
    Unknown { joint: String },
    #[error(
        "the last fresh position of the joint \"{joint}\" is {age_s:.3} s old, more than the state_timeout of {timeout_s} s, and \
         the arm holds its position: its servo does not answer, or `joint_states` stopped. See `diagnostics`, check cable, power and \
         clocks, then send a new goal"
    )]
    NotFresh { joint: String, age_s: f64, timeout_s: f64 },
}

/// Puts the tolerances of a goal in place of those of the settings: 0 leaves them, negative values remove
/// them.
fn apply(given: &[JointTolerance], joints: &[String], tolerances: &mut [Tolerance]) {
    let value = |given: f64, known: &mut f64| match given {
        given if given > 0.0 => *known = given,
        given if given < 0.0 => *known = 0.0,
        _ => {}
    };
    for tolerance in given {
        if let Some(joint) = joints.iter().position(|joint| *joint == tolerance.name) {
            value(tolerance.position, &mut tolerances[joint].position);
            value(tolerance.velocity, &mut tolerances[joint].velocity);
        }
    }
}

/// The first joint that is outside of its tolerance, as a sentence.
fn violation(
    joints: &[String],
    commanded: &[JointSample],
    measured: &[JointSample],
    tolerances: &[Tolerance],
) -> Option<String> {
    let states = commanded.iter().zip(measured).zip(tolerances).zip(joints);
    states.into_iter().find_map(|(((to, from), tolerance), joint)| {
        let error = difference(*to, *from);
        let is_outside = |error: f64, tolerance: f64| tolerance > 0.0 && error.abs() > tolerance;
        if is_outside(error.position, tolerance.position) {
            let (error, most) = (error.position, tolerance.position);
            return Some(format!(
                "the position of the joint \"{joint}\" is off by {error:.4}, at most {most} is allowed"
            ));
        }
        if is_outside(error.velocity, tolerance.velocity) {
            let (error, most) = (error.velocity, tolerance.velocity);
            return Some(format!(
                "the velocity of the joint \"{joint}\" is off by {error:.4}, at most {most} is allowed"
            ));
        }
        None
    })
}

/// Negative before `start`.
fn seconds_after(start: Time, now: Time) -> f64 {
    now.saturating_since(start).as_secs_f64() - start.saturating_since(now).as_secs_f64()
}

fn difference(to: JointSample, from: JointSample) -> JointSample {
    JointSample {
        position: to.position - from.position,
        velocity: to.velocity - from.velocity,
        acceleration: to.acceleration - from.acceleration,
    }
}

fn point(states: &[JointSample], since_start: Duration) -> JointTrajectoryPoint {
    JointTrajectoryPoint {
        positions: states.iter().map(|state| state.position).collect(),
        velocities: states.iter().map(|state| state.velocity).collect(),
        accelerations: states.iter().map(|state| state.acceleration).collect(),
        time_from_start: DurationMessage::from_nanos(
            i64::try_from(since_start.as_nanos()).unwrap_or(i64::MAX),
        ),
        ..JointTrajectoryPoint::default()
    }
}

/// A goal that is ended or given feedback twice is a fault of this module; it must not stop the joints.
fn report(outcome: Result<(), downbeat_actions::GoalError>) {
    if let Err(error) = outcome {
        tracing::error!("{error}");
    }
}

#[cfg(test)]
mod tests;
