//! Which devices are on a port, and what is wrong with them.

use super::error::GARBLED;
use super::{ATTEMPTS, ServoError, ServoPort};
use crate::servo_bus::bus::{ExpectedStatus, LineSettings, Outcome};
use crate::servo_bus::line::{Trouble, for_each_status};
use crate::servo_bus::models::{self, Model};
use crate::servo_bus::protocol::{Id, Instruction, Protocol, echo_end};
use std::sync::Arc;

/// The register of a board that switches the power of the servos behind it.
const POWER_SWITCH: &str = "dynamixel_power";
/// How often the position of a servo is read to see whether its answers come.
const READS_OF_EXAMINATION: usize = 10;
/// The bytes of an answer to a ping in Dynamixel 2.0, with number of the model and firmware.
const LENGTH_OF_PONG: usize = 14;

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
pub(super) enum Presence {
    /// Nothing.
    Absent,
    /// Bytes that are no answer.
    Garbled,
    /// An answer.
    Present,
}

impl ServoPort {
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
    pub(super) fn presence(&mut self, id: Id, attempts: usize) -> Result<Presence, ServoError> {
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
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use serialport::{SerialPort, TTYPort};
    use std::io::{Read, Write};
    use std::time::Duration;

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
