//! What the vehicle is asked to do: set-points, which are streamed while a command is current, and modes,
//! which services ask for.

use std::time::Duration;

use downbeat_executor::{Context, Responder, Time};
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::geometry_msgs::msg::{PoseStamped, Twist, TwistStamped};
use downbeat_msgs::std_srvs::srv::{SetBoolRequest, SetBoolResponse, TriggerRequest, TriggerResponse};
use downbeat_servos::stamps::given_at;
use glam::{DQuat, DVec3};

use super::{Ports, Px4, REPORT_PERIOD};
use crate::clock::stamp_us;
use crate::frames;
use crate::requests::{Caller, Request, Stage};
use crate::wire::{self, COMPONENT, Command};

/// How long set-points are streamed before the module asks for offboard mode: PX4 wants more than 1 s.
const LEAD: Duration = Duration::from_millis(1_200);
/// How old the odometry may be whose heading turns a velocity into the world.
const LATEST_STATE: Duration = Duration::from_millis(500);

/// What the vehicle is asked to do, in the frames of ROS.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum SetPoint {
    /// In the level frame of the body: m/s, rad/s.
    Velocity { linear: DVec3, yaw_rate: f64 },
    /// In the frame of the odometry: m, rad.
    Pose { position: DVec3, yaw: f64 },
}

#[derive(Clone, Copy)]
pub(super) enum Mode {
    Offboard,
    Hold,
    Land,
}

/// When a command is sent.
enum Start {
    Now,
    WithStream,
}

impl Px4 {
    pub(super) fn on_stamped(&mut self, command: &TwistStamped, ctx: &Context<'_, Ports>) {
        if let Some(given) = self.given("cmd_vel", &command.header.stamp, ctx) {
            self.on_twist(&command.twist, given, ctx);
        }
    }

    /// When a command with this stamp was given, if it is current.
    fn given(&mut self, topic: &str, stamp: &Stamp, ctx: &Context<'_, Ports>) -> Option<Time> {
        let timeout = Duration::from_secs_f64(*ctx.get(ctx.ports.command_timeout));
        match given_at(stamp, ctx.now(), timeout) {
            Ok(given) => Some(given),
            Err(reason) => {
                self.stale.drop_for(topic, &reason);
                None
            }
        }
    }

    pub(super) fn on_twist(&mut self, twist: &Twist, given: Time, ctx: &Context<'_, Ports>) {
        let linear = DVec3::new(twist.linear.x, twist.linear.y, twist.linear.z);
        let yaw_rate = twist.angular.z;
        if linear.is_finite() && yaw_rate.is_finite() {
            self.asked = Some((given, SetPoint::Velocity { linear, yaw_rate }));
        } else {
            let what = "a command on cmd_vel is dropped: it has values that are not finite";
            self.complaints.set_point.say("cmd_vel", what, ctx);
        }
    }

    pub(super) fn on_pose(&mut self, message: &PoseStamped, ctx: &Context<'_, Ports>) {
        let Some(given) = self.given("setpoint_pose", &message.header.stamp, ctx) else { return };
        let (frame, expected) = (&message.header.frame_id, ctx.get(ctx.ports.odom_frame));
        if frame.trim_start_matches('/') != expected.trim_start_matches('/') {
            let what = format!(
                "a set-point on setpoint_pose is dropped: its frame is {frame:?}, and set-points are in {expected:?}; \
                 transform it first"
            );
            return self.complaints.set_point.say(frame, &what, ctx);
        }
        let position = &message.pose.position;
        let position = DVec3::new(position.x, position.y, position.z);
        let q = &message.pose.orientation;
        let rotation = DQuat::from_xyzw(q.x, q.y, q.z, q.w);
        if !position.is_finite() || !rotation.is_finite() || (rotation.length() - 1.0).abs() > 1e-2 {
            let what = "a set-point on setpoint_pose is dropped: its position is not finite, or its orientation no rotation";
            return self.complaints.set_point.say("numbers", what, ctx);
        }
        let yaw = frames::yaw(rotation.normalize());
        self.asked = Some((given, SetPoint::Pose { position, yaw }));
    }

    /// Streams the set-point that was asked for, if that is current.
    pub(super) fn stream(&mut self, ctx: &mut Context<'_, Ports>) {
        let timeout = Duration::from_secs_f64(*ctx.get(ctx.ports.command_timeout));
        let now = ctx.now();
        self.asked = self.asked.filter(|(given, _)| now <= *given + timeout);
        let is_streamed = match self.asked {
            Some((_, set_point)) => self.send(set_point, ctx),
            None => false,
        };
        match (is_streamed, self.streamed_since) {
            (true, None) => self.streamed_since = Some(now),
            (false, Some(_)) => {
                self.streamed_since = None;
                let is_in_offboard =
                    self.status.is_some_and(|(_, status)| status.nav_state == wire::STATE_OFFBOARD);
                if is_in_offboard {
                    tracing::warn!(
                        "{}: no current command, so set-points stop and PX4 leaves offboard mode",
                        ctx.module_name()
                    );
                }
            }
            _ => {}
        }
        self.enter_offboard(ctx);
        let patience = Duration::from_secs_f64(*ctx.get(ctx.ports.answer_timeout));
        let topic = ctx.ports.answers_topic.as_str();
        self.requests.refuse_late(topic, patience, ctx);
        if self.reported.is_none_or(|(at, level)| now >= at + REPORT_PERIOD || level != self.level(now).0) {
            self.report(ctx);
        }
    }

    /// Sends a set-point; returns false if that is impossible.
    fn send(&mut self, set_point: SetPoint, ctx: &mut Context<'_, Ports>) -> bool {
        let timestamp = stamp_us(ctx.now());
        let nothing = [f32::NAN; 3];
        let mut message = crate::v1_17::msg::TrajectorySetpoint {
            timestamp,
            position: nothing,
            velocity: nothing,
            acceleration: nothing,
            jerk: nothing,
            yaw: f32::NAN,
            yawspeed: f32::NAN,
        };
        let current = self.state.filter(|(at, _)| ctx.now().saturating_since(*at) <= LATEST_STATE);
        let Some((_, state)) = current.filter(|(_, state)| state.is_ned) else {
            let what = "set-points are in NED, and no odometry of the last 0.5 s says where that is: nothing is sent";
            self.complaints.set_point.say("heading", what, ctx);
            return false;
        };
        self.complaints.set_point.clear();
        let is_position = match set_point {
            SetPoint::Velocity { linear, yaw_rate } => {
                let level = DQuat::from_rotation_z(frames::yaw(state.world_from_body));
                message.velocity = frames::ned_enu(level * linear).as_vec3().into();
                message.yawspeed = -yaw_rate as f32;
                false
            }
            SetPoint::Pose { position, yaw } => {
                message.position = frames::ned_enu(position).as_vec3().into();
                message.yaw = frames::heading_ned_enu(yaw) as f32;
                true
            }
        };
        let ports = ctx.ports;
        (ports.control_mode)(ctx, (timestamp, is_position));
        ctx.publish(ports.set_point, message);
        true
    }

    pub(super) fn on_arm(
        &mut self,
        arm: bool,
        caller: Responder<SetBoolRequest, SetBoolResponse>,
        ctx: &mut Context<'_, Ports>,
    ) {
        let (what, param) = if arm { ("to arm", 1.0) } else { ("to disarm", 0.0) };
        self.ask(
            Caller::SetBool(caller),
            what,
            wire::COMPONENT_ARM_DISARM,
            [param, 0.0, 0.0],
            Start::Now,
            ctx,
        );
    }

    pub(super) fn on_trigger(
        &mut self,
        mode: Mode,
        caller: Responder<TriggerRequest, TriggerResponse>,
        ctx: &mut Context<'_, Ports>,
    ) {
        let caller = Caller::Trigger(caller);
        match mode {
            Mode::Offboard => {
                let params = [wire::CUSTOM_MODE, wire::MAIN_MODE_OFFBOARD, 0.0];
                self.ask(caller, "to enter offboard mode", wire::DO_SET_MODE, params, Start::WithStream, ctx);
            }
            Mode::Hold => {
                let params = [wire::CUSTOM_MODE, wire::MAIN_MODE_AUTO, wire::SUB_MODE_LOITER];
                self.ask(caller, "to hold", wire::DO_SET_MODE, params, Start::Now, ctx);
            }
            Mode::Land => self.ask(caller, "to land", wire::NAV_LAND, [0.0; 3], Start::Now, ctx),
        }
    }

    fn ask(
        &mut self,
        caller: Caller,
        what: &'static str,
        command: u32,
        params: [f32; 3],
        start: Start,
        ctx: &mut Context<'_, Ports>,
    ) {
        if self.requests.is_waiting(command) {
            let reason =
                format!("another request waits for PX4's answer to command {command}; ask again after it");
            return caller.answer(Err(reason), ctx);
        }
        let request = Request { caller, what, command, params, stage: Stage::WaitsForStream };
        match start {
            Start::Now => self.send_request(request, ctx),
            Start::WithStream if self.streamed_since.is_none() => {
                let reason = "no set-point is streamed, and PX4 enters offboard mode only with them: publish current commands on \
                              cmd_vel or setpoint_pose first, while the vehicle has an odometry";
                request.caller.answer(Err(reason.to_owned()), ctx);
            }
            Start::WithStream => {
                self.requests.push(request);
                self.enter_offboard(ctx);
            }
        }
    }

    /// Sends the request for offboard mode when it is time, or refuses it if set-points have stopped.
    fn enter_offboard(&mut self, ctx: &mut Context<'_, Ports>) {
        let is_time = self.streamed_since.is_none_or(|since| ctx.now() >= since + LEAD);
        let Some(request) = is_time.then(|| self.requests.take_waiting_for_stream()).flatten() else {
            return;
        };
        if self.streamed_since.is_some() {
            self.send_request(request, ctx);
        } else {
            let reason =
                "set-points have stopped before PX4 could enter offboard mode: commands have become too old";
            request.caller.answer(Err(reason.to_owned()), ctx);
        }
    }

    fn send_request(&mut self, mut request: Request, ctx: &mut Context<'_, Ports>) {
        let ports = ctx.ports;
        let patience = Duration::from_secs_f64(*ctx.get(ports.answer_timeout));
        let target_system = u8::try_from(*ctx.get(ports.system_id)).unwrap_or(u8::MAX);
        tracing::info!("{}: asks PX4 {}", ctx.module_name(), request.what);
        let (number, params) = (request.command, request.params);
        (ports.command)(ctx, Command { timestamp: stamp_us(ctx.now()), number, params, target_system });
        request.stage = Stage::Sent(ctx.now() + patience);
        self.requests.push(request);
    }

    pub(super) fn on_answer(
        &mut self,
        command: u32,
        answer: u8,
        [system, component]: [u16; 2],
        ctx: &mut Context<'_, Ports>,
    ) {
        // Answers to other senders, such as a ground station, are on the same topic.
        let is_ours = i64::from(system) == *ctx.get(ctx.ports.system_id) && component == u16::from(COMPONENT);
        if is_ours {
            let patience = Duration::from_secs_f64(*ctx.get(ctx.ports.answer_timeout));
            self.requests.on_answer(command, answer, patience, ctx);
        }
    }
}
