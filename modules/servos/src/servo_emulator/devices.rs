//! The devices behind a port: how they obey instructions and answer, in all protocols.

use super::fault::Disturbance;
use super::wire::Answer;
use crate::servo_bus::protocol::emit_joined;
use crate::servo_bus::protocol::{Id, Instruction, Packet, Protocol, ReadEntry, Status, StatusError};
use std::time::Duration;

/// The devices behind the port of an emulator.
///
/// What they answer depends only on the calls, so that the same instructions at the same times get the same
/// answers.
pub trait Devices: Send {
    /// The protocol that they speak.
    fn protocol(&self) -> Protocol;

    /// The speed of their bus, in bit/s.
    fn baud(&self) -> u32;

    /// Sets the speed at which the computer sends, in bit/s.
    fn set_line_speed(&mut self, baud: u32) {
        let _ = baud;
    }

    /// Advances to this time since the start.
    fn advance_to(&mut self, now: Duration);

    /// A step of the owner of the bus begins: see [`MemoryBus`](super::MemoryBus).
    fn begin_step(&mut self);

    /// Sets which devices are dead: without power, as if disconnected.
    fn set_dead(&mut self, is_dead: &dyn Fn(Id) -> bool);

    /// Sets what disturbs the servos. Devices that are not disturbed ignore it.
    fn disturb(&mut self, disturbance: Disturbance) {
        let _ = disturbance;
    }

    /// Executes an instruction.
    ///
    /// `is_lost` is called before each answer; a lost answer has the same effect as a silent device, also for
    /// the devices after it.
    fn answer(&mut self, packet: &Packet<'_>, is_lost: &mut dyn FnMut() -> bool) -> Vec<Answer>;

    /// Turns a joint by hand; see [`Body::turn_by_hand`](super::Body::turn_by_hand). Returns false if there
    /// is no such joint.
    fn turn_by_hand(&mut self, joint: &str, angle: f64) -> bool {
        let _ = (joint, angle);
        false
    }

    /// Whether a joint is being turned by hand.
    fn is_in_hand(&self, joint: &str) -> bool {
        let _ = joint;
        false
    }

    /// Holds a button down for a while; `number` is its position on the robot. Devices without buttons ignore
    /// it.
    fn press(&mut self, number: usize, held: Duration) {
        let _ = (number, held);
    }
}

/// A device with a control table.
pub trait Device {
    /// Its address.
    fn id(&self) -> u8;
    /// Its status return level: 0 answers pings, 1 also reads, 2 all.
    fn status_return_level(&self) -> u16;
    /// The delay before it answers.
    fn return_delay(&self) -> Duration;
    /// The errors that it reports with each answer.
    fn error(&self) -> StatusError;
    /// The parameters of its answer to a ping in Dynamixel 2.0: model and firmware.
    fn identity(&self) -> [u8; 3];
    /// Reads registers.
    ///
    /// # Errors
    /// The error that the device answers with.
    fn read(&self, address: u16, length: u16) -> Result<Vec<u8>, StatusError>;
    /// Writes everything, or nothing with an error.
    ///
    /// # Errors
    /// The error that the device answers with.
    fn write(&mut self, address: u16, data: &[u8]) -> Result<(), StatusError>;
    /// The write that waits for an action: its address and bytes.
    fn registered(&mut self) -> &mut Option<(u16, Vec<u8>)>;
    /// Restarts it, as after a loss of power.
    fn reboot(&mut self) {}
}

/// The lowest status return level that answers reads.
const READS: u16 = 1;
const ALL: u16 = 2;

/// Executes an instruction on the devices that have power, and returns their answers.
///
/// `is_lost` is called before each answer; a lost answer has the same effect as a silent device, also for the
/// devices after it.
pub fn answer(
    protocol: Protocol,
    devices: &mut [&mut dyn Device],
    packet: &Packet<'_>,
    is_lost: &mut dyn FnMut() -> bool,
) -> Vec<Answer> {
    let entries = |address, length, ids: &[Id]| -> Vec<ReadEntry> {
        ids.iter().map(|id| ReadEntry { id: *id, address, length }).collect()
    };
    match Instruction::parse(packet) {
        Ok(Instruction::SyncWrite { address, entries, .. }) => {
            for (id, data) in entries {
                write_silently(devices, id, address, &data);
            }
            Vec::new()
        }
        Ok(Instruction::BulkWrite { entries }) => {
            for entry in entries {
                write_silently(devices, entry.id, entry.address, &entry.data);
            }
            Vec::new()
        }
        Ok(Instruction::BulkRead { entries }) => {
            let statuses = statuses_in_turn(devices, &entries, is_lost);
            statuses.iter().map(|status| wrap(protocol, devices, status)).collect()
        }
        Ok(Instruction::SyncRead { address, length, ids }) => {
            let statuses = statuses_in_turn(devices, &entries(address, length, &ids), is_lost);
            statuses.iter().map(|status| wrap(protocol, devices, status)).collect()
        }
        Ok(Instruction::FastBulkRead { entries }) => joined(devices, &entries, is_lost),
        Ok(Instruction::FastSyncRead { address, length, ids }) => {
            joined(devices, &entries(address, length, &ids), is_lost)
        }
        // In Dynamixel 2.0 and Feetech STS all devices answer, in the order of their ids.
        Ok(Instruction::Ping { id })
            if id.is_broadcast() && matches!(protocol, Protocol::Dynamixel2 | Protocol::FeetechSts) =>
        {
            devices.sort_by_key(|device| device.id());
            let pinged = devices.iter().filter(|_| !is_lost());
            pinged
                .map(|device| answer_of(protocol, &**device, StatusError::NONE, pong(protocol, &**device)))
                .collect()
        }
        Ok(instruction) if instruction.id().is_broadcast() => {
            for device in devices {
                let _ = obey(protocol, *device, &instruction);
            }
            Vec::new()
        }
        Ok(instruction) => {
            let device = find(devices, instruction.id());
            let answer = device.and_then(|device| obey(protocol, device, &instruction));
            answer.into_iter().filter(|_| !is_lost()).collect()
        }
        Err(_) => {
            let device = find(devices, packet.id());
            let answer =
                device.map(|device| answer_of(protocol, device, StatusError::INSTRUCTION, Vec::new()));
            answer.into_iter().filter(|_| !is_lost()).collect()
        }
    }
}

fn find<'a>(devices: &'a mut [&mut dyn Device], id: Id) -> Option<&'a mut dyn Device> {
    devices.iter_mut().find(|device| device.id() == id.raw()).map(|device| &mut **device as &mut dyn Device)
}

/// Nobody answers, so errors are not reported.
fn write_silently(devices: &mut [&mut dyn Device], id: Id, address: u16, data: &[u8]) {
    if let Some(device) = find(devices, id) {
        let _ = device.write(address, data);
    }
}

/// The answers up to the first silent device: each one waits for the answer of the one before it.
fn statuses_in_turn(
    devices: &mut [&mut dyn Device],
    entries: &[ReadEntry],
    is_lost: &mut dyn FnMut() -> bool,
) -> Vec<Status> {
    let mut statuses = Vec::new();
    for entry in entries {
        let Some(device) = find(devices, entry.id).filter(|_| !is_lost()) else { break };
        if device.status_return_level() < READS {
            break;
        }
        let (error, parameters) = read(device, entry.address, entry.length);
        statuses.push(Status { id: entry.id, error: error | device.error(), parameters });
    }
    statuses
}

/// The devices answer in one packet, which breaks off before the first silent device.
fn joined(
    devices: &mut [&mut dyn Device],
    entries: &[ReadEntry],
    is_lost: &mut dyn FnMut() -> bool,
) -> Vec<Answer> {
    let mut statuses = statuses_in_turn(devices, entries, is_lost);
    let came = statuses.len();
    // The header has the length of the complete packet, so the silent devices are put in and their bytes
    // taken off.
    for entry in &entries[came..] {
        let parameters = vec![0; usize::from(entry.length)];
        statuses.push(Status { id: entry.id, error: StatusError::NONE, parameters });
    }
    let mut packet = Vec::new();
    emit_joined(&statuses, &mut packet);
    let missing: usize = entries[came..].iter().map(|entry| usize::from(entry.length) + 4).sum();
    packet.truncate(packet.len() - missing);
    if came == 0 { Vec::new() } else { vec![Answer { packet, return_delay: Duration::ZERO }] }
}

fn read(device: &dyn Device, address: u16, length: u16) -> (StatusError, Vec<u8>) {
    match device.read(address, length) {
        Ok(data) => (StatusError::NONE, data),
        Err(error) => (error, Vec::new()),
    }
}

/// Executes an instruction for one device; `None` if its settings say not to answer.
fn obey(protocol: Protocol, device: &mut dyn Device, instruction: &Instruction) -> Option<Answer> {
    let level = device.status_return_level();
    let result = match instruction {
        Instruction::Ping { .. } => {
            let parameters = pong(protocol, device);
            return Some(answer_of(protocol, device, StatusError::NONE, parameters));
        }
        Instruction::Read { address, length, .. } => {
            let (error, data) = read(device, *address, *length);
            return (level >= READS).then(|| answer_of(protocol, device, error, data));
        }
        Instruction::Write { address, data, .. } => device.write(*address, data),
        Instruction::RegWrite { address, data, .. } => {
            *device.registered() = Some((*address, data.clone()));
            Ok(())
        }
        Instruction::Action { .. } => match device.registered().take() {
            Some((address, data)) => device.write(address, &data),
            None => Err(StatusError::INSTRUCTION),
        },
        Instruction::Reboot { .. } => {
            device.reboot();
            Ok(())
        }
        _ => Err(StatusError::INSTRUCTION),
    };
    (level >= ALL).then(|| answer_of(protocol, device, result.err().unwrap_or_default(), Vec::new()))
}

fn pong(protocol: Protocol, device: &dyn Device) -> Vec<u8> {
    if protocol == Protocol::Dynamixel2 { device.identity().to_vec() } else { Vec::new() }
}

fn answer_of(protocol: Protocol, device: &dyn Device, error: StatusError, parameters: Vec<u8>) -> Answer {
    let mut packet = Vec::new();
    if let Some(id) = Id::new(device.id()) {
        let status = Status { id, error: error | device.error(), parameters };
        // What is read is shorter than a packet.
        let _ = status.emit(protocol, &mut packet);
    }
    Answer { packet, return_delay: device.return_delay() }
}

fn wrap(protocol: Protocol, devices: &mut [&mut dyn Device], status: &Status) -> Answer {
    let mut packet = Vec::new();
    let _ = status.emit(protocol, &mut packet);
    let return_delay = find(devices, status.id).map_or(Duration::ZERO, |device| device.return_delay());
    Answer { packet, return_delay }
}
