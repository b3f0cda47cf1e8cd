//! The hardware module.

use super::bus::{Bus, Exchange, SerialBus};
use super::diagnostics::{Levels, levels, report};
use super::driver::Counted;
use super::driver::Driver;
use super::reading::{BoardReading, Reading};
use super::servo::Servo;
use super::settings::{SettingKeys, Settings};
use super::tables::joints::{COUNT, JOINTS, index_of};
use super::tables::units::{
    ACCELERATION_PER_LSB, load_from_raw, radians_from_ticks, speed_from_raw, volts_from_raw,
};
use downbeat_executor::{Context, Module, Publication, Received, Setup, SetupError, Time, TransitionError};
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticArray;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::geometry_msgs::msg::Vector3;
use downbeat_msgs::sensor_msgs::msg::{BatteryState, Imu, JointState, Joy};
use downbeat_msgs::std_msgs::msg::Header;
use std::time::Duration;

/// The cycle of the hardware.
pub const CYCLE: Duration = Duration::from_millis(8);
/// The period of slowly changing data.
const SLOW: Duration = Duration::from_secs(1);

/// The hardware of a Darwin OP as a module: goals out, joints, IMU, battery and buttons in, every 8 ms.
///
/// It waits for the bus, so run it detached.
///
/// | topic | type | |
/// | --- | --- | --- |
/// | `joint_commands` (in) | `sensor_msgs/JointState` | positions by name, rad; unknown names and NaN are ignored, other values are clamped to the limits |
/// | `joint_states` | `sensor_msgs/JointState` | 20 joints in the order of the ids: rad, rad/s, load as a fraction of the drive; stale joints have velocity and effort NaN |
/// | `imu/data_raw` | `sensor_msgs/Imu` | forward, left, up: rad/s, m/s^2 |
/// | `battery_state` | `sensor_msgs/BatteryState` | V, once a second |
/// | `buttons` | `sensor_msgs/Joy` | mode, start; once a second and when they change |
/// | `diagnostics` | `diagnostic_msgs/DiagnosticArray` | once a second and when a level changes |
/// | `bus/exchanges` | `downbeat_interfaces/BusExchange` | all traffic on the bus |
///
/// A joint does not move before it is commanded. It then approaches the command slowly (about 2 rad/s), as
/// after each time it was out of service. On shutdown the servos keep their torque.
pub struct DarwinOp {
    bus: Box<dyn Bus>,
    driver: Driver,
    /// `None` before the first activation.
    settings: Option<Settings>,
    exchanges: Vec<Exchange>,
    unknown_names: Counted,
    last: LastPublished,
}

/// The keys of [`DarwinOp`].
pub struct Ports {
    settings: SettingKeys,
    joint_states: Publication<JointState>,
    imu: Publication<Imu>,
    battery_state: Publication<BatteryState>,
    buttons: Publication<Joy>,
    diagnostics: Publication<DiagnosticArray>,
    exchanges: Publication<BusExchange>,
}

/// When topics that are not published in every cycle were last published.
#[derive(Default)]
struct LastPublished {
    battery_at: Option<Time>,
    buttons: Option<(Time, u16)>,
    diagnostics: Option<(Time, Levels)>,
}

impl DarwinOp {
    /// The robot on the serial port in the setting `port`.
    #[must_use]
    pub fn serial() -> Self {
        Self::new(Box::new(SerialBus::new()))
    }

    /// The robot on any bus, such as a recorded one.
    #[must_use]
    pub fn new(bus: Box<dyn Bus>) -> Self {
        Self {
            bus,
            driver: Driver::new(),
            settings: None,
            exchanges: Vec::new(),
            unknown_names: Counted::default(),
            last: LastPublished::default(),
        }
    }

    fn read_settings(&mut self, ctx: &mut Context<'_, Ports>) {
        match ctx.ports.settings.values(ctx) {
            Ok(settings) => self.settings = Some(settings),
            Err(refusal) => tracing::warn!("{refusal}; the settings are unchanged"),
        }
    }

    fn on_command(&mut self, command: Received<'_, JointState>, _ctx: &mut Context<'_, Ports>) {
        let Some(settings) = &self.settings else { return };
        for (name, position) in command.name.iter().zip(&command.position) {
            let Some(index) = index_of(name) else {
                if self.unknown_names.is_worth_a_line() {
                    let count = self.unknown_names.count();
                    tracing::warn!(
                        "joint_commands contains \"{name}\", which is not a joint ({count} times so far)"
                    );
                }
                continue;
            };
            if let Some(ticks) = JOINTS[index].goal_ticks(*position, settings.offset_ticks[index]) {
                self.driver.servos[index].want(ticks);
            }
        }
    }

    fn tick(&mut self, ctx: &mut Context<'_, Ports>) {
        let Some(settings) = &self.settings else { return };
        let now = ctx.now();
        let reading = self.driver.step(now, settings, &mut *self.bus, &mut self.exchanges);
        for exchange in self.exchanges.drain(..) {
            ctx.publish(ctx.ports.exchanges, BusExchange::from(&exchange));
        }
        if let Some(reading) = &reading {
            publish(reading, &self.driver, settings, &mut self.last, ctx);
        }
        let levels = levels(now, &self.driver);
        let is_news = self.last.diagnostics.is_none_or(|(at, last)| at + SLOW <= now || last != levels);
        if is_news {
            self.last.diagnostics = Some((now, levels));
            ctx.publish(
                ctx.ports.diagnostics,
                report(now, &self.driver, self.unknown_names.count(), settings),
            );
        }
    }
}

impl Module for DarwinOp {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let settings = SettingKeys::declare(setup)?;
        settings.on_change(setup, Self::read_settings);
        let ports = Ports {
            settings,
            joint_states: setup.publish("joint_states")?,
            imu: setup.publish("imu/data_raw")?,
            battery_state: setup.publish("battery_state")?,
            buttons: setup.publish("buttons")?,
            diagnostics: setup.publish("diagnostics")?,
            exchanges: setup.publish("bus/exchanges")?,
        };
        setup.subscribe("joint_commands", Self::on_command)?;
        setup.every(CYCLE, Self::tick)?;
        Ok(ports)
    }

    fn activate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        self.read_settings(ctx);
        Ok(())
    }

    fn shutdown(&mut self, ctx: &mut Context<'_, Ports>) {
        self.driver.stop(ctx.now(), &mut *self.bus, &mut self.exchanges);
        for exchange in self.exchanges.drain(..) {
            ctx.publish(ctx.ports.exchanges, BusExchange::from(&exchange));
        }
    }
}

fn publish(
    reading: &Reading,
    driver: &Driver,
    settings: &Settings,
    last: &mut LastPublished,
    ctx: &mut Context<'_, Ports>,
) {
    let (now, sent) = (ctx.now(), reading.sent);
    if reading.servos.iter().any(Option::is_some) {
        ctx.publish(ctx.ports.joint_states, joint_state(reading, &driver.servos, settings));
    }
    let Some(board) = &reading.board else { return };
    ctx.publish(ctx.ports.imu, imu(sent, board, settings));
    if last.buttons.is_none_or(|(at, pressed)| at + SLOW <= now || pressed != board.buttons) {
        last.buttons = Some((now, board.buttons));
        ctx.publish(ctx.ports.buttons, buttons(sent, board));
    }
    if last.battery_at.is_none_or(|at| at + SLOW <= now) {
        last.battery_at = Some(now);
        ctx.publish(ctx.ports.battery_state, battery_state(sent, board));
    }
}

/// The capacity of the battery, in Ah.
const DESIGN_CAPACITY_AH: f32 = 1.0;

/// A header with that stamp.
pub(super) fn header(stamp: Time, frame_id: &str) -> Header {
    let stamp = builtin_interfaces::msg::Time::from_nanos(stamp.as_nanos());
    Header { stamp, frame_id: frame_id.to_owned() }
}

/// All joints. A stale one keeps its last position and has NaN as velocity and effort, and as position if it
/// was never read.
fn joint_state(reading: &Reading, servos: &[Servo; COUNT], settings: &Settings) -> JointState {
    let mut message = JointState {
        header: header(reading.sent, &settings.joint_frame),
        name: JOINTS.iter().map(|joint| joint.name.to_owned()).collect(),
        position: Vec::with_capacity(COUNT),
        velocity: Vec::with_capacity(COUNT),
        effort: Vec::with_capacity(COUNT),
    };
    for (servo, offset_ticks) in servos.iter().zip(settings.offset_ticks) {
        let fresh = servo.last.filter(|_| !servo.is_stale());
        let position = servo.last.map(|last| radians_from_ticks(last.position, offset_ticks));
        message.position.push(position.unwrap_or(f64::NAN));
        message.velocity.push(fresh.map_or(f64::NAN, |last| speed_from_raw(last.speed)));
        message.effort.push(fresh.map_or(f64::NAN, |last| load_from_raw(last.load)));
    }
    message
}

/// Angular rate and specific force. The orientation is not measured, as marked by -1.
///
/// The covariances take one step of the 10-bit numbers as standard deviation.
pub(super) fn imu(sent: Time, board: &BoardReading, settings: &Settings) -> Imu {
    let mut orientation_covariance = [0.0; 9];
    orientation_covariance[0] = -1.0;
    Imu {
        header: header(sent, &settings.imu_frame),
        orientation_covariance,
        angular_velocity: vector(settings.imu.angular_velocity(board.gyro)),
        angular_velocity_covariance: diagonal(settings.imu.radians_per_lsb()),
        linear_acceleration: vector(settings.imu.linear_acceleration(board.acceleration)),
        linear_acceleration_covariance: diagonal(ACCELERATION_PER_LSB),
        ..Imu::default()
    }
}

/// The battery, of which only the voltage is measured.
pub(super) fn battery_state(sent: Time, board: &BoardReading) -> BatteryState {
    BatteryState {
        header: header(sent, ""),
        voltage: volts_from_raw(board.voltage) as f32,
        temperature: f32::NAN,
        current: f32::NAN,
        charge: f32::NAN,
        capacity: f32::NAN,
        design_capacity: DESIGN_CAPACITY_AH,
        percentage: f32::NAN,
        power_supply_status: BatteryState::POWER_SUPPLY_STATUS_UNKNOWN,
        power_supply_health: BatteryState::POWER_SUPPLY_HEALTH_UNKNOWN,
        power_supply_technology: BatteryState::POWER_SUPPLY_TECHNOLOGY_LIPO,
        present: true,
        ..BatteryState::default()
    }
}

/// The buttons: mode, start.
pub(super) fn buttons(sent: Time, board: &BoardReading) -> Joy {
    let button = |bit: u16| i32::from(board.buttons >> bit & 1);
    Joy { header: header(sent, ""), axes: Vec::new(), buttons: vec![button(0), button(1)] }
}

fn vector([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3 { x, y, z }
}

fn diagonal(deviation: f64) -> [f64; 9] {
    let variance = deviation * deviation;
    [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance]
}
