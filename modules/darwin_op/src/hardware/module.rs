//! The hardware module.

use super::bus::{Bus, SerialBus};
use super::calibration::GyroCalibration;
use super::protocol::{Id, Protocol, WriteEntry};
use super::settings::{CYCLE, SettingKeys, Settings};
use super::tables::units::{ACCELERATION_PER_LSB, IMU_CENTRE, volts_from_raw};
use super::tables::{Field, cm730};
use downbeat_executor::{Context, Module, Publication, Received, Setup, SetupError, Time, TransitionError};
use downbeat_msgs::sensor_msgs::msg::{BatteryState, Imu, JointState, Joy};
use downbeat_msgs::std_msgs::msg::{ColorRGBA, Float64MultiArray};
use downbeat_msgs::std_srvs::srv::SetBoolRequest;
use downbeat_servos::servo_bus::{DevicePlan, Hardware, ImuReading, SLOW, Topics};
use downbeat_servos::stamps::header;

/// LED colour.
const GREEN: u16 = 0x1F << 5;

/// The hardware of a Darwin OP as a module: goals out, joints, IMU, battery and buttons in, every 8 ms.
///
/// It waits for the bus, so run it detached.
///
/// | topic | type | |
/// | --- | --- | --- |
/// | `joint_commands` (in) | `sensor_msgs/JointState` | positions by name, rad, clamped to the limits; unknown names are counted; what is not finite, or more than a turn beyond the limits, is refused and reported |
/// | `joint_torque` (in) | `sensor_msgs/JointState` | `effort`: the share of its largest torque that a joint may use; 0 switches it off |
/// | `led/head`, `led/eyes` (in) | `std_msgs/ColorRGBA` | the lights on the head |
/// | `led/panel` (in) | `std_msgs/ColorRGBA` | the three lights on the back, red, green and blue: on from 0.5 |
/// | `foot_pressure/right`, `foot_pressure/left` | `std_msgs/Float64MultiArray` | with `foot_sensors`: four forces in N, centre of pressure as a share of half the foot, NaN without load |
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
    calibration: GyroCalibration,
    last: LastPublished,
}

/// The keys of [`DarwinOp`].
pub struct Ports {
    settings: SettingKeys,
    topics: Topics,
    imu: Publication<Imu>,
    battery_state: Publication<BatteryState>,
    buttons: Publication<Joy>,
    /// Right, left.
    feet: Option<[Publication<Float64MultiArray>; 2]>,
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
        Self {
            hardware,
            settings: None,
            calibration: GyroCalibration::default(),
            last: LastPublished::default(),
        }
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

    fn on_command(&mut self, command: Received<'_, JointState>, ctx: &mut Context<'_, Ports>) {
        if self.settings.is_some() {
            self.hardware.on_command(&command, ctx.now());
        }
    }

    fn on_torque(&mut self, command: Received<'_, JointState>, ctx: &mut Context<'_, Ports>) {
        self.hardware.on_torque(&command, ctx.now());
    }

    /// Sets the colour of a light on the head.
    fn light(&mut self, light: &Field, colour: &ColorRGBA) {
        // Five bits each; what is not a number is dark.
        let part = |value: f32| (value.clamp(0.0, 1.0) * 31.0).round() as u16;
        let value = part(colour.r) | part(colour.g) << 5 | part(colour.b) << 10;
        let (address, data) = (u16::from(light.address), value.to_le_bytes().to_vec());
        self.hardware.write_later(WriteEntry { id: Id::CM730, address, data });
    }

    /// Switches the lights on the back, of which each has one colour.
    fn light_panel(&mut self, colour: &ColorRGBA) {
        let bit = |value: f32, bit: u8| u8::from(value >= 0.5) << bit;
        let (address, data) = (
            u16::from(cm730::LED_PANEL.address),
            vec![bit(colour.r, 0) | bit(colour.b, 1) | bit(colour.g, 2)],
        );
        self.hardware.write_later(WriteEntry { id: Id::CM730, address, data });
    }

    fn tick(&mut self, ctx: &mut Context<'_, Ports>) {
        let Some(settings) = &self.settings else { return };
        let topics = ctx.ports.topics;
        if let Some(reading) = self.hardware.step(topics, ctx)
            && let Some(Some(piece)) = reading.devices.first()
        {
            for (index, foot) in ctx.ports.feet.into_iter().flatten().enumerate() {
                if let Some(Some(piece)) = reading.devices.get(index + 1) {
                    let message = foot_pressure(&self.hardware.plan.devices[index + 1], piece);
                    ctx.publish(foot, message);
                }
            }
            if let Some(board) = BoardReading::parse(piece) {
                if settings.calibrate_gyro {
                    self.calibration.take(board.gyro);
                }
                publish(reading.sent, &board, self.calibration.rest(), settings, &mut self.last, ctx);
            }
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
            feet: if settings.foot_sensors(setup) {
                self.hardware.describe(Settings { foot_sensors: true, ..Settings::default() }.plan());
                Some([setup.publish("foot_pressure/right")?, setup.publish("foot_pressure/left")?])
            } else {
                None
            },
        };
        setup.subscribe(
            "led/head",
            |module: &mut Self, colour: Received<'_, ColorRGBA>, _: &mut Context<'_, Ports>| {
                module.light(&cm730::LED_HEAD, &colour);
            },
        )?;
        setup.subscribe(
            "led/eyes",
            |module: &mut Self, colour: Received<'_, ColorRGBA>, _: &mut Context<'_, Ports>| {
                module.light(&cm730::LED_EYE, &colour);
            },
        )?;
        setup.subscribe(
            "led/panel",
            |module: &mut Self, colour: Received<'_, ColorRGBA>, _: &mut Context<'_, Ports>| {
                module.light_panel(&colour);
            },
        )?;
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
        self.hardware.resume();
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
    gyro_rest: Option<[f64; 3]>,
    settings: &Settings,
    last: &mut LastPublished,
    ctx: &mut Context<'_, Ports>,
) {
    let now = ctx.now();
    ctx.publish(ctx.ports.imu, imu(sent, board, gyro_rest, settings));
    if last.buttons.is_none_or(|(at, pressed)| at + SLOW <= now || pressed != board.buttons) {
        last.buttons = Some((now, board.buttons));
        ctx.publish(ctx.ports.buttons, buttons(sent, board));
    }
    if last.battery_at.is_none_or(|at| at + SLOW <= now) {
        last.battery_at = Some(now);
        ctx.publish(ctx.ports.battery_state, battery_state(sent, board));
    }
}

/// The forces on the four sensors of a foot, in N, and the centre of pressure, as a share of half the foot;
/// NaN without load.
fn foot_pressure(foot: &DevicePlan, piece: &[u8]) -> Float64MultiArray {
    let raw = |name: &str| {
        let register = foot.read.iter().find(|register| register.name == name)?;
        foot.value(Protocol::Dynamixel1, register, piece)
    };
    let force = |name| raw(name).unwrap_or(f64::NAN);
    let centre =
        |name| raw(name).filter(|value| *value < 255.0).map_or(f64::NAN, |value| (value - 127.0) / 127.0);
    let data = vec![
        force("fsr_1"),
        force("fsr_2"),
        force("fsr_3"),
        force("fsr_4"),
        centre("fsr_x"),
        centre("fsr_y"),
    ];
    Float64MultiArray { data, ..Float64MultiArray::default() }
}

/// The capacity of the battery, in Ah.
const DESIGN_CAPACITY_AH: f32 = 1.0;

/// Angular rate and specific force.
fn imu(sent: Time, board: &BoardReading, gyro_rest: Option<[f64; 3]>, settings: &Settings) -> Imu {
    let rest = gyro_rest.unwrap_or([f64::from(IMU_CENTRE); 3]);
    let reading = ImuReading {
        angular_velocity: settings.imu.angular_velocity_from(board.gyro, rest),
        angular_step: settings.imu.radians_per_lsb(),
        linear_acceleration: settings.imu.linear_acceleration(board.acceleration),
        linear_step: ACCELERATION_PER_LSB,
    };
    reading.message(header(sent, &settings.imu_frame))
}

/// The battery, of which only the voltage is measured.
pub(super) fn battery_state(sent: Time, board: &BoardReading) -> BatteryState {
    BatteryState {
        design_capacity: DESIGN_CAPACITY_AH,
        power_supply_technology: BatteryState::POWER_SUPPLY_TECHNOLOGY_LIPO,
        ..downbeat_servos::servo_bus::battery_state(sent, volts_from_raw(board.voltage))
    }
}

/// The buttons: mode, start.
pub(super) fn buttons(sent: Time, board: &BoardReading) -> Joy {
    let button = |bit: u16| i32::from(board.buttons >> bit & 1);
    Joy { header: header(sent, ""), axes: Vec::new(), buttons: vec![button(0), button(1)] }
}
