//! Finding and configuring single servos, for commands: a port, and one device asked at a time.

mod error;
mod scan;
mod write;

pub use error::ServoError;
pub use scan::Found;
pub use write::Caution;

use super::bus::{Bus, LineSettings, Outcome, SerialBus};
use super::joint::Joint;
use super::line::{Line, Trouble};
use super::models::{Model, Register};
use super::preparation::{PrepareError, Prepared, prepare};
use super::protocol::{Id, Instruction};
use super::servo::Servo;
use downbeat_msgs::definitions::suggestion;
use std::sync::Arc;
use std::time::Duration;

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

    fn echo(&self) -> ServoError {
        ServoError::Echo { path: self.path.clone() }
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
