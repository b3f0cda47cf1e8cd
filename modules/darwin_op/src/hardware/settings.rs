//! The settings of the hardware module.

use super::tables::joints::{COUNT, JOINTS};
use super::tables::units::{BoardAxis, BoardRevision, CENTRE_TICKS, ImuScale, ticks_from_radians};
use downbeat_executor::{Context, Module, Setting, Setup, SetupError};
use downbeat_servos::servo_bus::bus::LineSettings;
use downbeat_servos::servo_bus::models::{self, Model, Register};
use downbeat_servos::servo_bus::protocol::Id;
use downbeat_servos::servo_bus::{BusPlan, DevicePlan, Guard, Joint, PowerSwitch, Registers};
use std::sync::Arc;
use std::time::Duration;

/// The cycle of the hardware.
pub const CYCLE: Duration = Duration::from_millis(8);

/// The keys to the settings.
#[derive(Clone, Copy)]
pub(super) struct SettingKeys {
    port: Setting<String>,
    gyro_full_scale_dps: Setting<f64>,
    p_gain: Setting<i64>,
    i_gain: Setting<i64>,
    d_gain: Setting<i64>,
    offset_ticks: Setting<Vec<i64>>,
    board: Setting<String>,
    gyro_axes: Setting<String>,
    acceleration_axes: Setting<String>,
    calibrate_gyro: Setting<bool>,
    foot_sensors: Setting<bool>,
    check_eeprom: Setting<bool>,
    shutdown_rest_s: Setting<f64>,
    hardware_id: Setting<String>,
    imu_frame: Setting<String>,
    joint_frame: Setting<String>,
}

/// The values of the settings.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Settings {
    pub(super) port: String,
    pub(super) imu: ImuScale,
    /// D, I, P: the order of the control table.
    pub(super) gains: [u8; 3],
    pub(super) offset_ticks: [i16; COUNT],
    pub(super) calibrate_gyro: bool,
    pub(super) foot_sensors: bool,
    pub(super) check_eeprom: bool,
    pub(super) shutdown_rest_s: f64,
    pub(super) hardware_id: String,
    pub(super) imu_frame: String,
    pub(super) joint_frame: String,
}

/// From power on until servos answer.
const POWER_ON: Duration = Duration::from_millis(300);
/// Below this the battery needs charging: 3.5 V for each of its three LiPo cells.
const LOW_BATTERY_V: f64 = 10.5;
/// How fast a servo that was just brought into service approaches its command, in ticks per cycle: about 2
/// rad/s.
const APPROACH_TICKS: i64 = 10;

/// By how much the stamp of a command may lie in the past or the future.
const COMMAND_TIMEOUT: Duration = Duration::from_millis(500);

impl Default for Settings {
    fn default() -> Self {
        Self {
            port: String::new(),
            imu: ImuScale::new(1600.0),
            gains: [0, 0, 32],
            offset_ticks: [0; COUNT],
            calibrate_gyro: false,
            foot_sensors: false,
            check_eeprom: false,
            shutdown_rest_s: 0.0,
            hardware_id: String::new(),
            imu_frame: String::new(),
            joint_frame: String::new(),
        }
    }
}

impl Settings {
    /// The robot with these settings.
    pub(super) fn plan(&self) -> BusPlan {
        let model = |name| models::find(name).map(Arc::clone);
        // Both are built in.
        let (Some(servo), Some(board)) = (model("MX-28"), model("CM-730")) else { unreachable!() };
        let mut devices = vec![board_plan(board)];
        if self.foot_sensors {
            devices.extend(FEET.map(|(name, id)| foot_plan(name, id)));
        }
        BusPlan {
            title: "darwin_op".to_owned(),
            name: String::new(),
            port: self.port.clone(),
            line: LineSettings::default(),
            cycle: CYCLE,
            fast_reads: false,
            joints: self.joints(&servo),
            devices,
            other_joints: Vec::new(),
        }
    }

    fn joints(&self, model: &Arc<Model>) -> Vec<Joint> {
        // A test checks that the model has all registers.
        let Ok(registers) = Registers::of(model) else { unreachable!() };
        let shutdown_rest_s = Some(self.shutdown_rest_s).filter(|rest| *rest > 0.0);
        let joint = |(joint, offset): (&super::tables::joints::Joint, i16)| Joint {
            name: joint.name.to_owned(),
            declared_at: None,
            id: joint.id,
            model: Arc::clone(model),
            registers: registers.clone(),
            drive: None,
            zero: i64::from(CENTRE_TICKS) + i64::from(offset),
            sign: 1.0,
            gear: 1.0,
            min_rad: joint.min_rad(),
            max_rad: joint.max_rad(),
            gains: self.gains.map(|gain| Some(i64::from(gain))),
            max_torque: None,
            max_current_a: None,
            further: if self.check_eeprom { persistent(model, joint) } else { Vec::new() },
            approach_steps: APPROACH_TICKS,
            command_timeout: COMMAND_TIMEOUT,
            guard: Guard { shutdown_rest_s, ..Guard::default() },
        };
        JOINTS.iter().zip(self.offset_ticks).map(joint).collect()
    }
}

/// The persistent registers of a servo, as the Bold Hearts set them: its limits are those of its joint.
fn persistent(model: &Model, joint: &super::tables::joints::Joint) -> Vec<(Register, i64)> {
    let ticks = |angle| i64::from(ticks_from_radians(angle, 0));
    let values = [
        ("min_position_limit", ticks(joint.min_rad())),
        ("max_position_limit", ticks(joint.max_rad())),
        ("temperature_limit", 80),
        ("min_voltage_limit", 60),
        ("max_voltage_limit", 140),
        ("max_torque", 1023),
        // Overload and overheating.
        ("alarm_led", 0x24),
        ("shutdown", 0x24),
    ];
    values.iter().filter_map(|(name, value)| Some((model.register(name)?.clone(), *value))).collect()
}

/// The feet with force sensors, and their ids.
pub(crate) const FEET: [(&str, Id); 2] =
    [("right foot", Id::new(111).expect("below 254")), ("left foot", Id::new(112).expect("below 254"))];

/// A foot, of which the forces and their centre are read.
fn foot_plan(name: &str, id: Id) -> DevicePlan {
    let Some(model) = models::find("FSR") else { unreachable!() };
    let read = ["fsr_1", "fsr_2", "fsr_3", "fsr_4", "fsr_x", "fsr_y"];
    DevicePlan {
        name: name.to_owned(),
        id,
        model: Arc::clone(model),
        read: read.iter().filter_map(|name| model.register(name).cloned()).collect(),
        power: None,
        battery: None,
        imu: None,
    }
}

/// The CM-730, of which everything from the power switch to the battery voltage is read.
fn board_plan(model: Arc<Model>) -> DevicePlan {
    let register = |name| model.register(name).cloned();
    let (Some(power), Some(voltage)) = (register("dynamixel_power"), register("present_voltage")) else {
        unreachable!()
    };
    DevicePlan {
        name: "CM-730".to_owned(),
        id: Id::CM730,
        read: vec![power.clone(), voltage.clone()],
        power: Some(PowerSwitch { register: power, wait: POWER_ON }),
        battery: Some((voltage, LOW_BATTERY_V)),
        imu: None,
        model,
    }
}

/// Half a turn: a larger offset is a mistake.
const MAX_OFFSET_TICKS: i64 = 2048;

impl SettingKeys {
    pub(super) fn declare<M: Module>(setup: &mut Setup<'_, M>) -> Result<Self, SetupError> {
        let gain = 0.0..=254.0;
        let keys = Self {
            port: setup.setting("port", "/dev/ttyUSB0".to_owned(), "serial port of the CM-730, taken when it is opened next")?,
            gyro_full_scale_dps: setup.setting_in(
                "gyro_full_scale_dps",
                1600.0,
                1.0..=10_000.0,
                "degrees/s that correspond to 512 steps of the gyroscope: 1600 for the CM-730, 500.5 for the CM-740",
            )?,
            p_gain: setup.setting_in("p_gain", 32, gain.clone(), "P gain of all servos, Kp = 1/8 of it")?,
            i_gain: setup.setting_in("i_gain", 0, gain.clone(), "I gain of all servos, Ki = 1000/2048 of it")?,
            d_gain: setup.setting_in("d_gain", 0, gain, "D gain of all servos, Kd = 4/1000 of it")?,
            offset_ticks: setup.setting(
                "offset_ticks",
                Vec::new(),
                "per joint in the order of the ids, added to goals and taken off positions, to make up for how the \
                 unit was built; 1 tick is 0.088 degrees; empty for none",
            )?,
            board: setup.read_only_choice(
                "board",
                "cm730",
                &["cm730", "cm740"],
                "cm730, or cm740 of the OP2, which has another scale and other axes of the IMU",
            )?,
            gyro_axes: setup.read_only_setting(
                "gyro_axes",
                String::new(),
                "axes of the board about which the gyroscope turns forward, left and up, such as \"-x -y z\"; empty for those of the board",
            )?,
            acceleration_axes: setup.read_only_setting(
                "acceleration_axes",
                String::new(),
                "axes of the board along which the accelerometer measures forward, left and up, such as \"y -x z\"; empty for those of the board",
            )?,
            calibrate_gyro: setup.read_only_setting(
                "calibrate_gyro",
                false,
                "whether the gyroscope is calibrated when the robot first stands still for 0.8 s",
            )?,
            foot_sensors: setup.read_only_setting(
                "foot_sensors",
                false,
                "whether the feet have force sensors, with the ids 111 and 112",
            )?,
            check_eeprom: setup.read_only_setting(
                "check_eeprom",
                false,
                "whether the limits and alarms that servos keep without power are written if they differ",
            )?,
            shutdown_rest_s: setup.setting_in(
                "shutdown_rest_s",
                0.0,
                0.0..=3600.0,
                "s; for how long a servo rests that has switched itself off for overload or heat, from when it is cool, until it gets its torque again; 0 leaves it off",
            )?,
            hardware_id: setup.setting(
                "hardware_id",
                "darwin_op".to_owned(),
                "which robot diagnostics speak of; say so if it is emulated",
            )?,
            imu_frame: setup.setting("imu_frame", "imu_link".to_owned(), "frame of imu/data_raw")?,
            joint_frame: setup.setting("joint_frame", String::new(), "frame of joint_states, empty by custom")?,
        };
        let offsets = setup.value(keys.offset_ticks).map_or(&[][..], Vec::as_slice);
        offsets_of(offsets).map_err(|reason| setup.refuse_value(keys.offset_ticks, reason))?;
        let board = setup.value(keys.board).map_or("", String::as_str);
        board_of(board).map_err(|reason| setup.refuse_value(keys.board, reason))?;
        for key in [keys.gyro_axes, keys.acceleration_axes] {
            let axes = setup.value(key).map_or("", String::as_str);
            axes_of(axes, BoardRevision::Cm730.gyro_axes())
                .map_err(|reason| setup.refuse_value(key, reason))?;
        }
        Ok(keys)
    }

    /// Whether the feet have force sensors.
    pub(super) fn foot_sensors<M: Module>(&self, setup: &Setup<'_, M>) -> bool {
        setup.value(self.foot_sensors).copied().unwrap_or_default()
    }

    /// Calls `changed` whenever one of the settings changes.
    pub(super) fn on_change<M: Module>(
        self,
        setup: &mut Setup<'_, M>,
        changed: fn(&mut M, &mut Context<'_, M::Ports>),
    ) {
        for text in [self.port, self.hardware_id, self.imu_frame, self.joint_frame] {
            setup.on_change(text, changed);
        }
        for gain in [self.p_gain, self.i_gain, self.d_gain] {
            setup.on_change(gain, changed);
        }
        setup.on_change(self.gyro_full_scale_dps, changed);
        setup.on_change(self.shutdown_rest_s, changed);
        setup.on_change(self.offset_ticks, changed);
    }

    /// The current values.
    ///
    /// # Errors
    /// Returns an error if the offsets are invalid.
    pub(super) fn values<P>(&self, ctx: &Context<'_, P>) -> Result<Settings, String> {
        // Between 0 and 254 by their range.
        let gain = |key| u8::try_from(*ctx.get(key)).unwrap_or(u8::MAX);
        let board = board_of(ctx.get::<String>(self.board))?;
        let gyro = axes_of(ctx.get::<String>(self.gyro_axes), board.gyro_axes())?;
        let acceleration = axes_of(ctx.get::<String>(self.acceleration_axes), board.acceleration_axes())?;
        let given = *ctx.get(self.gyro_full_scale_dps);
        // The default stands for the scale of the board.
        let is_default = given == BoardRevision::default().gyro_full_scale_dps();
        let full_scale_dps = if is_default { board.gyro_full_scale_dps() } else { given };
        Ok(Settings {
            port: ctx.get(self.port).clone(),
            imu: ImuScale::with_axes(full_scale_dps, gyro, acceleration),
            gains: [gain(self.d_gain), gain(self.i_gain), gain(self.p_gain)],
            offset_ticks: offsets_of(ctx.get::<Vec<i64>>(self.offset_ticks))?,
            calibrate_gyro: *ctx.get(self.calibrate_gyro),
            foot_sensors: *ctx.get(self.foot_sensors),
            check_eeprom: *ctx.get(self.check_eeprom),
            shutdown_rest_s: *ctx.get(self.shutdown_rest_s),
            hardware_id: ctx.get(self.hardware_id).clone(),
            imu_frame: ctx.get(self.imu_frame).clone(),
            joint_frame: ctx.get(self.joint_frame).clone(),
        })
    }
}

fn board_of(name: &str) -> Result<BoardRevision, String> {
    match name {
        "cm730" => Ok(BoardRevision::Cm730),
        "cm740" => Ok(BoardRevision::Cm740),
        other => Err(format!("setting \"board\" is \"{other}\", it must be \"cm730\" or \"cm740\"")),
    }
}

fn axes_of(given: &str, of_board: [BoardAxis; 3]) -> Result<[BoardAxis; 3], String> {
    if given.is_empty() {
        return Ok(of_board);
    }
    let axes: Option<Vec<BoardAxis>> = given.split_whitespace().map(BoardAxis::parse).collect();
    let refused =
        || format!("the axes \"{given}\" must be three of x, y, z, -x, -y and -z: forward, left, up");
    axes.and_then(|axes| axes.try_into().ok()).ok_or_else(refused)
}

fn offsets_of(given: &[i64]) -> Result<[i16; COUNT], String> {
    if given.is_empty() {
        return Ok([0; COUNT]);
    }
    let Ok(given) = <&[i64; COUNT]>::try_from(given) else {
        return Err(format!(
            "setting \"offset_ticks\" has {} numbers, it needs {COUNT} or none",
            given.len()
        ));
    };
    for (offset, joint) in given.iter().zip(&JOINTS) {
        if offset.abs() > MAX_OFFSET_TICKS {
            let name = joint.name;
            return Err(format!(
                "setting \"offset_ticks\" has {offset} for {name}, it must be within {MAX_OFFSET_TICKS}"
            ));
        }
    }
    Ok(given.map(|offset| i16::try_from(offset).unwrap_or(0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_are_none_or_one_per_joint_and_not_too_large() {
        assert_eq!(offsets_of(&[]), Ok([0; COUNT]));
        let mut given = [0; COUNT];
        given[3] = -12;
        assert_eq!(offsets_of(&given).map(|offsets| offsets[3]), Ok(-12));
        assert!(offsets_of(&[1, 2]).is_err_and(|error| error.contains("has 2 numbers")));
        given[3] = 5000;
        assert!(offsets_of(&given).is_err_and(|error| error.contains("5000 for l_sho_roll")));
    }
}
