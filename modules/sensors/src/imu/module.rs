//! The module that reads an inertial sensor.

use std::collections::VecDeque;
use std::time::Duration;

use downbeat_device::counted::Counted;
use downbeat_device::{Device, DeviceLink};
use downbeat_executor::{Context, Module, Publication, Setting, Setup, SetupError, Time, TransitionError};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::geometry_msgs::msg::{Quaternion, Vector3};
use downbeat_msgs::sensor_msgs::msg::{Imu as ImuMessage, MagneticField, Temperature};

use super::axes::Axes;
use super::bno055::{self, Bno055, BnoSettings, CALIBRATION, Mode};
use super::bus::{I2cDevice, Request};
use super::emulator::Model;
use super::mpu::{self, ACCELERATION_RANGES, GYRO_RANGES, Mpu, MpuSettings, Variant};
use super::{Chip, Reading, Registers, Step};
use crate::diagnostics::{Reporter, Status, header, value};

/// When the bus is opened again after it was lost; the wait doubles up to the longest.
const FIRST_WAIT: Duration = Duration::from_millis(100);
const LONGEST_WAIT: Duration = Duration::from_secs(2);
/// How many measurements in a row may fail until the chip is set up again.
const MOST_MISSED: u32 = 5;
/// How often the temperature is published.
const SLOW: Duration = Duration::from_secs(1);
/// For how long a failed measurement is a warning.
const RECENT: Duration = Duration::from_secs(2);

/// An inertial sensor on I²C.
///
/// | topic | type | |
/// | --- | --- | --- |
/// | `imu/data_raw` | `sensor_msgs/Imu` | rad/s and m/s², without orientation |
/// | `imu/data` | `sensor_msgs/Imu` | the same with the orientation of the BNO055 |
/// | `imu/mag` | `sensor_msgs/MagneticField` | T; BNO055 with all sensors, MPU-9250 |
/// | `imu/temperature` | `sensor_msgs/Temperature` | °C, of the chip, once a second |
/// | `diagnostics` | `diagnostic_msgs/DiagnosticArray` | once a second and when the level changes |
/// | `imu/exchanges` | `downbeat_interfaces/BusExchange` | all traffic with the chip, for replays |
///
/// Run it detached: it waits for the bus. docs/sensors.md lists the settings.
pub struct Imu {
    link: DeviceLink<I2cDevice>,
    chip: Option<Box<dyn Chip>>,
    bus: String,
    axes: Option<Axes>,
    frame_id: String,
    hardware_id: String,
    phase: Phase,
    measurements: u64,
    /// Measurements in a row that failed.
    missed: u32,
    last_missed: Option<Time>,
    failures: Counted,
    losses: Counted,
    last_temperature: Option<Time>,
    reporter: Reporter,
}

#[derive(Debug)]
enum Phase {
    Closed {
        not_before: Time,
        wait: Duration,
        reason: String,
    },
    /// `wait` is how long to wait if this fails.
    SettingUp {
        steps: VecDeque<Step>,
        not_before: Time,
        wait: Duration,
    },
    Measuring,
}

/// The keys of [`Imu`].
pub struct Ports {
    raw: Publication<ImuMessage>,
    data: Option<Publication<ImuMessage>>,
    magnetic: Option<Publication<MagneticField>>,
    temperature: Publication<Temperature>,
    exchanges: Publication<BusExchange>,
    diagnostics: Publication<DiagnosticArray>,
    gyro_offset: Setting<Vec<f64>>,
    acceleration_offset: Setting<Vec<f64>>,
    magnetic_offset: Setting<Vec<f64>>,
    angular_deviation: Setting<f64>,
    linear_deviation: Setting<f64>,
    magnetic_deviation: Setting<f64>,
    orientation_deviation: Setting<f64>,
}

impl Imu {
    /// A sensor behind this link.
    #[must_use]
    pub fn new(link: DeviceLink<I2cDevice>) -> Self {
        Self {
            link,
            chip: None,
            bus: String::new(),
            axes: None,
            frame_id: String::new(),
            hardware_id: String::new(),
            phase: Phase::Closed {
                not_before: Time::ZERO,
                wait: FIRST_WAIT,
                reason: "the bus is not open yet".to_owned(),
            },
            measurements: 0,
            missed: 0,
            last_missed: None,
            failures: Counted::default(),
            losses: Counted::default(),
            last_temperature: None,
            reporter: Reporter::default(),
        }
    }

    fn run(&mut self, ctx: &mut Context<'_, Ports>) {
        match &self.phase {
            Phase::Closed { not_before, .. } if ctx.now() < *not_before => {}
            Phase::Closed { wait, .. } => {
                let wait = *wait;
                self.open(wait, ctx);
            }
            Phase::SettingUp { .. } => self.set_up(ctx),
            Phase::Measuring => self.measure(ctx),
        }
        self.diagnose(ctx);
    }

    fn ask(&mut self, request: &Request, ctx: &mut Context<'_, Ports>) -> Result<BusExchange, String> {
        let exchange = self.link.exchange(request, ctx.ports.exchanges, ctx);
        if exchange.outcome == BusExchange::OK { Ok(exchange) } else { Err(exchange.error) }
    }

    fn open(&mut self, wait: Duration, ctx: &mut Context<'_, Ports>) {
        match self.ask(&Request::Open, ctx) {
            Ok(_) => {
                let steps = self.chip.as_mut().map(|chip| chip.begin()).unwrap_or_default().into();
                self.phase = Phase::SettingUp { steps, not_before: ctx.now(), wait };
            }
            Err(error) => self.fail(error, wait, ctx),
        }
    }

    /// Closes the bus, to open it again after `wait`.
    fn fail(&mut self, reason: String, wait: Duration, ctx: &mut Context<'_, Ports>) {
        if self.losses.is_worth_a_line() {
            tracing::warn!("{}: {reason}; trying again", ctx.module_name());
        }
        self.link.exchange(&Request::Close, ctx.ports.exchanges, ctx);
        self.phase =
            Phase::Closed { not_before: ctx.now() + wait, wait: (wait * 2).min(LONGEST_WAIT), reason };
    }

    /// Does the steps until the next pause.
    fn set_up(&mut self, ctx: &mut Context<'_, Ports>) {
        loop {
            let Phase::SettingUp { steps, not_before, wait } = &mut self.phase else { return };
            if ctx.now() < *not_before {
                return;
            }
            let wait = *wait;
            let done = match steps.pop_front() {
                None => {
                    tracing::info!("{}: the {} on {} measures", ctx.module_name(), self.title(), self.bus);
                    self.missed = 0;
                    self.phase = Phase::Measuring;
                    return;
                }
                Some(Step::Pause(pause)) => {
                    *not_before = ctx.now() + pause;
                    return;
                }
                Some(Step::Write { address, register, values }) => {
                    let bytes = [&[register], &values[..]].concat();
                    self.ask(&Request::Write { address, bytes }, ctx).map(drop)
                }
                Some(Step::Read(registers)) => self.learn(registers, ctx),
            };
            if let Err(reason) = done {
                return self.fail(reason, wait, ctx);
            }
        }
    }

    fn learn(&mut self, registers: Registers, ctx: &mut Context<'_, Ports>) -> Result<(), String> {
        let exchange = self.ask(&request(registers), ctx)?;
        let learned = self.chip.as_mut().map(|chip| chip.learn(registers, &exchange.reply));
        if let (Some(learned), Phase::SettingUp { steps, .. }) = (learned, &mut self.phase) {
            learned?.into_iter().rev().for_each(|step| steps.push_front(step));
        }
        Ok(())
    }

    fn measure(&mut self, ctx: &mut Context<'_, Ports>) {
        let all = self.chip.as_ref().map(|chip| chip.registers()).unwrap_or_default();
        let mut reading = Reading::default();
        let mut stamp = ctx.now();
        for (index, registers) in all.into_iter().enumerate() {
            let exchange = match self.ask(&request(registers), ctx) {
                Ok(exchange) => exchange,
                Err(error) => return self.miss(error, ctx),
            };
            if index == 0 {
                let sent = Time::from_nanos(exchange.stamp.as_nanos());
                stamp = sent + Duration::from_micros(exchange.duration_us.into());
            }
            let read = self.chip.as_mut().map(|chip| chip.read(registers, &exchange.reply, &mut reading));
            if let Some(Err(reason)) = read {
                return self.fail(reason, FIRST_WAIT, ctx);
            }
        }
        self.missed = 0;
        self.measurements += 1;
        self.publish(&reading, stamp, ctx);
    }

    fn miss(&mut self, error: String, ctx: &mut Context<'_, Ports>) {
        self.missed += 1;
        self.last_missed = Some(ctx.now());
        if self.failures.is_worth_a_line() {
            tracing::warn!("{}: a measurement failed: {error}", ctx.module_name());
        }
        if self.missed >= MOST_MISSED {
            self.fail(error, FIRST_WAIT, ctx);
        }
    }

    fn publish(&mut self, reading: &Reading, stamp: Time, ctx: &mut Context<'_, Ports>) {
        let Some(axes) = self.axes else { return };
        let header = || header(stamp, &self.frame_id);
        let less = |measured: [f64; 3], offset: &[f64]| {
            let [x, y, z] = axes.turn(measured);
            let offset = |index: usize| offset.get(index).copied().unwrap_or_default();
            Vector3 { x: x - offset(0), y: y - offset(1), z: z - offset(2) }
        };
        let diagonal = |deviation: f64| {
            let variance = deviation * deviation;
            [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance]
        };
        if let (Some(rate), Some(acceleration)) = (reading.angular_velocity, reading.acceleration) {
            let mut orientation_covariance = [0.0; 9];
            // Not measured.
            orientation_covariance[0] = -1.0;
            let raw = ImuMessage {
                header: header(),
                orientation_covariance,
                angular_velocity: less(rate, ctx.get::<Vec<f64>>(ctx.ports.gyro_offset)),
                angular_velocity_covariance: diagonal(*ctx.get(ctx.ports.angular_deviation)),
                linear_acceleration: less(acceleration, ctx.get::<Vec<f64>>(ctx.ports.acceleration_offset)),
                linear_acceleration_covariance: diagonal(*ctx.get(ctx.ports.linear_deviation)),
                ..ImuMessage::default()
            };
            if let (Some(topic), Some(orientation)) = (ctx.ports.data, reading.orientation) {
                let [x, y, z, w] = axes.turn_orientation(orientation);
                let orientation_covariance = diagonal(*ctx.get(ctx.ports.orientation_deviation));
                let data = ImuMessage {
                    orientation: Quaternion { x, y, z, w },
                    orientation_covariance,
                    ..raw.clone()
                };
                ctx.publish(topic, data);
            }
            ctx.publish(ctx.ports.raw, raw);
        }
        if let (Some(topic), Some(field)) = (ctx.ports.magnetic, reading.magnetic_field) {
            let magnetic_field = less(field, ctx.get::<Vec<f64>>(ctx.ports.magnetic_offset));
            let magnetic_field_covariance = diagonal(*ctx.get(ctx.ports.magnetic_deviation));
            ctx.publish(topic, MagneticField { header: header(), magnetic_field, magnetic_field_covariance });
        }
        let is_due = self.last_temperature.is_none_or(|at| at + SLOW <= ctx.now());
        if let (Some(temperature), true) = (reading.temperature, is_due) {
            self.last_temperature = Some(ctx.now());
            ctx.publish(ctx.ports.temperature, Temperature { header: header(), temperature, variance: 0.0 });
        }
    }

    fn title(&self) -> &'static str {
        self.chip.as_ref().map_or("sensor", |chip| chip.title())
    }

    fn diagnose(&mut self, ctx: &mut Context<'_, Ports>) {
        let was_missed = self.last_missed.is_some_and(|at| ctx.now() < at + RECENT);
        let (level, message) = match &self.phase {
            Phase::Closed { reason, .. } => (DiagnosticStatus::ERROR, &**reason),
            Phase::SettingUp { .. } => (DiagnosticStatus::WARN, "setting up the chip"),
            Phase::Measuring if was_missed => {
                (DiagnosticStatus::WARN, "measuring, but some measurements fail")
            }
            Phase::Measuring => (DiagnosticStatus::OK, "measuring"),
        };
        let title = self.title();
        let status = || {
            let mut values = vec![
                value("bus", &self.bus),
                value("chip", title),
                value("measurements", self.measurements),
                value("failed measurements", self.failures.count()),
                value("times that the bus or the chip was lost", self.losses.count()),
            ];
            let state = self.chip.as_ref().and_then(|chip| chip.state());
            values.extend(state.map(|state| value("calibration", state)));
            Status { message: message.to_owned(), hardware_id: self.hardware_id.clone(), values }
        };
        self.reporter.report(level, ctx.ports.diagnostics, ctx, status);
    }

    fn stop(&mut self, ctx: &mut Context<'_, Ports>) {
        if !matches!(self.phase, Phase::Closed { .. }) {
            self.link.exchange(&Request::Close, ctx.ports.exchanges, ctx);
        }
        let reason = "the bus is not open yet".to_owned();
        self.phase = Phase::Closed { not_before: Time::ZERO, wait: FIRST_WAIT, reason };
    }
}

fn request(Registers { address, first, length }: Registers) -> Request {
    Request::Read { address, register: first, length }
}

impl Module for Imu {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let model = setup.read_only_choice("model", "mpu6050", &Model::NAMES, "which chip it is")?;
        let bus = setup.read_only_setting("bus", "/dev/i2c-1".to_owned(), "I²C bus, or memory:NAME")?;
        let about = "seven bits; 0 for the first one of the chip: 0x68 of an MPU (0x69 with AD0 high), 0x28 of a BNO055 (0x29 with COM3 high)";
        let address = setup.read_only_setting("address", 0_i64, about)?;
        let rate = setup.read_only_setting(
            "rate",
            100.0,
            "Hz, from 1 to 500; a BNO055 measures at 100 Hz at most",
        )?;
        let frame_id = setup.read_only_setting("frame_id", "imu_link".to_owned(), "frame of the messages")?;
        let about = "the chip's axes that point forward, left and up, such as \"-y x z\"";
        let axes = setup.read_only_setting("axes", "x y z".to_owned(), about)?;
        let about = "°/s: 250, 500, 1000 or 2000; of an MPU";
        let gyro_range = setup.read_only_setting("gyro_range", 500_i64, about)?;
        let about = "g: 2, 4, 8 or 16; of an MPU";
        let acceleration_range = setup.read_only_setting("acceleration_range", 4_i64, about)?;
        let about = "what the fusion of a BNO055 uses: all sensors (ndof), or not the magnetometer (imu)";
        let mode = setup.read_only_choice("mode", "ndof", &["ndof", "imu"], about)?;
        let about = "the board of a BNO055 has a crystal, which makes it more exact";
        let has_crystal = setup.read_only_setting("crystal", false, about)?;
        let about = "registers 0x55 to 0x6A of a calibrated BNO055 as 11 numbers: offsets of accelerometer, magnetometer and gyroscope, two radii";
        let calibration = setup.read_only_setting("calibration", Vec::<i64>::new(), about)?;
        let about = "the device in diagnostics; empty for the model; say there if it is emulated";
        let hardware_id = setup.read_only_setting("hardware_id", String::new(), about)?;
        let mut offset = |name: &str, about: &str| {
            let setting = setup.setting(name, vec![0.0, 0.0, 0.0], about)?;
            setup.accept_if(setting, |_, offset: &Vec<f64>| three(offset));
            let refused = setup.value(setting).map_or(Ok(()), |offset: &Vec<f64>| three(offset)).err();
            refused.map_or(Ok(setting), |refusal| Err(setup.refuse_value(setting, refusal)))
        };
        let gyro_offset =
            offset("gyro_offset", "rad/s; what the gyroscope shows at rest, forward, left, up; subtracted")?;
        let acceleration_offset = offset("acceleration_offset", "m/s²; forward, left, up; subtracted")?;
        let magnetic_offset =
            offset("magnetic_offset", "T; of the robot's own iron, forward, left, up; subtracted")?;
        let text = |setting| setup.value(setting).cloned().unwrap_or_default();
        let number = |setting| setup.value(setting).copied().unwrap_or_default();

        let model = Model::named(&text(model)).unwrap_or_default();
        self.axes =
            Some(text(axes).parse::<Axes>().map_err(|error| setup.refuse_value(axes, error.to_string()))?);
        let default = if model == Model::Bno055 { bno055::ADDRESS } else { mpu::ADDRESS };
        let chip_address = match number(address) {
            0 => default,
            // Others are reserved.
            given @ 0x08..=0x77 => given as u8,
            _ => {
                return Err(
                    setup.refuse_value(address, "it is an address of seven bits, from 0x08 to 0x77, or 0")
                );
            }
        };
        let hertz = setup.value(rate).copied().unwrap_or_default();
        if !(1.0..=500.0).contains(&hertz) {
            return Err(setup.refuse_value(rate, "it has to lie between 1 and 500 Hz"));
        }
        let position = |ranges: &[(i64, f64); 4], range| ranges.iter().position(|(known, _)| *known == range);
        let gyro = position(&GYRO_RANGES, number(gyro_range))
            .ok_or_else(|| setup.refuse_value(gyro_range, "it is 250, 500, 1000 or 2000 °/s"))?;
        let acceleration = position(&ACCELERATION_RANGES, number(acceleration_range))
            .ok_or_else(|| setup.refuse_value(acceleration_range, "it is 2, 4, 8 or 16 g"))?;
        let mode = if text(mode) == "imu" { Mode::Imu } else { Mode::Ndof };
        let registers = setup.value(calibration).cloned().unwrap_or_default();
        let known: Option<[i16; CALIBRATION]> = registers
            .iter()
            .map(|value| i16::try_from(*value).ok())
            .collect::<Option<Vec<i16>>>()
            .and_then(|values| values.try_into().ok());
        if known.is_none() && !registers.is_empty() {
            return Err(setup.refuse_value(calibration, "it is 11 numbers of 16 bits"));
        }
        let of_mpu = |expected| -> Box<dyn Chip> {
            let (gyro_range, acceleration_range) = (gyro, acceleration);
            Box::new(Mpu::new(MpuSettings {
                address: chip_address,
                expected,
                gyro_range,
                acceleration_range,
                rate: hertz,
            }))
        };
        let chip = match model {
            Model::Mpu6050 => of_mpu(Variant::Mpu6050),
            Model::Mpu6500 => of_mpu(Variant::Mpu6500),
            Model::Mpu9250 => of_mpu(Variant::Mpu9250),
            Model::Bno055 => {
                let has_crystal = setup.value(has_crystal).copied().unwrap_or_default();
                Box::new(Bno055::new(BnoSettings {
                    address: chip_address,
                    mode,
                    has_crystal,
                    calibration: known,
                }))
            }
        };
        self.bus = text(bus);
        self.frame_id = text(frame_id);
        self.hardware_id =
            Some(text(hardware_id)).filter(|id| !id.is_empty()).unwrap_or(chip.title().to_owned());
        self.chip = Some(chip);
        if let Some(device) = self.link.device() {
            device.configure(&self.bus);
        }
        setup.every(Duration::from_secs_f64(1.0 / hertz), Self::run)?;
        let has_field = model == Model::Mpu9250 || (model == Model::Bno055 && mode == Mode::Ndof);
        let range = 0.0..=100.0;
        Ok(Ports {
            raw: setup.publish("imu/data_raw")?,
            data: (model == Model::Bno055).then(|| setup.publish("imu/data")).transpose()?,
            magnetic: has_field.then(|| setup.publish("imu/mag")).transpose()?,
            temperature: setup.publish("imu/temperature")?,
            exchanges: setup.publish(I2cDevice::TOPIC)?,
            diagnostics: setup.publish("diagnostics")?,
            gyro_offset,
            acceleration_offset,
            magnetic_offset,
            angular_deviation: setup.setting_in(
                "angular_velocity_deviation",
                0.001,
                range.clone(),
                "rad/s; standard deviation to report",
            )?,
            linear_deviation: setup.setting_in(
                "linear_acceleration_deviation",
                0.04,
                range.clone(),
                "m/s²; standard deviation to report",
            )?,
            magnetic_deviation: setup.setting_in(
                "magnetic_field_deviation",
                1e-6,
                range.clone(),
                "T; standard deviation to report",
            )?,
            orientation_deviation: setup.setting_in(
                "orientation_deviation",
                0.05,
                range,
                "rad; standard deviation to report, of a BNO055",
            )?,
        })
    }

    fn deactivate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        self.stop(ctx);
        Ok(())
    }

    fn shutdown(&mut self, ctx: &mut Context<'_, Ports>) {
        self.stop(ctx);
    }
}

fn three(offset: &[f64]) -> Result<(), String> {
    let is_valid = offset.len() == 3 && offset.iter().all(|value| value.is_finite());
    if is_valid { Ok(()) } else { Err("it is three numbers: forward, left, up".to_owned()) }
}
