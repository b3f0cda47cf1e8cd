//! The module [`Px4`]: what comes from the autopilot, and its report.

mod offboard;

use std::time::Duration;

use downbeat_executor::{
    Context, Module, Publication, Received, Setting, Setup, SetupError, Time, TransitionError,
};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus, KeyValue};
use downbeat_msgs::geometry_msgs::msg::{PoseStamped, TransformStamped, Twist, TwistStamped};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::sensor_msgs::msg::{BatteryState, Imu};
use downbeat_msgs::std_srvs::srv::{SetBoolRequest, SetBoolResponse, TriggerRequest, TriggerResponse};
use downbeat_msgs::tf2_msgs::msg::TFMessage;
use downbeat_servos::stamps::{Stale, header};
use offboard::{Mode, SetPoint};

use crate::clock::{PilotClock, TimeSource};
use crate::release::Release;
use crate::requests::Requests;
use crate::standard::{self, Battery, State};
use crate::wire::{self, COMPONENT, Command, release_setting, with_messages_of};

/// A PX4 autopilot behind a uXRCE-DDS agent: its messages as standard ones of ROS, set-points and commands.
///
/// | topic | type | |
/// | --- | --- | --- |
/// | `odom` | nav_msgs/Odometry | pose in ENU, twist in FLU, from `vehicle_odometry` |
/// | `tf` | tf2_msgs/TFMessage | the same, unless `enable_odom_tf` is false |
/// | `imu/data_raw` | sensor_msgs/Imu | in FLU, without orientation, from `sensor_combined` |
/// | `battery_state` | sensor_msgs/BatteryState | from `battery_status` |
/// | `diagnostics` | diagnostic_msgs/DiagnosticArray | mode, armed, failsafe, time, set-points; once a second, and when the level changes |
/// | `cmd_vel` (in) | geometry_msgs/Twist, or TwistStamped with `use_stamped_vel` | velocity in the level frame of the body, m/s: x forward, y left, z up; `angular.z` in rad/s, to the left |
/// | `setpoint_pose` (in) | geometry_msgs/PoseStamped | position and heading in the frame `odom_frame_id` |
/// | `fmu/out/...` (in) | px4_msgs | `vehicle_odometry`, `vehicle_status`, `vehicle_command_ack`, `sensor_combined`, `battery_status`, `timesync_status`, with the version of the release in the name |
/// | `fmu/in/...` | px4_msgs | `offboard_control_mode`, `trajectory_setpoint`, `vehicle_command` |
///
/// | service | type | |
/// | --- | --- | --- |
/// | `arm` | std_srvs/SetBool | arms, or disarms |
/// | `offboard` | std_srvs/Trigger | offboard mode, as soon as set-points have been streamed for long enough |
/// | `hold` | std_srvs/Trigger | hold mode, which ends offboard control |
/// | `land` | std_srvs/Trigger | land here |
///
/// Each is answered when PX4 has answered. Nothing is armed, and no mode is changed, without a request.
/// Set-points are streamed only while a command is not older than `command_timeout`; when they stop, PX4
/// leaves offboard mode as its parameters COM_OF_LOSS_T and COM_OBL_RC_ACT say.
#[derive(Debug, Default)]
pub struct Px4 {
    release: Release,
    clock: PilotClock,
    /// The last state of the vehicle and when it came.
    state: Option<(Time, State)>,
    resets: Option<u8>,
    status: Option<(Time, Status)>,
    /// The last command and when it was given.
    asked: Option<(Time, SetPoint)>,
    stale: Stale,
    streamed_since: Option<Time>,
    requests: Requests,
    complaints: Complaints,
    reported: Option<(Time, u8)>,
}

/// What `VehicleStatus` says in all releases.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Status {
    nav_state: u8,
    is_armed: bool,
    has_failsafe: bool,
    passes_checks: bool,
}

/// What was already said in the log, so that it is said once until it is over; and how often it happened.
#[derive(Debug, Default)]
struct Complaints {
    odometry: Complaint,
    stamp: Complaint,
    set_point: Complaint,
}

#[derive(Debug, Default)]
struct Complaint {
    text: String,
    count: u64,
}

impl Complaint {
    /// Logs a problem unless it is the same kind as before. `kind` is without numbers that change.
    fn say<P>(&mut self, kind: &str, what: &str, ctx: &Context<'_, P>) {
        self.count += 1;
        if self.text != kind {
            tracing::warn!("{}: {what}; further ones are counted in diagnostics", ctx.module_name());
            kind.clone_into(&mut self.text);
        }
    }

    fn clear(&mut self) {
        self.text.clear();
    }
}

/// Publishes what has another Rust type in each release.
type Send<T> = Box<dyn Fn(&mut Context<'_, Ports>, T) + std::marker::Send + Sync>;

/// The keys of [`Px4`].
pub struct Ports {
    odom: Publication<Odometry>,
    tf: Publication<TFMessage>,
    imu: Publication<Imu>,
    battery: Publication<BatteryState>,
    diagnostics: Publication<DiagnosticArray>,
    command: Send<Command>,
    /// The stamp, and whether the position is controlled, not the velocity.
    control_mode: Send<(u64, bool)>,
    set_point: Publication<crate::v1_17::msg::TrajectorySetpoint>,
    command_timeout: Setting<f64>,
    answer_timeout: Setting<f64>,
    system_id: Setting<i64>,
    odom_frame: Setting<String>,
    base_frame: Setting<String>,
    imu_frame: Setting<String>,
    enable_tf: Setting<bool>,
    answers_topic: String,
}

/// Without a status for so long the autopilot is not there: it publishes it at 1 Hz or more.
const SILENCE: Duration = Duration::from_secs(3);
const REPORT_PERIOD: Duration = Duration::from_secs(1);

impl Px4 {
    /// The time of a stamp of PX4; `None` for one that cannot be used.
    fn time_of(&mut self, stamp: u64, topic: &str, ctx: &Context<'_, Ports>) -> Option<Time> {
        let steps = self.clock.steps();
        let found = self.clock.time_of(stamp, ctx.now());
        if self.clock.steps() != steps {
            tracing::warn!(
                "{}: the stamps of PX4 follow another clock from now on ({}); has the autopilot restarted?",
                ctx.module_name(),
                source_name(self.clock.source())
            );
        }
        match found {
            Ok(time) => {
                self.complaints.stamp.clear();
                Some(time)
            }
            Err(refused) => {
                let what = format!("a message on {topic} is dropped: {refused}");
                self.complaints.stamp.say(topic, &what, ctx);
                None
            }
        }
    }

    fn on_odometry(&mut self, message: &crate::v1_17::msg::VehicleOdometry, ctx: &mut Context<'_, Ports>) {
        let Some(stamp) = self.time_of(message.timestamp, "fmu/out/vehicle_odometry", ctx) else { return };
        let ports = ctx.ports;
        let names = [ctx.get(ports.odom_frame).as_str(), ctx.get(ports.base_frame).as_str()];
        let (odometry, state) = match standard::odometry(message, stamp, names) {
            Ok(found) => found,
            Err(refused) => {
                let reason = refused.to_string();
                let what = format!("fmu/out/vehicle_odometry is dropped: {reason}");
                self.complaints.odometry.say(&reason, &what, ctx);
                return;
            }
        };
        self.complaints.odometry.clear();
        if self.resets.replace(message.reset_counter).is_some_and(|before| before != message.reset_counter) {
            tracing::info!("{}: the estimator of PX4 was reset, so `odom` may jump", ctx.module_name());
        }
        self.state = Some((ctx.now(), state));
        if *ctx.get(ports.enable_tf) {
            let mut transform = TransformStamped {
                header: odometry.header.clone(),
                child_frame_id: odometry.child_frame_id.clone(),
                ..TransformStamped::default()
            };
            transform.transform.translation = standard::vector3(state.position);
            transform.transform.rotation = odometry.pose.pose.orientation;
            ctx.publish(ports.tf, TFMessage { transforms: vec![transform] });
        }
        ctx.publish(ports.odom, odometry);
    }

    fn on_sensors(&mut self, message: &crate::v1_17::msg::SensorCombined, ctx: &mut Context<'_, Ports>) {
        let Some(stamp) = self.time_of(message.timestamp, "fmu/out/sensor_combined", ctx) else { return };
        if let Some(imu) = standard::imu(message, stamp, ctx.get::<String>(ctx.ports.imu_frame)) {
            ctx.publish(ctx.ports.imu, imu);
        }
    }

    fn on_battery(&mut self, stamp: u64, battery: &Battery, ctx: &mut Context<'_, Ports>) {
        let Some(stamp) = self.time_of(stamp, "fmu/out/battery_status", ctx) else { return };
        ctx.publish(ctx.ports.battery, standard::battery_state(battery, stamp));
    }

    fn on_status(&mut self, status: Status, ctx: &mut Context<'_, Ports>) {
        let before = self.status.replace((ctx.now(), status)).map(|(_, status)| status);
        if before != Some(status) {
            tracing::info!(
                "{}: {}, {}{}",
                ctx.module_name(),
                mode_name(status.nav_state),
                if status.is_armed { "armed" } else { "disarmed" },
                if status.has_failsafe { ", failsafe" } else { "" }
            );
            self.report(ctx);
        }
    }

    /// The level of the status, and why.
    fn level(&self, now: Time) -> (u8, &'static str) {
        match self.status {
            None => (DiagnosticStatus::STALE, "PX4 was not heard yet"),
            Some((at, _)) if now >= at + SILENCE => (DiagnosticStatus::STALE, "PX4 is not heard any more"),
            Some((_, status)) if status.has_failsafe => (DiagnosticStatus::ERROR, "failsafe"),
            _ if !self.complaints.odometry.text.is_empty() => (DiagnosticStatus::WARN, "no odometry"),
            Some((_, status)) if !status.is_armed && !status.passes_checks => {
                (DiagnosticStatus::WARN, "pre-flight checks do not pass")
            }
            Some(_) => (DiagnosticStatus::OK, "connected"),
        }
    }

    fn report(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        let (level, message) = self.level(now);
        self.reported = Some((now, level));
        let value = |key: &str, value: String| KeyValue { key: key.to_owned(), value };
        let mut values = vec![value("release", self.release.to_string())];
        if let Some((_, status)) = self.status {
            values.push(value("mode", mode_name(status.nav_state)));
            values.push(value("armed", status.is_armed.to_string()));
            values.push(value("failsafe", status.has_failsafe.to_string()));
            values.push(value("pre-flight checks pass", status.passes_checks.to_string()));
        }
        values.push(value("set-points", self.streamed_since.is_some().to_string()));
        values.push(value("time", source_name(self.clock.source()).to_owned()));
        values.push(value("steps of time", self.clock.steps().to_string()));
        values.push(value("dropped for their stamps", self.complaints.stamp.count.to_string()));
        values.push(value("dropped odometry", self.complaints.odometry.count.to_string()));
        values.push(value("dropped commands", self.stale.count().to_string()));
        let name = format!("{}: autopilot", ctx.module_name());
        let hardware_id = format!("PX4 {}", ctx.get(ctx.ports.system_id));
        let status = vec![DiagnosticStatus { level, name, message: message.to_owned(), hardware_id, values }];
        ctx.publish(ctx.ports.diagnostics, DiagnosticArray { header: header(now, ""), status });
    }
}

fn source_name(source: Option<TimeSource>) -> &'static str {
    match source {
        None => "unknown",
        Some(TimeSource::Agent) => "converted by PX4",
        Some(TimeSource::TimesyncStatus) => "by timesync_status",
        Some(TimeSource::Arrival) => "by the arrival of messages",
    }
}

/// The name of a `nav_state`.
fn mode_name(nav_state: u8) -> String {
    let name = match nav_state {
        0 => "manual",
        1 => "altitude",
        2 => "position",
        3 => "mission",
        wire::STATE_LOITER => "hold",
        5 => "return",
        10 => "acro",
        12 => "descend",
        13 => "termination",
        wire::STATE_OFFBOARD => "offboard",
        15 => "stabilized",
        17 => "takeoff",
        wire::STATE_LAND => "land",
        other => return format!("nav_state {other}"),
    };
    name.to_owned()
}

impl Module for Px4 {
    type Ports = Ports;

    #[allow(clippy::useless_conversion, reason = "in some releases components have fewer bits")]
    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let (_, release) = release_setting(setup)?;
        self.release = release;
        let about = "Hz of set-points; PX4 leaves offboard mode below 2 Hz";
        let rate_key = setup.read_only_setting("rate_hz", 20.0, about)?;
        let rate: f64 = setup.value(rate_key).copied().unwrap_or(0.0);
        if !(5.0..=1000.0).contains(&rate) {
            return Err(setup.refuse_value(rate_key, format!("{rate} Hz is not within 5 and 1000 Hz")));
        }
        let about = "s for which a command is valid; then set-points stop, and PX4 leaves offboard mode";
        let command_timeout = setup.setting_in("command_timeout", 0.5, 0.05..=10.0, about)?;
        let about = "s within which PX4 answers a command";
        let answer_timeout = setup.setting_in("answer_timeout", 2.0, 0.1..=60.0, about)?;
        let about = "the parameter MAV_SYS_ID of the autopilot, to which commands go";
        let system_id = setup.setting_in("system_id", 1, 1.0..=255.0, about)?;
        let stamped = setup.read_only_setting("use_stamped_vel", false, "cmd_vel is a TwistStamped")?;
        let odom_frame = setup.setting("odom_frame_id", "odom".to_owned(), "frame of poses")?;
        let base_frame = setup.setting("base_frame_id", "base_link".to_owned(), "frame of the body")?;
        let imu_frame = setup.setting("imu_frame_id", "base_link".to_owned(), "frame of the IMU")?;
        let enable_tf = setup.setting("enable_odom_tf", true, "whether `odom` is also on tf")?;

        let topic = |direction: &str, name: &str, message: &str| {
            release.topic(&format!("fmu/{direction}/{name}"), message)
        };
        let answers_topic = topic("out", "vehicle_command_ack", "VehicleCommandAck");
        let (command, control_mode, set_point): (Send<Command>, Send<(u64, bool)>, _) = with_messages_of!(release, msg => {
            let commands = setup.publish(&topic("in", "vehicle_command", "VehicleCommand"))?;
            let modes = setup.publish(&topic("in", "offboard_control_mode", "OffboardControlMode"))?;
            let set_points =
                setup.publish::<msg::TrajectorySetpoint>(&topic("in", "trajectory_setpoint", "TrajectorySetpoint"))?;
            let command: Send<Command> = Box::new(move |ctx, command| {
                let [param1, param2, param3] = command.params;
                ctx.publish(commands, msg::VehicleCommand {
                    timestamp: command.timestamp,
                    param1,
                    param2,
                    param3,
                    // Not a number: here, for land.
                    param4: f32::NAN,
                    param5: f64::NAN,
                    param6: f64::NAN,
                    param7: f32::NAN,
                    command: command.number,
                    target_system: command.target_system,
                    target_component: COMPONENT,
                    source_system: command.target_system,
                    source_component: COMPONENT.into(),
                    from_external: true,
                    ..msg::VehicleCommand::default()
                });
            });
            let mode: Send<(u64, bool)> = Box::new(move |ctx, (timestamp, position)| {
                ctx.publish(modes, msg::OffboardControlMode {
                    timestamp,
                    position,
                    velocity: !position,
                    ..msg::OffboardControlMode::default()
                });
            });
            (command, mode, set_points)
        });
        with_messages_of!(release, msg => {
            setup.subscribe(
                &topic("out", "vehicle_odometry", "VehicleOdometry"),
                |px4: &mut Self, message: Received<'_, msg::VehicleOdometry>, ctx| px4.on_odometry(&message, ctx),
            )?;
            setup.subscribe(
                &topic("out", "sensor_combined", "SensorCombined"),
                |px4: &mut Self, message: Received<'_, msg::SensorCombined>, ctx| px4.on_sensors(&message, ctx),
            )?;
            setup.subscribe(
                &topic("out", "battery_status", "BatteryStatus"),
                |px4: &mut Self, message: Received<'_, msg::BatteryStatus>, ctx| {
                    let battery = Battery {
                        connected: message.connected,
                        voltage_v: message.voltage_v,
                        current_a: message.current_a,
                        remaining: message.remaining,
                        temperature: message.temperature,
                        capacity_mah: message.capacity,
                        cell_count: message.cell_count,
                        cells_v: message.voltage_cell_v,
                        id: message.id,
                        has_failed: message.warning == 4,
                        has_faults: message.faults != 0,
                    };
                    px4.on_battery(message.timestamp, &battery, ctx);
                },
            )?;
            setup.subscribe(
                &topic("out", "vehicle_status", "VehicleStatus"),
                |px4: &mut Self, message: Received<'_, msg::VehicleStatus>, ctx| {
                    let status = Status {
                        nav_state: message.nav_state,
                        is_armed: message.arming_state == msg::VehicleStatus::ARMING_STATE_ARMED,
                        has_failsafe: message.failsafe,
                        passes_checks: message.pre_flight_checks_pass,
                    };
                    px4.on_status(status, ctx);
                },
            )?;
            setup.subscribe(
                &topic("out", "timesync_status", "TimesyncStatus"),
                |px4: &mut Self, message: Received<'_, msg::TimesyncStatus>, _| {
                    px4.clock.on_estimated_offset(message.estimated_offset);
                },
            )?;
            setup.subscribe(
                &answers_topic,
                |px4: &mut Self, message: Received<'_, msg::VehicleCommandAck>, ctx| {
                    let to = [message.target_system.into(), message.target_component.into()];
                    px4.on_answer(message.command, message.result, to, ctx);
                },
            )?;
        });
        if setup.value(stamped) == Some(&true) {
            setup
                .subscribe::<TwistStamped, _>("cmd_vel", |px4, command, ctx| px4.on_stamped(&command, ctx))?;
        } else {
            setup.subscribe::<Twist, _>("cmd_vel", |px4, twist, ctx| px4.on_twist(&twist, ctx.now(), ctx))?;
        }
        setup.subscribe::<PoseStamped, _>("setpoint_pose", |px4, pose, ctx| px4.on_pose(&pose, ctx))?;
        setup.serve_later::<SetBoolRequest, SetBoolResponse, _>("arm", |px4, request, caller, ctx| {
            px4.on_arm(request.data, caller, ctx);
        })?;
        for (service, mode) in [("offboard", Mode::Offboard), ("hold", Mode::Hold), ("land", Mode::Land)] {
            setup.serve_later::<TriggerRequest, TriggerResponse, _>(
                service,
                move |px4, _, caller, ctx| {
                    px4.on_trigger(mode, caller, ctx);
                },
            )?;
        }
        setup.every(Duration::from_secs_f64(1.0 / rate), Self::stream)?;
        Ok(Ports {
            odom: setup.publish("odom")?,
            tf: setup.publish("tf")?,
            imu: setup.publish("imu/data_raw")?,
            battery: setup.publish("battery_state")?,
            diagnostics: setup.publish("diagnostics")?,
            command,
            control_mode,
            set_point,
            command_timeout,
            answer_timeout,
            system_id,
            odom_frame,
            base_frame,
            imu_frame,
            enable_tf,
            answers_topic,
        })
    }

    /// Set-points stop: PX4 leaves offboard mode by itself.
    fn deactivate(&mut self, _: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        (self.asked, self.streamed_since) = (None, None);
        Ok(())
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}
