//! The hardware of a robot of serial servos as a module.

use super::bus::{Bus, Exchange, SerialBus};
use super::description::{BusPlan, Description, DevicePlan};
use super::diagnostics::{Labels, Levels, Refused, levels, report};
use super::driver::Driver;
use super::joint::Quantity;
use super::models::Register;
use super::protocol::{Id, Protocol, WriteEntry};
use super::reading::Reading;
use crate::stamps::{Stale, given_at, header};
use downbeat_device::counted::Counted;
use downbeat_executor::{Context, Module, Publication, Received, Setup, SetupError, Time, TransitionError};
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticArray;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::geometry_msgs::msg::Vector3;
use downbeat_msgs::sensor_msgs::msg::{BatteryState, Imu, JointState};
use downbeat_msgs::std_msgs::msg::{Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout};
use downbeat_msgs::std_srvs::srv::SetBoolResponse;
use std::time::Duration;

/// The period of slowly changing data.
pub const SLOW: Duration = Duration::from_secs(1);

/// The servos of one bus, with everything that is common to all robots: for the modules that drive them.
pub struct Hardware {
    bus: Box<dyn Bus>,
    pub(crate) driver: Driver,
    /// The robot that is driven.
    pub plan: BusPlan,
    /// Which robot diagnostics speak of.
    pub hardware_id: String,
    /// The frame of `joint_states`.
    pub joint_frame: String,
    /// The topics of its joints, `joint_states` and `joint_commands` after remaps, which diagnostics name.
    /// Empty if they do not, as those in recorded bags of the Darwin OP.
    joint_topics: Vec<(&'static str, String)>,
    /// Whether diagnostics report late cycles, and say with each fault where it is and what to do. Those in
    /// recorded bags of the Darwin OP do not.
    is_detailed: bool,
    exchanges: Vec<Exchange>,
    unknown_names: Counted,
    refused: Refused,
    stale: Stale,
    last_diagnostics: Option<(Time, Levels)>,
}

/// The topics that all robots have.
#[derive(Clone, Copy)]
pub struct Topics {
    joint_states: Publication<JointState>,
    diagnostics: Publication<DiagnosticArray>,
    exchanges: Publication<BusExchange>,
}

impl Topics {
    /// Declares them.
    ///
    /// # Errors
    /// See [`Setup::publish`].
    pub fn declare<M: Module>(setup: &mut Setup<'_, M>) -> Result<Self, SetupError> {
        Ok(Self {
            joint_states: setup.publish("joint_states")?,
            diagnostics: setup.publish("diagnostics")?,
            exchanges: setup.publish("bus/exchanges")?,
        })
    }
}

impl Hardware {
    /// The servos of this plan on this bus. Diagnostics report late cycles, and place and remedy of each
    /// fault, if `is_detailed`.
    #[must_use]
    pub fn new(bus: Box<dyn Bus>, plan: BusPlan, is_detailed: bool) -> Self {
        Self {
            bus,
            driver: driver_of(&plan, is_detailed),
            hardware_id: plan.title.clone(),
            plan,
            joint_frame: String::new(),
            joint_topics: Vec::new(),
            is_detailed,
            exchanges: Vec::new(),
            unknown_names: Counted::default(),
            refused: Refused::default(),
            stale: Stale::default(),
            last_diagnostics: None,
        }
    }

    /// Drives this robot from now on, which may have other devices. Only before the first step.
    pub fn describe(&mut self, plan: BusPlan) {
        self.driver = driver_of(&plan, self.is_detailed);
        self.plan = plan;
    }

    /// Writes to a device beside servos, in one of the next cycles. A write that waits for the same range is
    /// replaced.
    pub fn write_later(&mut self, entry: WriteEntry) {
        let waiting = &mut self.driver.to_write;
        waiting.retain(|other| (other.id, other.address) != (entry.id, entry.address));
        waiting.push_back(entry);
    }

    /// Takes commanded positions, velocities and efforts: unknown names are logged and counted, impossible
    /// values refused, others clamped to the limits.
    pub fn on_command(&mut self, command: &JointState, now: Time) {
        let JointState { position, velocity, effort, .. } = command;
        let mut stale = None;
        for (place, name) in command.name.iter().enumerate() {
            if [position, velocity, effort].iter().all(|values| place >= values.len()) {
                continue;
            }
            let Some(index) = self.index_of(name, "joint_commands") else { continue };
            let values = match self.plan.joints[index].drive.as_ref().map(|drive| drive.quantity) {
                None => position,
                Some(Quantity::Velocity) => velocity,
                Some(Quantity::Effort) => effort,
            };
            let given = match given_at(&command.header.stamp, now, self.plan.joints[index].command_timeout) {
                Ok(given) => given,
                Err(reason) => {
                    stale = Some(reason);
                    continue;
                }
            };
            match self.commanded(index, values.get(place).copied()) {
                Ok(goal) => self.driver.servos[index].want(goal, given),
                Err(reason) => self.refuse(reason, now),
            }
        }
        self.drop_stale(stale, "joint_commands", now);
    }

    /// Counts a message of which something is dropped for its stamp.
    fn drop_stale(&mut self, reason: Option<String>, topic: &str, now: Time) {
        let Some(reason) = reason else { return };
        self.stale.drop_for(topic, &reason);
        self.refused.stale = self.stale.count();
        self.refused.last = Some((now, format!("{topic}: {reason}")));
    }

    /// The goal of a joint for a commanded value, or why it is refused.
    fn commanded(&self, index: usize, value: Option<f64>) -> Result<i64, String> {
        if let Some(reason) = self.driver.misfit(&self.plan) {
            return Err(reason);
        }
        let joint = &self.plan.joints[index];
        let (name, min, max) = (&joint.name, joint.min_rad, joint.max_rad);
        let (quantities, unit) = match joint.drive.as_ref().map(|drive| drive.quantity) {
            None => ("positions", "rad"),
            Some(Quantity::Velocity) => ("velocities", "rad/s"),
            Some(Quantity::Effort) => ("efforts", "A"),
        };
        let Some(value) = value else {
            return Err(format!("joint_commands has none of the {quantities} that {name} takes"));
        };
        let (goal, range) = match &joint.drive {
            None => (joint.goal(value), format!("limits are {min} to {max}")),
            Some(drive) => (joint.driven_goal(drive, value), format!("largest is {}", drive.largest)),
        };
        goal.ok_or_else(|| {
            format!(
                "joint_commands has {value} {unit} for {name}, whose {range} {unit}; check unit and sender"
            )
        })
    }

    /// Takes commanded shares of the largest torque.
    pub fn on_torque(&mut self, command: &JointState, now: Time) {
        let mut stale = None;
        for (name, share) in command.name.iter().zip(&command.effort) {
            let Some(index) = self.index_of(name, "joint_torque") else { continue };
            if share.is_finite() {
                // Torque is ended by any command, however late.
                let timeout = self.plan.joints[index].command_timeout;
                if let (true, Err(reason)) = (*share > 0.0, given_at(&command.header.stamp, now, timeout)) {
                    stale = Some(reason);
                } else if let Err(reason) = self.command_torque(index, *share) {
                    self.refuse(reason, now);
                }
            } else {
                self.refuse(format!("joint_torque has {share} for {name}; give a share from 0 to 1"), now);
            }
        }
        self.drop_stale(stale, "joint_torque", now);
    }

    fn refuse(&mut self, reason: String, now: Time) {
        if self.refused.count.is_worth_a_line() {
            let count = self.refused.count.count();
            tracing::warn!("a command is refused ({count} times so far): {reason}");
        }
        self.refused.last = Some((now, reason));
    }

    /// Commands a share of the largest torque of a joint, or says why it stays limp.
    fn command_torque(&mut self, index: usize, share: f64) -> Result<(), String> {
        let (servo, joint) = (&mut self.driver.servos[index], &self.plan.joints[index]);
        match servo.limp(joint).filter(|_| share > 0.0) {
            Some(limp) => Err(limp.words(joint)),
            None => {
                servo.command_torque(share);
                Ok(())
            }
        }
    }

    /// Switches the torque of all joints, except those that have to stay limp.
    pub fn set_torque(&mut self, is_on: bool) -> SetBoolResponse {
        let (count, state, share) =
            if is_on { (self.plan.joints.len(), "on", 1.0) } else { (self.plan.joints.len(), "off", 0.0) };
        let refused: Vec<String> =
            (0..count).filter_map(|index| self.command_torque(index, share).err()).collect();
        let switched = format!("the torque of {} joints is switched {state}", count - refused.len());
        SetBoolResponse {
            success: refused.is_empty(),
            message: refused.into_iter().chain([switched]).collect::<Vec<_>>().join("; "),
        }
    }

    fn index_of(&mut self, name: &str, topic: &str) -> Option<usize> {
        let index = self.plan.joints.iter().position(|joint| joint.name == name);
        if index.is_none()
            && !self.plan.other_joints.iter().any(|other| other == name)
            && self.unknown_names.is_worth_a_line()
        {
            let count = self.unknown_names.count();
            tracing::warn!("{topic} contains \"{name}\", which is not a joint ({count} times so far)");
        }
        index
    }

    /// Does one step of the driver, and publishes its exchanges and the joints.
    pub fn step<P>(&mut self, topics: Topics, ctx: &mut Context<'_, P>) -> Option<Reading> {
        self.bus.set_line(self.plan.line);
        let reading = self.driver.step(ctx.now(), &self.plan, &mut *self.bus, &mut self.exchanges);
        self.publish_exchanges(topics, ctx);
        if let Some(reading) = reading.as_ref().filter(|reading| reading.has_joints) {
            ctx.publish(topics.joint_states, self.joint_state(reading));
        }
        reading
    }

    /// Publishes diagnostics, if they are due or have changed.
    pub fn diagnose<P>(&mut self, topics: Topics, ctx: &mut Context<'_, P>) {
        let now = ctx.now();
        let labels = Labels {
            hardware_id: &self.hardware_id,
            unknown_names: self.unknown_names.count(),
            refused: &self.refused,
            joint_topics: &self.joint_topics,
            is_detailed: self.is_detailed,
        };
        let levels = levels(now, &self.plan, &self.driver, &labels);
        if self.last_diagnostics.as_ref().is_none_or(|(at, last)| *at + SLOW <= now || *last != levels) {
            ctx.publish(topics.diagnostics, report(now, &self.plan, &self.driver, &labels));
            self.last_diagnostics = Some((now, levels));
        }
    }

    /// Serves the port again, after the module was activated again.
    pub fn resume(&mut self) {
        self.driver.resume();
    }

    /// Stops the joints that are driven by velocities or efforts.
    pub fn rest<P>(&mut self, topics: Topics, ctx: &mut Context<'_, P>) {
        self.driver.rest(ctx.now(), &self.plan, &mut *self.bus, &mut self.exchanges);
        self.publish_exchanges(topics, ctx);
    }

    /// Closes the port after this write to a device: its address, the bytes, and where they go.
    pub fn stop<P>(
        &mut self,
        last_write: Option<(Id, &[u8], u16)>,
        topics: Topics,
        ctx: &mut Context<'_, P>,
    ) {
        self.driver.stop(ctx.now(), &self.plan, last_write, &mut *self.bus, &mut self.exchanges);
        self.publish_exchanges(topics, ctx);
    }

    fn publish_exchanges<P>(&mut self, topics: Topics, ctx: &mut Context<'_, P>) {
        for exchange in self.exchanges.drain(..) {
            ctx.publish(topics.exchanges, BusExchange::from(&exchange));
        }
    }

    /// All joints. A stale one keeps its last position and has NaN as velocity and effort, and as position if
    /// it was never read.
    fn joint_state(&self, reading: &Reading) -> JointState {
        let count = self.plan.joints.len();
        let mut message = JointState {
            header: header(reading.sent, &self.joint_frame),
            name: self.plan.joints.iter().map(|joint| joint.name.clone()).collect(),
            position: Vec::with_capacity(count),
            velocity: Vec::with_capacity(count),
            effort: Vec::with_capacity(count),
        };
        for (servo, joint) in self.driver.servos.iter().zip(&self.plan.joints) {
            let fresh = servo.last.filter(|_| !servo.link.is_stale());
            message.position.push(servo.last.map_or(f64::NAN, |last| joint.angle(last.position)));
            message.velocity.push(fresh.map_or(f64::NAN, |last| last.velocity));
            message.effort.push(fresh.map_or(f64::NAN, |last| last.effort));
        }
        message
    }
}

fn driver_of(plan: &BusPlan, is_detailed: bool) -> Driver {
    let driver = Driver::new(plan.joints.len(), plan.devices.len());
    if is_detailed { driver } else { driver.with_recorded_freshness() }
}

/// What an IMU measured, forward, left and up, with the steps of its numbers, in rad/s and m/s^2.
pub struct ImuReading {
    /// In rad/s.
    pub angular_velocity: [f64; 3],
    /// One step of the gyroscope, in rad/s.
    pub angular_step: f64,
    /// In m/s^2.
    pub linear_acceleration: [f64; 3],
    /// One step of the accelerometer, in m/s^2.
    pub linear_step: f64,
}

impl ImuReading {
    /// The reading of a device with an IMU.
    pub(super) fn of<'a>(
        device: &'a DevicePlan,
        protocol: Protocol,
        piece: &[u8],
    ) -> Option<(Self, &'a str)> {
        let imu = device.imu.as_ref()?;
        let axis = |(sign, register): &(f64, Register)| Some(sign * device.value(protocol, register, piece)?);
        let axes = |[x, y, z]: &[_; 3]| Some([axis(x)?, axis(y)?, axis(z)?]);
        let reading = Self {
            angular_velocity: axes(&imu.angular_velocity)?,
            angular_step: imu.angular_velocity[0].1.to_si(1),
            linear_acceleration: axes(&imu.linear_acceleration)?,
            linear_step: imu.linear_acceleration[0].1.to_si(1),
        };
        Some((reading, &imu.frame))
    }

    /// The message. The orientation is not measured, as marked by -1; the covariances take one step as
    /// standard deviation.
    #[must_use]
    pub fn message(&self, header: Header) -> Imu {
        let vector = |[x, y, z]: [f64; 3]| Vector3 { x, y, z };
        let diagonal = |deviation: f64| {
            let variance = deviation * deviation;
            [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance]
        };
        let mut orientation_covariance = [0.0; 9];
        orientation_covariance[0] = -1.0;
        Imu {
            header,
            orientation_covariance,
            angular_velocity: vector(self.angular_velocity),
            angular_velocity_covariance: diagonal(self.angular_step),
            linear_acceleration: vector(self.linear_acceleration),
            linear_acceleration_covariance: diagonal(self.linear_step),
            ..Imu::default()
        }
    }
}

/// A battery of which only the voltage is measured.
#[must_use]
pub fn battery_state(sent: Time, volts: f64) -> BatteryState {
    BatteryState {
        header: header(sent, ""),
        voltage: volts as f32,
        temperature: f32::NAN,
        current: f32::NAN,
        charge: f32::NAN,
        capacity: f32::NAN,
        design_capacity: f32::NAN,
        percentage: f32::NAN,
        power_supply_status: BatteryState::POWER_SUPPLY_STATUS_UNKNOWN,
        power_supply_health: BatteryState::POWER_SUPPLY_HEALTH_UNKNOWN,
        power_supply_technology: BatteryState::POWER_SUPPLY_TECHNOLOGY_UNKNOWN,
        present: true,
        ..BatteryState::default()
    }
}

/// A robot of serial servos as a module: goals out, joints in, in every cycle of its bus.
///
/// It drives one bus of the robot that the setting `description` describes (see [`Description`]). It waits
/// for the bus, so run it detached; a robot of several buses has one module for each, with the setting `bus`,
/// and `bus/exchanges` and the service `torque` remapped.
///
/// | topic | type | |
/// | --- | --- | --- |
/// | `joint_commands` (in) | `sensor_msgs/JointState` | by name, dropped if the stamp is older or newer than `command_timeout_s` (0 is now): positions, rad, clamped to the limits; velocities, rad/s, or efforts, A, of joints with that `mode`. Unknown names are counted; what is not finite, or far beyond the limits, is refused and reported |
/// | `joint_torque` (in) | `sensor_msgs/JointState` | `effort`: the share of its largest torque that a joint may use; 0 switches it off |
/// | `joint_states` | `sensor_msgs/JointState` | in the order of the description: rad, rad/s, load (share of the drive) or current (A); stale joints have velocity and effort NaN |
/// | `battery_state` | `sensor_msgs/BatteryState` | V, once a second, if a device measures it |
/// | `imu/data_raw` | `sensor_msgs/Imu` | forward, left, up: rad/s, m/s^2; in every cycle, if a device has an `imu` |
/// | `devices/<name>` | `std_msgs/Float64MultiArray` | the registers of a device that are read, in their units; a label for each |
/// | `diagnostics` | `diagnostic_msgs/DiagnosticArray` | once a second and when a level changes |
/// | `bus/exchanges` | `downbeat_interfaces/BusExchange` | all traffic on the bus |
///
/// The service `torque` (`std_srvs/SetBool`) switches the torque of all joints.
///
/// A joint does not move before it is commanded. It then approaches the command at the `approach_rad_s` of
/// its description, as after each time it was out of service or without torque. On shutdown the servos keep
/// their torque.
pub struct ServoBus {
    bus: Option<Box<dyn Bus>>,
    hardware: Option<Hardware>,
    last_battery_at: Option<Time>,
}

/// The keys of [`ServoBus`].
pub struct Ports {
    topics: Topics,
    battery: Option<Publication<BatteryState>>,
    imu: Option<Publication<Imu>>,
    devices: Vec<Publication<Float64MultiArray>>,
}

impl ServoBus {
    /// The robot on its serial port.
    #[must_use]
    pub fn serial() -> Self {
        Self::new(Box::new(SerialBus::new()))
    }

    /// The robot on any bus, such as a recorded one.
    #[must_use]
    pub fn new(bus: Box<dyn Bus>) -> Self {
        Self { bus: Some(bus), hardware: None, last_battery_at: None }
    }

    fn on_command(&mut self, command: Received<'_, JointState>, ctx: &mut Context<'_, Ports>) {
        if let Some(hardware) = &mut self.hardware {
            hardware.on_command(&command, ctx.now());
        }
    }

    fn on_torque(&mut self, command: Received<'_, JointState>, ctx: &mut Context<'_, Ports>) {
        if let Some(hardware) = &mut self.hardware {
            hardware.on_torque(&command, ctx.now());
        }
    }

    fn tick(&mut self, ctx: &mut Context<'_, Ports>) {
        let Some(hardware) = &mut self.hardware else { return };
        let topics = ctx.ports.topics;
        if let Some(reading) = hardware.step(topics, ctx) {
            let plan = &hardware.plan;
            let protocol = plan.line.protocol;
            for (index, (device, piece)) in plan.devices.iter().zip(&reading.devices).enumerate() {
                let Some(piece) = piece else { continue };
                let values = device.read.iter().map(|register| device.value(protocol, register, piece));
                let data: Vec<f64> = values.map(|value| value.unwrap_or(f64::NAN)).collect();
                let dim = device.read.iter().map(|register| MultiArrayDimension {
                    label: register.name.clone(),
                    size: 1,
                    stride: 1,
                });
                let layout = MultiArrayLayout { dim: dim.collect(), data_offset: 0 };
                ctx.publish(ctx.ports.devices[index], Float64MultiArray { layout, data });
                if let (Some(topic), Some((imu, frame))) =
                    (ctx.ports.imu, ImuReading::of(device, protocol, piece))
                {
                    ctx.publish(topic, imu.message(header(reading.sent, frame)));
                }
                let is_due = self.last_battery_at.is_none_or(|at| at + SLOW <= ctx.now());
                if let (Some(topic), Some((register, _)), true) = (ctx.ports.battery, &device.battery, is_due)
                    && let Some(volts) = device.value(protocol, register, piece)
                {
                    self.last_battery_at = Some(ctx.now());
                    ctx.publish(topic, battery_state(reading.sent, volts));
                }
            }
        }
        hardware.diagnose(topics, ctx);
    }
}

impl Module for ServoBus {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let text =
            |setup: &mut Setup<'_, Self>, name, about| setup.read_only_setting(name, String::new(), about);
        let description = text(
            setup,
            "description",
            "the file that describes buses, joints and devices, relative to the robot file; or its text",
        )?;
        let bus_name = text(setup, "bus", "the bus to drive, if there are several")?;
        let port = text(setup, "port", "the serial port, instead of that of the description")?;
        let hardware_id = text(
            setup,
            "hardware_id",
            "which robot diagnostics speak of, instead of its name; say so if it is emulated",
        )?;
        let joint_frame = text(setup, "joint_frame", "frame of joint_states, empty by custom")?;
        let value = |key| setup.value(key).cloned().unwrap_or_default();
        let given = value(description);
        let mut hardware = None;
        if !given.is_empty() {
            let loaded = Description::load(&given)
                .map_err(|error| setup.refuse_value(description, error.to_string()))?;
            let plan = loaded
                .bus(&value(bus_name))
                .map_err(|error| setup.refuse_value(bus_name, error.to_string()))?;
            let mut plan = plan.clone();
            if loaded.buses().len() == 1 {
                // Its diagnostics need no name.
                plan.name.clear();
            }
            let port = value(port);
            if !port.is_empty() {
                plan.port = port;
            }
            hardware = Some((plan, value(hardware_id), value(joint_frame)));
        }
        let topics = Topics::declare(setup)?;
        let (mut battery, mut imu, mut devices) = (None, None, Vec::new());
        if let Some((plan, hardware_id, joint_frame)) = hardware {
            for device in &plan.devices {
                devices.push(setup.publish(&format!("devices/{}", device.name))?);
                if device.battery.is_some() && battery.is_none() {
                    battery = Some(setup.publish("battery_state")?);
                }
                if device.imu.is_some() {
                    imu = Some(setup.publish("imu/data_raw")?);
                }
            }
            setup.every(plan.cycle, Self::tick)?;
            let bus = self.bus.take().unwrap_or_else(|| Box::new(SerialBus::new()));
            let mut hardware = Hardware::new(bus, plan, true);
            hardware.joint_frame = joint_frame;
            // A robot may have two arms whose joints have the same names.
            hardware.joint_topics =
                ["joint_states", "joint_commands"].map(|name| (name, setup.remapped(name))).into();
            if !hardware_id.is_empty() {
                hardware.hardware_id = hardware_id;
            }
            self.hardware = Some(hardware);
        }
        setup.subscribe("joint_commands", Self::on_command)?;
        setup.subscribe("joint_torque", Self::on_torque)?;
        setup.serve(
            "torque",
            |module: &mut Self, request: &downbeat_msgs::std_srvs::srv::SetBoolRequest, _| match &mut module
                .hardware
            {
                Some(hardware) => Ok(hardware.set_torque(request.data)),
                None => Err("there is no description of the servos".to_owned()),
            },
        )?;
        Ok(Ports { topics, battery, imu, devices })
    }

    fn activate(&mut self, _ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        let hardware = self.hardware.as_mut().ok_or(NoDescription)?;
        hardware.driver.resume();
        Ok(())
    }

    fn deactivate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        let topics = ctx.ports.topics;
        if let Some(hardware) = &mut self.hardware {
            hardware.rest(topics, ctx);
        }
        Ok(())
    }

    fn shutdown(&mut self, ctx: &mut Context<'_, Ports>) {
        let topics = ctx.ports.topics;
        if let Some(hardware) = &mut self.hardware {
            hardware.stop(None, topics, ctx);
        }
    }
}

#[derive(Debug, thiserror::Error)]
#[error(
    "the setting \"description\" is missing: name the file that describes the servos, such as description = \"servos.toml\"; docs/servos.md shows one"
)]
struct NoDescription;
