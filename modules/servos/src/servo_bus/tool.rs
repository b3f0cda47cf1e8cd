//! Finding and configuring single servos, for commands.

use super::bus::{Bus, ExpectedStatus, LineSettings, Outcome, SerialBus};
use super::joint::Joint;
use super::line::{ECHO, Line, Trouble, for_each_status};
use super::models::{self, Access, Model, Register};
use super::preparation::{PrepareError, Prepared, prepare};
use super::protocol::{Id, Instruction, Protocol, StatusError, echo_end};
use super::servo::Servo;
use downbeat_msgs::definitions::suggestion;
use std::sync::Arc;
use std::time::Duration;

/// A goal this far from the position is a jump when the torque is enabled, in rad.
const JUMP_RAD: f64 = 0.1;
/// The register of a board that switches the power of the servos behind it.
const POWER_SWITCH: &str = "dynamixel_power";
/// How often the position of a servo is read to see whether its answers come.
const READS_OF_EXAMINATION: usize = 10;
/// The bytes of an answer to a ping in Dynamixel 2.0, with number of the model and firmware.
const LENGTH_OF_PONG: usize = 14;
/// Devices are asked this often before they count as silent.
const ATTEMPTS: usize = 2;

/// A serial port with servos.
pub struct ServoPort {
    bus: Box<dyn Bus>,
    path: String,
    line: LineSettings,
    own_models: Vec<Arc<Model>>,
    /// Whether bytes came in place of the last answer that was expected.
    is_garbled: bool,
}

/// A device that answered.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// Its address.
    pub id: Id,
    /// How it speaks.
    pub line: LineSettings,
    /// The number of its model, if it could be read.
    pub number: Option<u16>,
    /// The version of its firmware, if the model is known.
    pub firmware: Option<i64>,
    /// Its model, if it is known.
    pub model: Option<Arc<Model>>,
    /// Whether bytes came in place of its answers that are none, as from two devices of one id.
    pub is_garbled: bool,
}

/// What came for a ping.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Presence {
    /// Nothing.
    Absent,
    /// Bytes that are no answer.
    Garbled,
    /// An answer.
    Present,
}

/// What to do about answers that are not understood.
const GARBLED: &str = "Two servos may have this id: connect one at a time and give each its own with `downbeat servo set-id`; otherwise \
     the line is disturbed";

/// Why a device did not do what it was asked.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ServoError {
    /// The port cannot be opened, or was lost.
    #[error("{0}")]
    Port(String),
    /// No answer.
    #[error("{}: no answer from id {id} at {} bit/s in {}; is it powered, and are speed and protocol right? `downbeat servo scan` finds it", path, line.baud, line.protocol)]
    Silent {
        /// The port.
        path: String,
        /// The device.
        id: Id,
        /// How it was asked.
        line: LineSettings,
    },
    /// Bytes came that are no answer.
    #[error("{path}: what comes from id {id} at {} bit/s is not understood. {GARBLED}", line.baud)]
    Garbled {
        /// The port.
        path: String,
        /// The device.
        id: Id,
        /// How it was asked.
        line: LineSettings,
    },
    /// What is sent comes back.
    #[error("{path}: {ECHO}; no device can be told from the echo")]
    Echo {
        /// The port.
        path: String,
    },
    /// The device answered with an error.
    #[error("{path}: id {id} at {} bit/s refuses to {doing}: {error}; {}", line.baud, error.remedy())]
    Refused {
        /// The port.
        path: String,
        /// How it was asked.
        line: LineSettings,
        /// The device.
        id: Id,
        /// What it was asked to do.
        doing: String,
        /// Its answer.
        error: StatusError,
    },
    /// The model is unknown.
    #[error("{path}: id {id} at {} bit/s is model {}, which is unknown; name a file with its registers with --model-file", line.baud, number.map_or("?".to_owned(), |number| number.to_string()))]
    UnknownModel {
        /// The port.
        path: String,
        /// How it was asked.
        line: LineSettings,
        /// The device.
        id: Id,
        /// The number of its model.
        number: Option<u16>,
    },
    /// The model is another one than described.
    #[error("{path}: id {id} at {} bit/s is a {found}, and is described as a {described}; correct its model in the description, or, if ids are mixed up, give it its own with `downbeat servo set-id`", line.baud)]
    OtherModel {
        /// The port.
        path: String,
        /// How it was asked.
        line: LineSettings,
        /// The device.
        id: Id,
        /// The model in the description.
        described: String,
        /// The model that answers.
        found: String,
    },
    /// The servo is not what is described, or cannot be driven as described.
    #[error("{path}: servo {id} ({name}) at {} bit/s cannot be used: {reason}; correct its description, or exchange it", line.baud)]
    Unsuitable {
        /// The port.
        path: String,
        /// The device.
        id: Id,
        /// The joint.
        name: String,
        /// How it was asked.
        line: LineSettings,
        /// Why.
        reason: String,
    },
    /// The model has no such register.
    #[error("{model} has no register \"{register}\"{near}")]
    UnknownRegister {
        /// The model.
        model: String,
        /// What was asked for.
        register: String,
        /// The most similar register, in words.
        near: String,
    },
    /// The value cannot be written.
    #[error("\"{register}\" of {model} takes {min} to {max}, not {value}")]
    Range {
        /// The model.
        model: String,
        /// The register.
        register: String,
        /// The smallest value.
        min: i64,
        /// The largest value.
        max: i64,
        /// The given one.
        value: i64,
    },
    /// A write that can do harm.
    #[error("{0}; repeat with --force if that is intended")]
    Dangerous(String),
}

/// Whether a write that can do harm is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Caution {
    /// It is refused.
    Refuse,
    /// It is done.
    Force,
}

impl ServoPort {
    /// Opens a port, on which devices may take this long to answer.
    ///
    /// # Errors
    /// Returns an error if it cannot be opened.
    pub fn open(path: &str, slack: Duration, own_models: Vec<Arc<Model>>) -> Result<Self, ServoError> {
        Self::on(Box::new(SerialBus::with_slack(slack)), path, own_models)
    }

    /// Opens a port of this bus.
    pub(crate) fn on(bus: Box<dyn Bus>, path: &str, own_models: Vec<Arc<Model>>) -> Result<Self, ServoError> {
        let (path, line) = (path.to_owned(), LineSettings::default());
        let mut port = Self { bus, path, line, own_models, is_garbled: false };
        port.speak(line)?;
        Ok(port)
    }

    /// Sets speed and protocol.
    ///
    /// # Errors
    /// Returns an error if the port cannot have this speed.
    pub fn speak(&mut self, line: LineSettings) -> Result<(), ServoError> {
        self.line = line;
        self.bus.set_line(line);
        let opened = self.bus.open(&self.path);
        if opened.outcome == Outcome::Ok { Ok(()) } else { Err(ServoError::Port(opened.error)) }
    }

    /// The port.
    #[must_use]
    pub fn path(&self) -> &str {
        &self.path
    }

    /// The speed and protocol.
    #[must_use]
    pub fn line(&self) -> LineSettings {
        self.line
    }

    /// Finds the devices among these ids at this speed.
    ///
    /// # Errors
    /// Returns an error if the port fails, or cannot have this speed.
    pub fn scan(&mut self, baud: u32, protocols: &[Protocol], ids: &[Id]) -> Result<Vec<Found>, ServoError> {
        let mut found = Vec::new();
        if protocols.contains(&Protocol::Dynamixel2) {
            self.speak(LineSettings { baud, protocol: Protocol::Dynamixel2 })?;
            let (answering, is_garbled) = self.answering_broadcast(ids)?;
            for id in ids {
                if answering.contains(id) {
                    found.extend(self.look_for(*id)?);
                } else if is_garbled && self.presence(*id, 1)? != Presence::Absent {
                    // Its answer was not understood among those of all.
                    found.extend(self.look_for(*id)?);
                }
            }
        }
        // The others have the same ping.
        let others: Vec<_> = protocols.iter().filter(|protocol| **protocol != Protocol::Dynamixel2).collect();
        let Some(first) = others.first() else { return Ok(found) };
        self.speak(LineSettings { baud, protocol: **first })?;
        for id in ids {
            if self.presence(*id, 1)? == Presence::Absent {
                continue;
            }
            let mut kinds = Vec::new();
            for protocol in &others {
                self.line.protocol = **protocol;
                self.bus.set_line(self.line);
                kinds.extend(self.look_for(*id)?);
            }
            let known = kinds.iter().position(|kind| kind.model.is_some()).unwrap_or(0);
            if known < kinds.len() {
                found.push(kinds.swap_remove(known));
            }
        }
        Ok(found)
    }

    /// All devices answer a ping of the broadcast address. Returns those that are understood, and whether
    /// other bytes came.
    fn answering_broadcast(&mut self, ids: &[Id]) -> Result<(Vec<Id>, bool), ServoError> {
        let (mut answering, mut is_garbled) = (Vec::new(), false);
        // Waits for as many answers as there can be.
        let expected: Vec<_> = ids.iter().map(|id| ExpectedStatus { id: *id, parameters: 3 }).collect();
        let ping = Instruction::Ping { id: Id::BROADCAST };
        for _ in 0..ATTEMPTS {
            let Ok(bytes) = ping.to_bytes(self.line.protocol) else { break };
            let exchange = self.bus.exchange(&bytes, &expected);
            if exchange.outcome == Outcome::Failed {
                return Err(ServoError::Port(exchange.error));
            }
            if echo_end(self.line.protocol, &bytes, &exchange.reply).is_some() {
                return Err(self.echo());
            }
            let mut understood = 0;
            for_each_status(self.line.protocol, &exchange.reply, |status| {
                understood += LENGTH_OF_PONG;
                answering.push(status.id);
            });
            is_garbled |= exchange.reply.len() > understood;
        }
        answering.sort_unstable();
        answering.dedup();
        answering.retain(|id| ids.contains(id));
        Ok((answering, is_garbled))
    }

    /// Pings a device, which may be silent this often.
    fn presence(&mut self, id: Id, attempts: usize) -> Result<Presence, ServoError> {
        let parameters = if self.line.protocol == Protocol::Dynamixel2 { 3 } else { 0 };
        let (mut silent, mut garbled) = (0, 0);
        while silent < attempts && garbled < ATTEMPTS {
            match self.ask(&Instruction::Ping { id }, parameters) {
                Ok(_) | Err(Trouble::Refused(_)) => {
                    // The answer to a ping may have the bytes of the ping. A read of one byte never has.
                    return match self.ask(&Instruction::Read { id, address: 0, length: 1 }, 1) {
                        Err(Trouble::PortFailed) => Err(self.lost()),
                        Err(Trouble::Echo) => Err(self.echo()),
                        _ => Ok(Presence::Present),
                    };
                }
                Err(Trouble::Silent) if self.is_garbled => garbled += 1,
                Err(Trouble::Silent) => silent += 1,
                Err(Trouble::PortFailed) => return Err(self.lost()),
                Err(Trouble::Echo) => return Err(self.echo()),
            }
        }
        Ok(if garbled > 0 { Presence::Garbled } else { Presence::Absent })
    }

    fn echo(&self) -> ServoError {
        ServoError::Echo { path: self.path.clone() }
    }

    /// Asks a device what it is; `None` if it does not answer.
    ///
    /// # Errors
    /// Returns an error if the port fails, or bytes come that are no answer.
    pub fn identify(&mut self, id: Id) -> Result<Option<Found>, ServoError> {
        match self.look_for(id)? {
            Some(found) if found.is_garbled => Err(self.garbled(id)),
            found => Ok(found),
        }
    }

    /// Asks a device what it is. `None` if it does not answer; `is_garbled` if its answer is not understood.
    fn look_for(&mut self, id: Id) -> Result<Option<Found>, ServoError> {
        let line = self.line;
        let unknown = Found { id, line, number: None, firmware: None, model: None, is_garbled: false };
        match self.presence(id, ATTEMPTS)? {
            Presence::Absent => return Ok(None),
            Presence::Garbled => return Ok(Some(Found { is_garbled: true, ..unknown })),
            Presence::Present => {}
        }
        let of_protocol = |model: &&Arc<Model>| model.protocols.contains(&line.protocol);
        let known: Vec<Arc<Model>> =
            self.own_models.iter().chain(models::built_in()).filter(of_protocol).cloned().collect();
        // The register of the number is at the same place in all models of a protocol.
        let Some(register) = known.iter().find_map(|model| model.register("model_number")).cloned() else {
            return Ok(Some(unknown));
        };
        let number = self.read_raw(id, &register);
        // Two devices whose answers to pings are the same have different numbers.
        let is_garbled = number.is_err() && self.is_garbled;
        let number = number.ok().and_then(|number| u16::try_from(number).ok());
        let model = known.into_iter().find(|model| model.number.is_some() && model.number == number);
        let version = model.as_ref().and_then(|model| model.register("firmware_version").cloned());
        let firmware = version.and_then(|register| self.read_raw(id, &register).ok());
        Ok(Some(Found { id, line, number, firmware, model, is_garbled }))
    }

    /// Whether this device switches the power of the servos behind it and has it off: they cannot answer
    /// then.
    ///
    /// A device of an unknown number with the id that such boards have by default is taken for one if its
    /// switch reads as 0.
    ///
    /// # Errors
    /// Returns an error if the port fails.
    pub fn withholds_power(&mut self, found: &Found) -> Result<bool, ServoError> {
        let is_board = |model: &&Arc<Model>| {
            let usual_id = model.register("id").map(|id| id.initial);
            model.protocols.contains(&found.line.protocol) && usual_id == Some(found.id.raw().into())
        };
        let mut boards = models::built_in().iter().filter(is_board);
        let switch = match &found.model {
            Some(model) => model.register(POWER_SWITCH).cloned(),
            None => boards.find_map(|model| model.register(POWER_SWITCH).cloned()),
        };
        let Some(switch) = switch else { return Ok(false) };
        self.speak(found.line)?;
        Ok(self.read_raw(found.id, &switch).is_ok_and(|value| value == 0))
    }

    /// What is wrong with a servo that was found, in sentences: answers that are not understood or do not
    /// come, and a supply outside of its limits. Nothing is written.
    ///
    /// # Errors
    /// Returns an error if the port fails.
    pub fn examine(&mut self, found: &Found) -> Result<Vec<String>, ServoError> {
        let id = found.id;
        if found.is_garbled {
            let Found { line, .. } = found;
            return Ok(vec![format!(
                "id {id}: what comes at {} bit/s is not understood. {GARBLED}",
                line.baud
            )]);
        }
        let Some(model) = found.model.clone() else { return Ok(Vec::new()) };
        let Some(position) = model.register("present_position") else { return Ok(Vec::new()) };
        self.speak(found.line)?;
        let (address, length) = (position.address, position.size);
        let (mut silent, mut garbled) = (0, 0);
        for _ in 0..READS_OF_EXAMINATION {
            match self.ask(&Instruction::Read { id, address, length }, length) {
                Err(Trouble::PortFailed) => return Err(self.lost()),
                Err(Trouble::Silent) if self.is_garbled => garbled += 1,
                Err(Trouble::Silent) => silent += 1,
                _ => {}
            }
        }
        let mut problems = Vec::new();
        if garbled > 0 {
            problems.push(format!(
                "id {id}: {garbled} of {READS_OF_EXAMINATION} answers are not understood. {GARBLED}"
            ));
        }
        if silent > 0 {
            problems.push(format!(
                "id {id}: {silent} of {READS_OF_EXAMINATION} reads have no answer. Look at its plugs and cable, and whether the \
                 speed of {} bit/s is too high for this adapter",
                found.line.baud
            ));
        }
        let mut volts = |name: &str| {
            let register = model.register(name)?;
            Some(register.to_si(self.read_raw(id, register).ok()?))
        };
        if let (Some(supply), Some(min), Some(max)) =
            (volts("present_voltage"), volts("min_voltage_limit"), volts("max_voltage_limit"))
            && !(min..=max).contains(&supply)
        {
            problems.push(format!(
                "id {id}: it measures a supply of {supply:.1} V, and its limits are {min:.1} to {max:.1} V. Is the power supply \
                 the one for a {}?",
                model.name
            ));
        }
        Ok(problems)
    }

    /// Asks a device what it is, which must be a known model.
    ///
    /// # Errors
    /// Returns an error if it does not answer, or its model is unknown.
    pub fn known(&mut self, id: Id) -> Result<(Found, Arc<Model>), ServoError> {
        let found = self.identify(id)?.ok_or_else(|| self.silent(id))?;
        let number = found.number;
        let unknown = || ServoError::UnknownModel { path: self.path.clone(), line: self.line, id, number };
        let model = found.model.clone().ok_or_else(unknown)?;
        Ok((found, model))
    }

    /// The register of a model with this name.
    ///
    /// # Errors
    /// Returns an error with the most similar register if there is none.
    pub fn register(model: &Model, name: &str) -> Result<Register, ServoError> {
        model.register(name).cloned().ok_or_else(|| ServoError::UnknownRegister {
            model: model.name.clone(),
            register: name.to_owned(),
            near: suggestion(name, model.registers.iter().map(|register| &*register.name)),
        })
    }

    /// Brings a servo into service as the driver does, with torque where it is, if its position can be a
    /// goal.
    pub(crate) fn prepare(&mut self, joint: &Joint) -> Result<Prepared, ServoError> {
        let (mut exchanges, softness) = (Vec::new(), Servo::new().softness(joint));
        let mut prepared = Err(PrepareError::Trouble(Trouble::Silent));
        for _ in 0..ATTEMPTS {
            let (bus, protocol) = (&mut *self.bus, self.line.protocol);
            let mut line = Line { bus, protocol, exchanges: &mut exchanges };
            prepared = prepare(&mut line, joint, softness, true);
            if prepared != Err(PrepareError::Trouble(Trouble::Silent)) {
                break;
            }
        }
        prepared.map_err(|error| match error {
            PrepareError::Trouble(trouble) => self.explain(joint.id, "take its settings", trouble),
            PrepareError::OtherModel(reason) | PrepareError::Unsuitable(reason) => ServoError::Unsuitable {
                path: self.path.clone(),
                id: joint.id,
                name: joint.name.clone(),
                line: self.line,
                reason,
            },
        })
    }

    /// Reads a register.
    ///
    /// # Errors
    /// Returns an error if the device does not answer, or refuses.
    pub fn read(&mut self, id: Id, register: &Register) -> Result<i64, ServoError> {
        let read = self.read_raw(id, register);
        read.map_err(|trouble| self.explain(id, &format!("read {}", register.name), trouble))
    }

    /// Writes a register.
    ///
    /// # Errors
    /// Returns an error if the value is out of range, the write can do harm, or the device does not answer or
    /// refuses.
    pub fn write(
        &mut self,
        id: Id,
        model: &Model,
        register: &Register,
        value: i64,
        caution: Caution,
    ) -> Result<(), ServoError> {
        if !(register.min..=register.max).contains(&value) {
            let (model, name) = (model.name.clone(), register.name.clone());
            return Err(ServoError::Range {
                model,
                register: name,
                min: register.min,
                max: register.max,
                value,
            });
        }
        if caution == Caution::Refuse {
            self.check_harmless(id, model, register, value)?;
        }
        let lock = model
            .register("lock")
            .filter(|_| register.access == Access::Eeprom && self.line.protocol != Protocol::Dynamixel1);
        for (register, value) in lock.map(|lock| (lock, 0)).into_iter().chain([(register, value)]) {
            self.write_raw(id, register, value)?;
        }
        // A device with another id or speed is not there any more.
        if let Some(lock) = lock.filter(|_| !["id", "baud_rate"].contains(&&*register.name)) {
            self.write_raw(id, lock, 1)?;
        }
        Ok(())
    }

    /// Gives a device another id.
    ///
    /// # Errors
    /// Returns an error if another device has it, or the device does not answer or refuses.
    pub fn set_id(&mut self, id: Id, new: Id, caution: Caution) -> Result<(), ServoError> {
        let (_, model) = self.known(id)?;
        let register = Self::register(&model, "id")?;
        if caution == Caution::Refuse && self.presence(new, ATTEMPTS)? != Presence::Absent {
            return Err(ServoError::Dangerous(format!(
                "id {new} is taken: two devices of one id answer at the same time, and neither is understood"
            )));
        }
        self.write(id, &model, &register, i64::from(new.raw()), Caution::Force)?;
        if let Some(lock) = model.register("lock").filter(|_| self.line.protocol != Protocol::Dynamixel1) {
            self.write_raw(new, lock, 1)?;
        }
        match self.presence(new, ATTEMPTS)? {
            Presence::Present => Ok(()),
            Presence::Garbled => Err(self.garbled(new)),
            Presence::Absent => Err(self.silent(new)),
        }
    }

    fn check_harmless(
        &mut self,
        id: Id,
        model: &Model,
        register: &Register,
        value: i64,
    ) -> Result<(), ServoError> {
        let danger = match &*register.name {
            "id" => Some("a new id: use `downbeat servo set-id`, which checks that it is free".to_owned()),
            "baud_rate" => {
                Some("at another speed than the others of its bus the device cannot be reached".to_owned())
            }
            name if register.access == Access::Eeprom => {
                Some(format!("\"{name}\" outlives the power, and wears out with each write"))
            }
            "torque_enable" if value != 0 && self.turns_at_once(id, model)? => Some(
                "it is in an operating mode whose goal is a velocity or a current, and that goal is not 0: it would turn; write 0 to \
                 goal_velocity and goal_current first, or set operating_mode"
                    .to_owned(),
            ),
            "torque_enable" if value != 0 => {
                let (goal, position) =
                    (Self::register(model, "goal_position")?, Self::register(model, "present_position")?);
                let far = goal.to_si(self.read(id, &goal)? - self.read(id, &position)?);
                (far.abs() > JUMP_RAD).then(|| {
                    format!(
                        "the goal is {far:.2} rad from the position: it would jump; write goal_position first"
                    )
                })
            }
            "goal_position" => {
                let (torque, position) =
                    (Self::register(model, "torque_enable")?, Self::register(model, "present_position")?);
                let far = register.to_si(value - self.read(id, &position)?);
                (far.abs() > JUMP_RAD && self.read(id, &torque)? != 0).then(|| {
                    format!("the goal is {far:.2} rad from the position and the torque is on: it would jump")
                })
            }
            _ => None,
        };
        danger.map_or(Ok(()), |danger| Err(ServoError::Dangerous(danger)))
    }

    /// Whether a servo has a goal that is a velocity or a current, and not 0.
    fn turns_at_once(&mut self, id: Id, model: &Model) -> Result<bool, ServoError> {
        let Some(mode) = model.register("operating_mode") else { return Ok(false) };
        let mode = Some(self.read(id, mode)?);
        let goal = match mode {
            mode if mode == model.modes.velocity => "goal_velocity",
            mode if mode == model.modes.effort => "goal_current",
            _ => return Ok(false),
        };
        Ok(self.read(id, &Self::register(model, goal)?)? != 0)
    }

    fn read_raw(&mut self, id: Id, register: &Register) -> Result<i64, Trouble> {
        let (address, length) = (register.address, register.size);
        let mut read = Err(Trouble::Silent);
        for _ in 0..ATTEMPTS {
            read = self.ask(&Instruction::Read { id, address, length }, length);
            if read != Err(Trouble::Silent) {
                break;
            }
        }
        register.raw_in(self.line.protocol, &read?, address).ok_or(Trouble::Silent)
    }

    fn write_raw(&mut self, id: Id, register: &Register, value: i64) -> Result<(), ServoError> {
        let data = register.bytes(self.line.protocol, value);
        let written = self.ask(&Instruction::Write { id, address: register.address, data }, 0);
        // A device may answer with its new id or speed.
        let is_moved = ["id", "baud_rate"].contains(&&*register.name) && written == Err(Trouble::Silent);
        if is_moved {
            return Ok(());
        }
        written.map(|_| ()).map_err(|trouble| self.explain(id, &format!("write {}", register.name), trouble))
    }

    fn ask(&mut self, instruction: &Instruction, parameters: u16) -> Result<Vec<u8>, Trouble> {
        let mut exchanges = Vec::new();
        let mut line = Line { bus: &mut *self.bus, protocol: self.line.protocol, exchanges: &mut exchanges };
        let answer = line.ask(instruction, parameters);
        let has_bytes = exchanges.last().is_some_and(|exchange| !exchange.reply.is_empty());
        self.is_garbled = has_bytes && answer == Err(Trouble::Silent);
        answer
    }

    fn explain(&self, id: Id, doing: &str, trouble: Trouble) -> ServoError {
        match trouble {
            Trouble::PortFailed => self.lost(),
            Trouble::Silent if self.is_garbled => self.garbled(id),
            Trouble::Silent => self.silent(id),
            Trouble::Refused(error) => {
                let (path, line, doing) = (self.path.clone(), self.line, doing.to_owned());
                ServoError::Refused { path, line, id, doing, error }
            }
            Trouble::Echo => self.echo(),
        }
    }

    fn garbled(&self, id: Id) -> ServoError {
        ServoError::Garbled { path: self.path.clone(), id, line: self.line }
    }

    fn silent(&self, id: Id) -> ServoError {
        ServoError::Silent { path: self.path.clone(), id, line: self.line }
    }

    fn lost(&self) -> ServoError {
        let Self { path, line, .. } = self;
        ServoError::Port(format!("lost the serial port {path} at {} bit/s; is it plugged in?", line.baud))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use serialport::{SerialPort, TTYPort};
    use std::io::{Read, Write};

    /// A port that sends back what it gets.
    fn echo() -> (String, TTYPort) {
        let (mut far, near) = TTYPort::pair().unwrap();
        far.set_timeout(Duration::from_secs(60)).unwrap();
        std::thread::spawn(move || {
            let mut buffer = [0; 256];
            // Ends with the port.
            while let Ok(count @ 1..) = far.read(&mut buffer) {
                if far.write_all(&buffer[..count]).is_err() {
                    break;
                }
            }
        });
        (near.name().unwrap(), near)
    }

    #[test]
    fn no_device_is_found_behind_an_adapter_that_echoes() {
        let (path, _near) = echo();
        let ids: Vec<Id> = (0..4).filter_map(Id::new).collect();
        for protocol in Protocol::ALL {
            let mut port = ServoPort::open(&path, Duration::from_millis(500), Vec::new()).unwrap();
            let error = port.scan(1_000_000, &[protocol], &ids).unwrap_err();
            assert_eq!(error, ServoError::Echo { path: path.clone() }, "{protocol}");
            assert!(error.to_string().contains("the adapter echoes what is sent"), "{error}");
            port.speak(LineSettings { baud: 1_000_000, protocol }).unwrap();
            assert_eq!(port.identify(ids[1]), Err(ServoError::Echo { path: path.clone() }), "{protocol}");
        }
    }
}
