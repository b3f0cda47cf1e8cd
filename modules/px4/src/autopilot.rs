//! The module [`Autopilot`].

use std::time::Duration;

use downbeat_executor::{Context, Module, Publication, Received, Setup, SetupError, Time};
use glam::DVec3;

use crate::clock::stamp_us;
use crate::release::Release;
use crate::v1_17::msg::{SensorCombined, TimesyncStatus, VehicleOdometry};
use crate::wire::{self, release_setting, result, with_messages_of};

/// An emulated PX4 autopilot, for tests and to try a robot file without a vehicle: the topics that
/// [`Px4`](crate::Px4) uses, with a vehicle that is a point which follows set-points exactly, up to 3 m/s.
///
/// It is our reading of PX4, not PX4. It
///
/// - arms on the ground and disarms, and refuses to disarm in flight;
/// - enters offboard mode only if `offboard_control_mode` has come at 2 Hz or more during the last second;
/// - leaves it for hold mode, with a failsafe, when that falls silent for 0.5 s;
/// - lands in land mode at 0.7 m/s, and disarms on the ground;
/// - answers each command, with "unsupported" if it is another one.
///
/// | setting | default | |
/// | --- | --- | --- |
/// | `release` | 1.17 | whose messages it speaks |
/// | `time` | `agent` | stamps: `agent`: those of the robot, as with UXRCE_DDS_SYNCT; `boot`: since the start |
#[derive(Debug, Default)]
pub struct Autopilot {
    counts_from_boot: bool,
    started: Option<Time>,
    nav_state: u8,
    is_armed: bool,
    has_failsafe: bool,
    /// In NED.
    position: DVec3,
    velocity: DVec3,
    /// Clockwise from north.
    heading: f64,
    set_point: Option<Target>,
    /// When offboard_control_mode came last, and since when without a gap.
    heard: Option<(Time, Time)>,
    ticks: u64,
}

/// A trajectory set-point, in NED; what is not controlled is NaN.
#[derive(Clone, Copy, Debug)]
struct Target {
    position: DVec3,
    velocity: DVec3,
    yaw: f64,
    yaw_rate: f64,
}

#[derive(Clone, Copy)]
struct Status {
    timestamp: u64,
    nav_state: u8,
    is_armed: bool,
    has_failsafe: bool,
}

#[derive(Clone, Copy)]
struct Answer {
    timestamp: u64,
    command: u32,
    result: u8,
    to: [u16; 2],
}

type Send<T> = Box<dyn Fn(&mut Context<'_, Ports>, T) + std::marker::Send + Sync>;

/// The keys of [`Autopilot`].
pub struct Ports {
    odometry: Publication<VehicleOdometry>,
    sensors: Publication<SensorCombined>,
    timesync: Publication<TimesyncStatus>,
    status: Send<Status>,
    battery: Send<u64>,
    answer: Send<Answer>,
}

const PERIOD: Duration = Duration::from_millis(10);
const PERIOD_S: f64 = 0.01;
/// The longest gap between messages of offboard_control_mode.
const LONGEST_GAP: Duration = Duration::from_millis(500);
const LEAD: Duration = Duration::from_secs(1);
const TOP_SPEED: f64 = 3.0;
const LANDING_SPEED: f64 = 0.7;
/// The manual mode of an autopilot without a pilot: hold.
const AT_START: u8 = wire::STATE_LOITER;

impl Autopilot {
    fn stamp(&self, now: Time) -> u64 {
        match (self.counts_from_boot, self.started) {
            // An autopilot runs before anyone listens to it.
            (true, Some(started)) => (now.saturating_since(started) + LEAD).as_micros() as u64,
            _ => stamp_us(now),
        }
    }

    fn tick(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        self.started.get_or_insert(now);
        self.watch_offboard(now);
        self.move_on();
        let (ports, timestamp) = (ctx.ports, self.stamp(now));
        if self.ticks.is_multiple_of(2) {
            let (sin, cos) = libm::sincos(self.heading / 2.0);
            ctx.publish(
                ports.odometry,
                VehicleOdometry {
                    timestamp,
                    timestamp_sample: timestamp,
                    pose_frame: VehicleOdometry::POSE_FRAME_NED,
                    position: self.position.as_vec3().into(),
                    q: [cos as f32, 0.0, 0.0, sin as f32],
                    velocity_frame: VehicleOdometry::VELOCITY_FRAME_NED,
                    velocity: self.velocity.as_vec3().into(),
                    position_variance: [0.01; 3],
                    orientation_variance: [0.001; 3],
                    velocity_variance: [0.01; 3],
                    ..VehicleOdometry::default()
                },
            );
        }
        let accelerometer_m_s2 = [0.0, 0.0, -9.806_65];
        ctx.publish(
            ports.sensors,
            SensorCombined { timestamp, accelerometer_m_s2, ..SensorCombined::default() },
        );
        if self.ticks.is_multiple_of(50) {
            self.publish_status(ctx);
        }
        if self.ticks.is_multiple_of(100) {
            (ports.battery)(ctx, timestamp);
            let offset = timestamp as i64 - stamp_us(now) as i64;
            let source_protocol = TimesyncStatus::SOURCE_PROTOCOL_DDS;
            let (observed_offset, estimated_offset) = (offset, offset);
            let status = TimesyncStatus {
                timestamp,
                source_protocol,
                observed_offset,
                estimated_offset,
                ..Default::default()
            };
            ctx.publish(ports.timesync, status);
        }
        self.ticks += 1;
    }

    fn publish_status(&self, ctx: &mut Context<'_, Ports>) {
        let ports = ctx.ports;
        let timestamp = self.stamp(ctx.now());
        let Self { nav_state, is_armed, has_failsafe, .. } = *self;
        (ports.status)(ctx, Status { timestamp, nav_state, is_armed, has_failsafe });
    }

    fn watch_offboard(&mut self, now: Time) {
        self.heard = self.heard.filter(|(last, _)| now <= *last + LONGEST_GAP);
        if self.nav_state == wire::STATE_OFFBOARD && self.heard.is_none() {
            (self.nav_state, self.has_failsafe, self.set_point) = (wire::STATE_LOITER, true, None);
            tracing::warn!("the emulated autopilot leaves offboard mode: offboard_control_mode is silent");
        }
    }

    fn on_control_mode(&mut self, now: Time) {
        let since = self.heard.filter(|(last, _)| now <= *last + LONGEST_GAP).map_or(now, |(_, since)| since);
        self.heard = Some((now, since));
    }

    fn is_on_ground(&self) -> bool {
        self.position.z > -0.05
    }

    fn on_command(&mut self, command: u32, params: [f32; 3], now: Time) -> u8 {
        match command {
            wire::COMPONENT_ARM_DISARM if params[0] == 1.0 => {
                self.is_armed = true;
                result::ACCEPTED
            }
            wire::COMPONENT_ARM_DISARM if params[0] == 0.0 => match self.is_armed && !self.is_on_ground() {
                true => result::DENIED,
                false => {
                    self.is_armed = false;
                    result::ACCEPTED
                }
            },
            wire::DO_SET_MODE if params[0] == wire::CUSTOM_MODE && params[1] == wire::MAIN_MODE_OFFBOARD => {
                match self.heard.is_some_and(|(_, since)| now >= since + LEAD) {
                    true => self.enter(wire::STATE_OFFBOARD),
                    false => result::TEMPORARILY_REJECTED,
                }
            }
            wire::DO_SET_MODE
                if params == [wire::CUSTOM_MODE, wire::MAIN_MODE_AUTO, wire::SUB_MODE_LOITER] =>
            {
                self.enter(wire::STATE_LOITER)
            }
            wire::NAV_LAND => self.enter(wire::STATE_LAND),
            _ => result::UNSUPPORTED,
        }
    }

    fn enter(&mut self, nav_state: u8) -> u8 {
        (self.nav_state, self.has_failsafe) = (nav_state, false);
        result::ACCEPTED
    }

    /// Moves the point for a period.
    fn move_on(&mut self) {
        self.velocity = DVec3::ZERO;
        if !self.is_armed {
            return;
        }
        match (self.nav_state, self.set_point) {
            (wire::STATE_OFFBOARD, Some(target)) => {
                let wanted = match target.position.is_finite() {
                    true => (target.position - self.position) * 2.0,
                    false if target.velocity.is_finite() => target.velocity,
                    false => DVec3::ZERO,
                };
                self.velocity = wanted.clamp_length_max(TOP_SPEED);
                if target.yaw.is_finite() {
                    self.heading = target.yaw;
                } else if target.yaw_rate.is_finite() {
                    self.heading = downbeat_transforms::wrapped(self.heading + target.yaw_rate * PERIOD_S);
                }
            }
            (wire::STATE_LAND, _) if !self.is_on_ground() => self.velocity = DVec3::Z * LANDING_SPEED,
            (wire::STATE_LAND, _) => self.is_armed = false,
            _ => {}
        }
        self.position += self.velocity * PERIOD_S;
        self.position.z = self.position.z.min(0.0);
    }
}

impl Module for Autopilot {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        self.nav_state = AT_START;
        let (_, release) = release_setting(setup)?;
        let time = setup.read_only_choice(
            "time",
            "agent",
            &["agent", "boot"],
            "stamps: agent: those of the robot; boot: since the start",
        )?;
        self.counts_from_boot = setup.value(time).is_some_and(|time| time == "boot");
        setup.every(PERIOD, Self::tick)?;
        ports(setup, release)
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}

#[allow(clippy::useless_conversion, reason = "in some releases components have fewer bits")]
fn ports(setup: &mut Setup<'_, Autopilot>, release: Release) -> Result<Ports, SetupError> {
    let topic = |direction: &str, name: &str, message: &str| {
        release.topic(&format!("fmu/{direction}/{name}"), message)
    };
    with_messages_of!(release, msg => {
        setup.subscribe(
            &topic("in", "offboard_control_mode", "OffboardControlMode"),
            |pilot: &mut Autopilot, _: Received<'_, msg::OffboardControlMode>, ctx| pilot.on_control_mode(ctx.now()),
        )?;
        setup.subscribe(
            &topic("in", "trajectory_setpoint", "TrajectorySetpoint"),
            |pilot: &mut Autopilot, message: Received<'_, msg::TrajectorySetpoint>, _| {
                let vector = |[x, y, z]: [f32; 3]| DVec3::new(x.into(), y.into(), z.into());
                pilot.set_point = Some(Target {
                    position: vector(message.position),
                    velocity: vector(message.velocity),
                    yaw: message.yaw.into(),
                    yaw_rate: message.yawspeed.into(),
                });
            },
        )?;
        setup.subscribe(
            &topic("in", "vehicle_command", "VehicleCommand"),
            |pilot: &mut Autopilot, message: Received<'_, msg::VehicleCommand>, ctx| {
                let params = [message.param1, message.param2, message.param3];
                let now = ctx.now();
                let answer = Answer {
                    timestamp: pilot.stamp(now),
                    command: message.command,
                    result: pilot.on_command(message.command, params, now),
                    to: [message.source_system.into(), message.source_component.into()],
                };
                let ports = ctx.ports;
                (ports.answer)(ctx, answer);
                pilot.publish_status(ctx);
            },
        )?;
        let statuses = setup.publish(&topic("out", "vehicle_status", "VehicleStatus"))?;
        let batteries = setup.publish(&topic("out", "battery_status", "BatteryStatus"))?;
        let answers = setup.publish(&topic("out", "vehicle_command_ack", "VehicleCommandAck"))?;
        Ok(Ports {
            odometry: setup.publish::<msg::VehicleOdometry>(&topic("out", "vehicle_odometry", "VehicleOdometry"))?,
            sensors: setup.publish::<msg::SensorCombined>(&topic("out", "sensor_combined", "SensorCombined"))?,
            timesync: setup.publish::<msg::TimesyncStatus>(&topic("out", "timesync_status", "TimesyncStatus"))?,
            status: Box::new(move |ctx, status| {
                ctx.publish(statuses, msg::VehicleStatus {
                    timestamp: status.timestamp,
                    // Disarmed is 1, or standby in older releases.
                    arming_state: if status.is_armed { msg::VehicleStatus::ARMING_STATE_ARMED } else { 1 },
                    nav_state: status.nav_state,
                    failsafe: status.has_failsafe,
                    pre_flight_checks_pass: true,
                    system_id: 1,
                    component_id: 1,
                    ..msg::VehicleStatus::default()
                });
            }),
            battery: Box::new(move |ctx, timestamp| {
                let mut message = msg::BatteryStatus { timestamp, connected: true, voltage_v: 15.2, current_a: 4.0, remaining: 0.8, ..Default::default() };
                (message.id, message.cell_count, message.temperature) = (1, 4, f32::NAN);
                ctx.publish(batteries, message);
            }),
            answer: Box::new(move |ctx, answer| {
                let [system, component] = answer.to;
                ctx.publish(answers, msg::VehicleCommandAck {
                    timestamp: answer.timestamp,
                    command: answer.command,
                    result: answer.result,
                    target_system: system as _,
                    target_component: component as _,
                    from_external: true,
                    ..msg::VehicleCommandAck::default()
                });
            }),
        })
    })
}
