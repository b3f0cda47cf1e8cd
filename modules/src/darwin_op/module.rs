//! The hardware module.

use super::bus::{Bus, SerialBus};
use super::protocol::Id;
use super::settings::{SettingKeys, Settings};
use super::tables::units::{ACCELERATION_PER_LSB, volts_from_raw};
use super::tables::{Field, cm730};
use crate::servo_bus::{Hardware, SLOW, Topics, header};
use downbeat_executor::{Context, Module, Publication, Received, Setup, SetupError, Time, TransitionError};
use downbeat_msgs::geometry_msgs::msg::Vector3;
use downbeat_msgs::sensor_msgs::msg::{BatteryState, Imu, JointState, Joy};
use downbeat_msgs::std_srvs::srv::SetBoolRequest;
use std::time::Duration;

/// The cycle of the hardware.
pub const CYCLE: Duration = Duration::from_millis(8);
/// LED colour.
const GREEN: u16 = 0x1F << 5;

/// The hardware of a Darwin OP as a module: goals out, joints, IMU, battery and buttons in, every 8 ms.
///
/// It waits for the bus, so run it detached.
///
/// | topic | type | |
/// | --- | --- | --- |
/// | `joint_commands` (in) | `sensor_msgs/JointState` | positions by name, rad; unknown names and values that are not finite are ignored, other values are clamped to the limits |
/// | `joint_torque` (in) | `sensor_msgs/JointState` | `effort`: the share of its largest torque that a joint may use; 0 switches it off |
/// | `joint_states` | `sensor_msgs/JointState` | 20 joints in the order of the ids: rad, rad/s, load as a fraction of the drive; stale joints have velocity and effort NaN |
/// | `imu/data_raw` | `sensor_msgs/Imu` | forward, left, up: rad/s, m/s^2 |
/// | `battery_state` | `sensor_msgs/BatteryState` | V, once a second |
/// | `buttons` | `sensor_msgs/Joy` | mode, start; once a second and when they change |
/// | `diagnostics` | `diagnostic_msgs/DiagnosticArray` | once a second and when a level changes |
/// | `bus/exchanges` | `downbeat_interfaces/BusExchange` | all traffic on the bus |
///
/// The service `torque` (`std_srvs/SetBool`) switches the torque of all joints.
///
/// A joint does not move before it is commanded. It then approaches the command slowly (about 2 rad/s), as
/// after each time it was out of service. On shutdown the servos keep their torque.
pub struct DarwinOp {
    hardware: Hardware,
    /// `None` before the first activation.
    settings: Option<Settings>,
    last: LastPublished,
}

/// The keys of [`DarwinOp`].
pub struct Ports {
    settings: SettingKeys,
    topics: Topics,
    imu: Publication<Imu>,
    battery_state: Publication<BatteryState>,
    buttons: Publication<Joy>,
}

/// When topics that are not published in every cycle were last published.
#[derive(Default)]
struct LastPublished {
    battery_at: Option<Time>,
    buttons: Option<(Time, u16)>,
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
        let hardware = Hardware::new(bus, Settings::default().plan(), false);
        Self { hardware, settings: None, last: LastPublished::default() }
    }

    fn read_settings(&mut self, ctx: &mut Context<'_, Ports>) {
        match ctx.ports.settings.values(ctx) {
            Ok(settings) => {
                self.hardware.plan = settings.plan();
                self.hardware.hardware_id.clone_from(&settings.hardware_id);
                self.hardware.joint_frame.clone_from(&settings.joint_frame);
                self.settings = Some(settings);
            }
            Err(refusal) => tracing::warn!("{refusal}; the settings are unchanged"),
        }
    }

    fn on_command(&mut self, command: Received<'_, JointState>, _ctx: &mut Context<'_, Ports>) {
        if self.settings.is_some() {
            self.hardware.on_command(&command);
        }
    }

    fn on_torque(&mut self, command: Received<'_, JointState>, _ctx: &mut Context<'_, Ports>) {
        self.hardware.on_torque(&command);
    }

    fn tick(&mut self, ctx: &mut Context<'_, Ports>) {
        let Some(settings) = &self.settings else { return };
        let topics = ctx.ports.topics;
        if let Some(reading) = self.hardware.step(topics, ctx)
            && let Some(Some(piece)) = reading.devices.first()
            && let Some(board) = BoardReading::parse(piece)
        {
            publish(reading.sent, &board, settings, &mut self.last, ctx);
        }
        self.hardware.diagnose(topics, ctx);
    }
}

impl Module for DarwinOp {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let settings = SettingKeys::declare(setup)?;
        settings.on_change(setup, Self::read_settings);
        let ports = Ports {
            settings,
            topics: Topics::declare(setup)?,
            imu: setup.publish("imu/data_raw")?,
            battery_state: setup.publish("battery_state")?,
            buttons: setup.publish("buttons")?,
        };
        setup.subscribe("joint_commands", Self::on_command)?;
        setup.subscribe("joint_torque", Self::on_torque)?;
        setup.serve("torque", |module: &mut Self, request: &SetBoolRequest, _| {
            Ok(module.hardware.set_torque(request.data))
        })?;
        setup.every(CYCLE, Self::tick)?;
        Ok(ports)
    }

    fn activate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        self.read_settings(ctx);
        Ok(())
    }

    fn shutdown(&mut self, ctx: &mut Context<'_, Ports>) {
        // As in the manufacturer's framework.
        let green = (Id::CM730, &GREEN.to_le_bytes()[..], u16::from(cm730::LED_HEAD.address));
        let topics = ctx.ports.topics;
        self.hardware.stop(Some(green), topics, ctx);
    }
}

/// The raw data of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct BoardReading {
    /// Bit 0 mode, bit 1 start.
    pub(super) buttons: u16,
    /// X, Y, Z.
    pub(super) gyro: [u16; 3],
    /// X, Y, Z.
    pub(super) acceleration: [u16; 3],
    /// 0.1 V.
    pub(super) voltage: u16,
}

impl BoardReading {
    /// Parses the range of the control table from the power switch to the battery voltage.
    fn parse(piece: &[u8]) -> Option<Self> {
        let value = |field: &Field| field.value_in(piece, cm730::DXL_POWER.address);
        Some(Self {
            buttons: value(&cm730::BUTTON)?,
            gyro: [value(&cm730::GYRO_X)?, value(&cm730::GYRO_Y)?, value(&cm730::GYRO_Z)?],
            acceleration: [value(&cm730::ACC_X)?, value(&cm730::ACC_Y)?, value(&cm730::ACC_Z)?],
            voltage: value(&cm730::VOLTAGE)?,
        })
    }
}

fn publish(
    sent: Time,
    board: &BoardReading,
    settings: &Settings,
    last: &mut LastPublished,
    ctx: &mut Context<'_, Ports>,
) {
    let now = ctx.now();
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
        design_capacity: DESIGN_CAPACITY_AH,
        power_supply_technology: BatteryState::POWER_SUPPLY_TECHNOLOGY_LIPO,
        ..crate::servo_bus::battery_state(sent, volts_from_raw(board.voltage))
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
