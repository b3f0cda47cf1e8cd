//! The description of a robot of serial servos, as a TOML file.
//!
//! ```toml
//! name = "arm"
//!
//! [[bus]]
//! name = "arm"
//! port = "/dev/ttyACM0"
//! baud = 1_000_000
//! protocol = "feetech_sts"  # or dynamixel1, dynamixel2, feetech_scs
//! cycle_ms = 10
//!
//! [defaults]                # of all joints
//! model = "STS3215"
//!
//! [[joint]]
//! name = "shoulder_pan"
//! id = 1
//! limits = [-1.9, 1.9]      # rad
//! ```

mod file;
mod ros2_control;

use super::bus::LineSettings;
use super::joint::{Drive, Joint, Quantity, Registers};
use super::models::{self, Model, Register};
use super::protocol::{Id, Protocol};
use downbeat_files::toml::{self, Spanned};
use downbeat_files::{suggestion, user_file};
use file::{BusEntry, DeviceEntry, File, ImuEntry, JointEntry, Mode};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// How fast a joint approaches its first command by default, in rad/s.
const APPROACH_RAD_S: f64 = 1.0;
/// The largest `zero` and `offset`: more turns than any servo counts.
const LARGEST_ZERO: i64 = 1 << 31;
/// The least gear ratio; the largest is its inverse.
const LEAST_GEAR: f64 = 0.0001;
/// How long a commanded velocity or effort is valid by default, and how old the stamp of any command may be,
/// in s.
const COMMAND_TIMEOUT_S: f64 = 0.5;

/// A robot of serial servos.
#[derive(Clone, Debug)]
pub struct Description {
    /// Its name, for diagnostics.
    pub name: String,
    buses: Vec<BusPlan>,
}

/// One bus of a robot with everything on it.
#[derive(Clone, Debug, PartialEq)]
pub struct BusPlan {
    /// The name of the robot, for diagnostics.
    pub title: String,
    /// The name of the bus.
    pub name: String,
    /// Its serial port.
    pub port: String,
    /// Its speed and protocol.
    pub line: LineSettings,
    /// How often goals are written and joints read.
    pub cycle: Duration,
    /// Whether several devices answer in one packet (Dynamixel 2.0).
    pub fast_reads: bool,
    /// The joints.
    pub joints: Vec<Joint>,
    /// The devices beside servos.
    pub devices: Vec<DevicePlan>,
    /// The joints of the other buses, which are no unknown names in a command.
    pub other_joints: Vec<String>,
}

/// A device beside servos.
#[derive(Clone, Debug, PartialEq)]
pub struct DevicePlan {
    /// Its name.
    pub name: String,
    /// Its address.
    pub id: Id,
    /// What it is.
    pub model: Arc<Model>,
    /// The registers that are read in every cycle.
    pub read: Vec<Register>,
    /// If the device switches the power of the servos: how.
    pub power: Option<PowerSwitch>,
    /// If the device measures the battery: the register, and the voltage below which it needs charging.
    pub battery: Option<(Register, f64)>,
    /// If the device has an IMU: its registers.
    pub imu: Option<ImuPlan>,
}

/// An IMU among the registers of a device, in the frame of REP-103.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuPlan {
    /// The angular rates about forward, left and up, in rad/s, each with the sign with which the register
    /// counts.
    pub angular_velocity: [(f64, Register); 3],
    /// The specific forces forward, left and up, in m/s^2.
    pub linear_acceleration: [(f64, Register); 3],
    /// The frame of its messages.
    pub frame: String,
}

/// The power of the servos, switched by a register.
#[derive(Clone, Debug, PartialEq)]
pub struct PowerSwitch {
    /// The register, which is 1 while the servos have power.
    pub register: Register,
    /// The time from switching on until the servos answer.
    pub wait: Duration,
}

/// What is wrong with a description.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DescriptionError {
    /// The file, or that of a model, cannot be read or is invalid.
    #[error(transparent)]
    File(#[from] toml::Error),
    /// The description has no such bus.
    #[error("{problem}")]
    Bus {
        /// What was asked for, and what there is.
        problem: String,
    },
}

impl Description {
    /// Reads a file, or parses a text that contains a line break. A URDF, a file with the extension `.urdf`
    /// or a text that begins with `<`, describes servos in its `<ros2_control>` tags.
    ///
    /// # Errors
    /// Returns an error with file and line if the description or a model file that it names is invalid.
    pub fn load(path_or_text: &str) -> Result<Self, DescriptionError> {
        if path_or_text.contains('\n') {
            return Self::parse("description", path_or_text);
        }
        Self::checked(Source(read(Path::new(path_or_text))?))
    }

    /// Parses a text. Model files that it names are relative to the folder of `path`, which also appears in
    /// errors.
    ///
    /// # Errors
    /// See [`load`](Self::load).
    pub fn parse(path: &str, text: &str) -> Result<Self, DescriptionError> {
        Self::checked(Source(toml::Source::new(path, text)))
    }

    fn checked(source: Source<'_>) -> Result<Self, DescriptionError> {
        let is_urdf = source.0.path().extension().is_some_and(|extension| extension == "urdf")
            || source.0.text().trim_start().starts_with('<');
        let file = match is_urdf {
            true => ros2_control::file(&source)?,
            false => source.0.parse()?,
        };
        let own_models = own_models(&source, &file.models)?;
        let mut buses = Vec::new();
        for entry in &file.bus {
            buses.push(bus(&source, entry, &file.name, &buses)?);
        }
        if buses.is_empty() {
            return Err(
                source.error(0, "there is no [[bus]]: give its name, port, baud and protocol".to_owned())
            );
        }
        let parser = Parser { source, file: &file, own_models };
        let mut taken: Vec<Taken> = Vec::new();
        for entry in &file.joint {
            let (index, joint) = parser.joint(entry, &buses)?;
            parser.claim(&mut taken, entry.span().start, index, "joint", &joint.name, joint.id)?;
            buses[index].joints.push(joint);
        }
        for entry in &file.device {
            let (index, device) = parser.device(entry, &buses)?;
            parser.claim(&mut taken, entry.span().start, index, "device", &device.name, device.id)?;
            buses[index].devices.push(device);
        }
        for index in 0..buses.len() {
            let names = |bus: &BusPlan| bus.joints.iter().map(|joint| joint.name.clone()).collect::<Vec<_>>();
            let others = buses.iter().enumerate().filter(|(other, _)| *other != index);
            buses[index].other_joints = others.flat_map(|(_, bus)| names(bus)).collect();
            // The device that switches the power is asked first.
            buses[index].devices.sort_by_key(|device| device.power.is_none());
        }
        Ok(Self { name: file.name, buses })
    }

    /// The buses.
    #[must_use]
    pub fn buses(&self) -> &[BusPlan] {
        &self.buses
    }

    /// The bus with this name; with an empty name the only one.
    ///
    /// # Errors
    /// Returns an error if there is no such bus, or several and no name.
    pub fn bus(&self, name: &str) -> Result<&BusPlan, DescriptionError> {
        let names: Vec<&str> = self.buses.iter().map(|bus| &*bus.name).collect();
        let names = names.join("\", \"");
        match (&self.buses[..], name) {
            ([only], "") => Ok(only),
            (_, "") => Err(DescriptionError::Bus {
                problem: format!(
                    "{} has the buses \"{names}\": run one module for each, with the setting \"bus\"",
                    self.name
                ),
            }),
            (buses, name) => buses.iter().find(|bus| bus.name == name).ok_or_else(|| DescriptionError::Bus {
                problem: format!("{} has no bus \"{name}\", it has \"{names}\"", self.name),
            }),
        }
    }
}

fn read(path: &Path) -> Result<toml::Source<'static>, toml::Error> {
    toml::Source::read(path, "the description of the servos", user_file::LARGEST)
}

struct Source<'a>(toml::Source<'a>);

impl Source<'_> {
    fn error(&self, position: usize, problem: String) -> DescriptionError {
        self.0.error(position, problem).into()
    }
}

/// The id of a device, to find others with the same one.
struct Taken {
    bus: usize,
    id: Id,
    name: String,
    line: usize,
}

struct Parser<'a> {
    source: Source<'a>,
    file: &'a File,
    own_models: Vec<Arc<Model>>,
}

impl Parser<'_> {
    fn joint(
        &self,
        entry: &Spanned<JointEntry>,
        buses: &[BusPlan],
    ) -> Result<(usize, Joint), DescriptionError> {
        let (at, entry) = (entry.span().start, entry.get_ref());
        let name = &entry.name;
        let error = |problem: String| self.source.error(at, format!("joint \"{name}\" {problem}"));
        let defaults = &self.file.defaults;
        let bus = self.bus_of(at, &entry.bus, buses)?;
        let model_name = entry.model.as_ref().or(defaults.model.as_ref());
        let model_name =
            model_name.ok_or_else(|| error("needs \"model\", here or in [defaults]".to_owned()))?;
        let model = self.model(model_name, &buses[bus])?;
        let registers = Registers::of(&model)
            .map_err(|problem| error(format!("cannot be a {}: {problem}", model.name)))?;
        let least = 2.0 * buses[bus].cycle.as_secs_f64();
        let seconds = entry.command_timeout_s.or(defaults.command_timeout_s);
        let seconds = seconds.unwrap_or(COMMAND_TIMEOUT_S.max(least));
        if !(least..=60.0).contains(&seconds) {
            return Err(error(format!("has the command_timeout_s {seconds}: {least} (two cycles) to 60")));
        }
        let command_timeout = Duration::from_secs_f64(seconds);
        let drive = self.drive(at, entry, &model, command_timeout)?;
        let [min_rad, max_rad] = match (entry.limits, &drive) {
            (Some(limits), _) => limits,
            (None, Some(_)) => [f64::NEG_INFINITY, f64::INFINITY],
            (None, None) => {
                return Err(error(
                    "needs \"limits\", its smallest and largest angle in rad, such as limits = [-1.5, 1.5]"
                        .to_owned(),
                ));
            }
        };
        if entry.limits.is_some() && !(min_rad.is_finite() && max_rad.is_finite() && min_rad < max_rad) {
            return Err(error(format!(
                "has the limits {min_rad} and {max_rad}: give the smaller angle first, in rad"
            )));
        }
        let sign = match entry.sign.unwrap_or(1) {
            1 => 1.0,
            -1 => -1.0,
            other => {
                return Err(error(format!(
                    "has the sign {other}: 1, or -1 if the servo turns the other way"
                )));
            }
        };
        let gear = entry.gear.unwrap_or(1.0);
        if !(gear.is_finite() && gear > 0.0) {
            return Err(error(format!(
                "has the gear ratio {gear}: turns of the servo for one of the joint, above 0"
            )));
        }
        if !(LEAST_GEAR..=1.0 / LEAST_GEAR).contains(&gear) {
            return Err(error(format!("has the gear ratio {gear}: {LEAST_GEAR} to {}", 1.0 / LEAST_GEAR)));
        }
        for (key, raw) in [("zero", entry.zero), ("offset", entry.offset)] {
            if raw.is_some_and(|raw| raw.unsigned_abs() > LARGEST_ZERO.unsigned_abs()) {
                return Err(error(format!(
                    "has the {key} {}: {} to {LARGEST_ZERO}",
                    raw.unwrap_or(0),
                    -LARGEST_ZERO
                )));
            }
        }
        let centre = (registers.goal.min + registers.goal.max + 1) / 2;
        let approach = entry.approach_rad_s.or(defaults.approach_rad_s).unwrap_or(APPROACH_RAD_S);
        if !(approach.is_finite() && approach > 0.0) {
            return Err(error(format!("approaches at {approach} rad/s: give a speed above 0")));
        }
        let gains = entry.gains.or(defaults.gains).unwrap_or_default();
        for (given, register) in [(gains.d, 0), (gains.i, 1), (gains.p, 2)] {
            match (given, &registers.gains[register]) {
                (Some(gain), Some(known)) if !(known.min..=known.max).contains(&gain) => {
                    let (min, max) = (known.min, known.max);
                    return Err(error(format!("has a gain of {gain}: {} has {min} to {max}", model.name)));
                }
                (Some(_), None) => return Err(error(format!("has gains, but {} has none", model.name))),
                _ => {}
            }
        }
        let max_torque = entry.max_torque.or(defaults.max_torque);
        if let Some(share) = max_torque {
            if !(share > 0.0 && share <= 1.0) {
                return Err(error(format!("has the max_torque {share}: a share above 0, up to 1")));
            }
            if registers.torque_limit.is_none() {
                return Err(error(format!("has a max_torque, but {} cannot limit it", model.name)));
            }
        }
        let max_current_a = entry.max_current_a.or(defaults.max_current_a);
        if let Some(current) = max_current_a {
            let largest = registers.current_limit.as_ref().map(|register| register.to_si(register.max));
            match largest {
                Some(largest) if current > 0.0 && current <= largest => {}
                Some(largest) => {
                    return Err(error(format!(
                        "has the max_current_a {current}: above 0, up to {largest:.3} A"
                    )));
                }
                None => {
                    return Err(error(format!("has a max_current_a, but {} cannot limit it", model.name)));
                }
            }
        }
        let guard = entry.guard.or(defaults.guard).unwrap_or_default();
        guard.check().map_err(error)?;
        if guard.shutdown_rest_s.is_some() && buses[bus].line.protocol == Protocol::Dynamixel2 {
            let why = "servos of dynamixel2 come back from a shutdown by a reboot only";
            return Err(error(format!("has a guard with shutdown_rest_s, but {why}")));
        }
        let cycle = buses[bus].cycle;
        let joint = Joint {
            name: name.clone(),
            declared_at: Some(format!("{}:{}", self.source.0.path().display(), self.source.0.line_of(at))),
            id: self.id(at, entry.id)?,
            zero: entry.zero.unwrap_or(centre) + entry.offset.unwrap_or(0),
            sign,
            gear,
            min_rad,
            max_rad,
            gains: [gains.d, gains.i, gains.p],
            max_torque,
            max_current_a,
            further: self.further(entry, &model, drive.as_ref())?,
            drive,
            // No approach is faster than the whole range in a cycle.
            approach_steps: ((registers.goal.steps(approach * cycle.as_secs_f64()) * gear).round() as i64)
                .clamp(1, (registers.goal.max - registers.goal.min).max(1)),
            command_timeout,
            guard,
            model,
            registers,
        };
        for limit in [min_rad, max_rad].into_iter().filter(|_| joint.drive.is_none()) {
            let (raw, goal) = (joint.steps(limit), &joint.registers.goal);
            if raw < goal.min - 1 || raw > goal.max + 1 {
                let ends = [joint.angle(goal.min), joint.angle(goal.max)];
                let (low, high) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
                return Err(error(format!(
                    "has the limit {limit} rad, but its servo turns from {low:.3} to {high:.3} rad; check limits, zero, sign and gear"
                )));
            }
        }
        Ok((bus, joint))
    }

    /// How a joint is driven by velocities or efforts.
    fn drive(
        &self,
        at: usize,
        entry: &JointEntry,
        model: &Model,
        timeout: Duration,
    ) -> Result<Option<Drive>, DescriptionError> {
        let error = |problem: String| self.source.error(at, format!("joint \"{}\" {problem}", entry.name));
        let defaults = &self.file.defaults;
        let (quantity, key, name, mode, largest) = match entry.mode.or(defaults.mode).unwrap_or_default() {
            Mode::Position => return Ok(None),
            Mode::Velocity => (
                Quantity::Velocity,
                "max_velocity_rad_s",
                "goal_velocity",
                model.modes.velocity,
                entry.max_velocity_rad_s.or(defaults.max_velocity_rad_s),
            ),
            Mode::Effort => (
                Quantity::Effort,
                "max_current_a",
                "goal_current",
                model.modes.effort,
                entry.max_current_a.or(defaults.max_current_a),
            ),
        };
        let goal = mode.and_then(|_| model.register(name)).ok_or_else(|| {
            error(format!(
                "cannot be driven like this: {} has no such mode; leave out \"mode\", or take another model",
                model.name
            ))
        })?;
        let gear = if quantity == Quantity::Velocity { entry.gear.unwrap_or(1.0) } else { 1.0 };
        let most = goal.to_si(goal.max) / gear;
        let largest = largest.filter(|largest| *largest > 0.0 && *largest <= most).ok_or_else(|| {
            error(format!("needs \"{key}\", the largest goal in either direction: above 0, up to {most:.3}"))
        })?;
        let goal = goal.clone();
        Ok(Some(Drive { quantity, goal, largest, timeout }))
    }

    /// The registers that a joint sets, those of `[defaults]` first.
    fn further(
        &self,
        entry: &JointEntry,
        model: &Model,
        drive: Option<&Drive>,
    ) -> Result<Vec<(Register, i64)>, DescriptionError> {
        let mut further: Vec<(Register, i64)> = Vec::new();
        if let Some(drive) = drive {
            let (mode, limit) = match drive.quantity {
                Quantity::Velocity => (model.modes.velocity, model.register("velocity_limit")),
                // That of the current is set with max_current_a.
                Quantity::Effort => (model.modes.effort, None),
            };
            let gear = entry.gear.unwrap_or(1.0);
            let limit = limit.map(|register| (register, register.steps(drive.largest * gear).ceil() as i64));
            let mode = model.register("operating_mode").zip(mode);
            let own = mode.into_iter().chain(limit);
            further
                .extend(own.map(|(register, raw)| (register.clone(), raw.clamp(register.min, register.max))));
        }
        for (name, value) in self.file.defaults.registers.iter().chain(&entry.registers) {
            let error = |problem| self.source.error(value.span().start, problem);
            let register = model.register(name).ok_or_else(|| {
                let near = suggestion(name, model.registers.iter().map(|register| &*register.name));
                error(format!("{} has no register \"{name}\"{near}", model.name))
            })?;
            let raw = *value.get_ref();
            // Only the driver writes torque and goals: a goal that is set at the start makes the joint move.
            let goal = drive.map_or("", |drive| &drive.goal.name);
            if register.access == models::Access::Read
                || ["id", "baud_rate", "operating_mode", "torque_enable", "goal_position", goal]
                    .contains(&&**name)
            {
                return Err(error(format!("\"{name}\" cannot be set by a description")));
            }
            if !(register.min..=register.max).contains(&raw) {
                let (min, max) = (register.min, register.max);
                return Err(error(format!("\"{name}\" of {} takes {min} to {max}, not {raw}", model.name)));
            }
            further.retain(|(known, _)| known.name != *name);
            further.push((register.clone(), raw));
        }
        Ok(further)
    }

    fn device(
        &self,
        entry: &Spanned<DeviceEntry>,
        buses: &[BusPlan],
    ) -> Result<(usize, DevicePlan), DescriptionError> {
        let (at, entry) = (entry.span().start, entry.get_ref());
        let name = &entry.name;
        let bus = self.bus_of(at, &entry.bus, buses)?;
        let model = self.model(&entry.model, &buses[bus])?;
        let register = |wanted: &Spanned<String>| {
            let found = model.register(wanted.get_ref()).cloned();
            found.ok_or_else(|| {
                let near =
                    suggestion(wanted.get_ref(), model.registers.iter().map(|register| &*register.name));
                let problem = format!(
                    "device \"{name}\": {} has no register \"{}\"{near}",
                    model.name,
                    wanted.get_ref()
                );
                self.source.error(wanted.span().start, problem)
            })
        };
        let mut read = entry.read.iter().map(register).collect::<Result<Vec<_>, _>>()?;
        let power = match &entry.power {
            None => None,
            Some(power) => {
                Some(PowerSwitch { register: register(&power.register)?, wait: milliseconds(power.wait_ms) })
            }
        };
        let battery = match &entry.battery {
            None => None,
            Some(battery) => Some((register(&battery.register)?, battery.low_v)),
        };
        let imu = match &entry.imu {
            None => None,
            Some(imu) => Some(self.imu(imu, &register)?),
        };
        let axes = imu.iter().flat_map(|imu| imu.angular_velocity.iter().chain(&imu.linear_acceleration));
        let needed = power
            .iter()
            .map(|power| &power.register)
            .chain(battery.iter().map(|(register, _)| register))
            .chain(axes.map(|(_, register)| register));
        for register in needed {
            if !read.contains(register) {
                read.push(register.clone());
            }
        }
        if buses[bus].devices.iter().any(|device| device.power.is_some()) && power.is_some() {
            let problem = format!("device \"{name}\" is the second one on its bus that switches the power");
            return Err(self.source.error(at, problem));
        }
        if buses[bus].devices.iter().any(|device| device.imu.is_some()) && imu.is_some() {
            let problem = format!("device \"{name}\" is the second one on its bus with an IMU");
            return Err(self.source.error(at, problem));
        }
        Ok((
            bus,
            DevicePlan {
                name: name.clone(),
                id: self.id(at, entry.id)?,
                model: Arc::clone(&model),
                read,
                power,
                battery,
                imu,
            },
        ))
    }

    fn imu(
        &self,
        entry: &ImuEntry,
        register: &impl Fn(&Spanned<String>) -> Result<Register, DescriptionError>,
    ) -> Result<ImuPlan, DescriptionError> {
        let axis = |name: &Spanned<String>, unit: &str| {
            let (sign, plain) = match name.get_ref().strip_prefix('-') {
                Some(plain) => (-1.0, plain),
                None => (1.0, &**name.get_ref()),
            };
            let found = register(&Spanned::new(name.span(), plain.to_owned()))?;
            if found.unit == unit {
                return Ok((sign, found));
            }
            let problem = format!("\"{plain}\" cannot be an axis of this IMU: it is not in {unit}");
            Err(self.source.error(name.span().start, problem))
        };
        let axes = |names: &[Spanned<String>; 3], unit| -> Result<[(f64, Register); 3], DescriptionError> {
            let [forward, left, up] = names;
            Ok([axis(forward, unit)?, axis(left, unit)?, axis(up, unit)?])
        };
        Ok(ImuPlan {
            angular_velocity: axes(&entry.angular_velocity, "rad/s")?,
            linear_acceleration: axes(&entry.linear_acceleration, "m/s^2")?,
            frame: entry.frame.clone().unwrap_or_else(|| "imu_link".to_owned()),
        })
    }

    fn bus_of(
        &self,
        at: usize,
        name: &Option<Spanned<String>>,
        buses: &[BusPlan],
    ) -> Result<usize, DescriptionError> {
        match (name.as_ref().or(self.file.defaults.bus.as_ref()), buses) {
            (None, [_]) => Ok(0),
            (None, _) => Err(self
                .source
                .error(at, "there are several buses: add \"bus\" with the name of one".to_owned())),
            (Some(name), _) => buses.iter().position(|bus| bus.name == *name.get_ref()).ok_or_else(|| {
                let near = suggestion(name.get_ref(), buses.iter().map(|bus| &*bus.name));
                self.source
                    .error(name.span().start, format!("there is no [[bus]] \"{}\"{near}", name.get_ref()))
            }),
        }
    }

    fn model(&self, name: &Spanned<String>, bus: &BusPlan) -> Result<Arc<Model>, DescriptionError> {
        let error = |problem| self.source.error(name.span().start, problem);
        let (name, protocol) = (name.get_ref(), bus.line.protocol);
        let own = self.own_models.iter().find(|model| model.name.eq_ignore_ascii_case(name));
        let model = own.or_else(|| models::find(name)).ok_or_else(|| {
            let known = self.own_models.iter().chain(models::built_in());
            let near = suggestion(name, known.map(|model| &*model.name));
            error(format!(
                "unknown model \"{name}\"{near}; a file with its registers can be named in \"models\""
            ))
        })?;
        if !model.protocols.contains(&protocol) {
            let speaks = model.protocols.iter().map(|protocol| protocol.key()).collect::<Vec<_>>().join(", ");
            let (bus, key) = (&bus.name, protocol.key());
            return Err(error(format!("{name} speaks {speaks}, but bus \"{bus}\" has protocol = \"{key}\"")));
        }
        Ok(Arc::clone(model))
    }

    fn id(&self, at: usize, raw: u8) -> Result<Id, DescriptionError> {
        Id::new(raw).filter(|id| id.raw() <= 253).ok_or_else(|| {
            self.source
                .error(at, format!("{raw} is no id of a device; ids are 0 to 253, 252 in Dynamixel 2.0"))
        })
    }

    fn claim(
        &self,
        taken: &mut Vec<Taken>,
        at: usize,
        bus: usize,
        what: &str,
        name: &str,
        id: Id,
    ) -> Result<(), DescriptionError> {
        let line = self.source.0.line_of(at);
        if name.is_empty() {
            return Err(self.source.error(at, format!("a {what} needs a name")));
        }
        if let Some(other) = taken.iter().find(|other| other.name == name) {
            let problem = format!("{what} \"{name}\" is on line {} already; choose another name", other.line);
            return Err(self.source.error(at, problem));
        }
        if let Some(other) = taken.iter().find(|other| other.bus == bus && other.id == id) {
            let problem = format!(
                "{what} \"{name}\" has the id {id} of \"{}\" (line {}) on the same bus; give one of the two another id, with \
                 `downbeat servo set-id`",
                other.name, other.line
            );
            return Err(self.source.error(at, problem));
        }
        taken.push(Taken { bus, id, name: name.to_owned(), line });
        Ok(())
    }
}

fn own_models(source: &Source<'_>, files: &[Spanned<String>]) -> Result<Vec<Arc<Model>>, DescriptionError> {
    let folder = source.0.path().parent().map(PathBuf::from).unwrap_or_default();
    let model = |name: &Spanned<String>| {
        let path = folder.join(name.get_ref());
        let model = read(&path).map_err(|error| source.error(name.span().start, error.to_string()))?;
        let refuse =
            |error: models::ModelError| DescriptionError::File(model.error_on(error.line, error.problem));
        Model::parse(model.text()).map(Arc::new).map_err(refuse)
    };
    files.iter().map(model).collect()
}

fn bus(
    source: &Source<'_>,
    entry: &Spanned<BusEntry>,
    title: &str,
    others: &[BusPlan],
) -> Result<BusPlan, DescriptionError> {
    let (at, entry) = (entry.span().start, entry.get_ref());
    let error = |problem: String| source.error(at, format!("bus \"{}\" {problem}", entry.name));
    if others.iter().any(|other| other.name == entry.name) {
        return Err(error("exists already; choose another name".to_owned()));
    }
    if !(9_600..=12_000_000).contains(&entry.baud) {
        return Err(error(format!("has {} bit/s; give a speed from 9600 to 12000000", entry.baud)));
    }
    if !(1.0..=1000.0).contains(&entry.cycle_ms) {
        return Err(error(format!("has a cycle of {} ms; give 1 to 1000", entry.cycle_ms)));
    }
    if entry.fast_reads && entry.protocol.0 != Protocol::Dynamixel2 {
        return Err(error(format!("has fast_reads, which {} lacks", entry.protocol.0)));
    }
    Ok(BusPlan {
        title: title.to_owned(),
        name: entry.name.clone(),
        port: entry.port.clone(),
        line: LineSettings { baud: entry.baud, protocol: entry.protocol.0 },
        cycle: milliseconds(entry.cycle_ms),
        fast_reads: entry.fast_reads,
        joints: Vec::new(),
        devices: Vec::new(),
        other_joints: Vec::new(),
    })
}

fn milliseconds(ms: f64) -> Duration {
    Duration::from_secs_f64(ms.clamp(0.0, 60_000.0) / 1000.0)
}

#[cfg(test)]
mod tests;
