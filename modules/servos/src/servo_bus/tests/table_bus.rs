//! Servos that are nothing but control tables: they take every write, and read what a test puts into them.

use super::bus::{Bus, Exchange, ExchangeKind, ExpectedStatus, LineSettings, Outcome};
use super::protocol::{
    Id, Instruction, Packet, Protocol, ReadEntry, Status, StatusError, WriteEntry, emit_joined,
};
use super::*;
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The servos of a bus.
pub(super) struct Tables {
    pub(super) plan: BusPlan,
    tables: BTreeMap<Id, Vec<u8>>,
    /// The errors beside each answer.
    pub(super) error: StatusError,
    /// Whether the port works.
    pub(super) is_plugged: bool,
    /// Whether the adapter sends back what it is sent.
    pub(super) echoes: bool,
    /// All writes, in their order.
    pub(super) writes: Vec<WriteEntry>,
}

impl Tables {
    pub(super) fn of(plan: &BusPlan) -> Arc<Mutex<Self>> {
        let protocol = plan.line.protocol;
        let table = |(id, model): (Id, &models::Model)| {
            let mut table = vec![0; usize::from(model.length())];
            for register in &model.registers {
                let bytes = register.bytes(protocol, register.initial);
                table[usize::from(register.address)..usize::from(register.end())].copy_from_slice(&bytes);
            }
            (id, table)
        };
        let joints = plan.joints.iter().map(|joint| (joint.id, &*joint.model));
        let devices = plan.devices.iter().map(|device| (device.id, &*device.model));
        Arc::new(Mutex::new(Self {
            plan: plan.clone(),
            tables: joints.chain(devices).map(table).collect(),
            error: StatusError::NONE,
            is_plugged: true,
            echoes: false,
            writes: Vec::new(),
        }))
    }

    fn place(&self, joint: usize, register: &str) -> (Id, models::Register) {
        let joint = &self.plan.joints[joint];
        (joint.id, joint.model.register(register).unwrap().clone())
    }

    pub(super) fn get(&self, joint: usize, register: &str) -> i64 {
        let (id, register) = self.place(joint, register);
        register.raw_in(self.plan.line.protocol, &self.tables[&id], 0).unwrap()
    }

    pub(super) fn set(&mut self, joint: usize, register: &str, raw: i64) {
        let (id, register) = self.place(joint, register);
        let bytes = register.bytes(self.plan.line.protocol, raw);
        self.write(id, register.address, &bytes);
    }

    /// The values that were written to a register since the last call.
    pub(super) fn written(&mut self, joint: usize, name: &str) -> Vec<i64> {
        let (id, register) = self.place(joint, name);
        let protocol = self.plan.line.protocol;
        let is_of = |entry: &&WriteEntry| {
            let end = entry.address + entry.data.len() as u16;
            entry.id == id && entry.address <= register.address && register.end() <= end
        };
        let written = self.writes.iter().filter(is_of);
        written.filter_map(|entry| register.raw_in(protocol, &entry.data, entry.address)).collect()
    }

    fn write(&mut self, id: Id, address: u16, data: &[u8]) {
        let Some(table) = self.tables.get_mut(&id) else { return };
        if let Some(place) = table.get_mut(usize::from(address)..usize::from(address) + data.len()) {
            place.copy_from_slice(data);
        }
    }

    fn read(&self, entry: &ReadEntry) -> Option<Status> {
        let begin = usize::from(entry.address);
        let piece = self.tables.get(&entry.id)?.get(begin..begin + usize::from(entry.length))?;
        Some(Status { id: entry.id, error: self.error, parameters: piece.to_vec() })
    }

    pub(super) fn answer(&mut self, bytes: &[u8]) -> Vec<u8> {
        let protocol = self.plan.line.protocol;
        let mut reply = if self.echoes { bytes.to_vec() } else { Vec::new() };
        let instruction = Instruction::parse(&Packet::new_checked(protocol, bytes).unwrap()).unwrap();
        let range = |address, length, ids: Vec<Id>| -> Vec<ReadEntry> {
            ids.into_iter().map(|id| ReadEntry { id, address, length }).collect()
        };
        let mut put = |statuses: Vec<Status>| {
            statuses.iter().for_each(|status| status.emit(protocol, &mut reply).unwrap());
        };
        match instruction {
            Instruction::Ping { id } => {
                let count = if protocol == Protocol::Dynamixel2 { 3 } else { 0 };
                let known = self.tables.get(&id);
                let parameters = known.map(|table| table[..count].to_vec());
                put(parameters
                    .map(|parameters| Status { id, error: self.error, parameters })
                    .into_iter()
                    .collect());
            }
            Instruction::Read { id, address, length } => {
                put(self.read(&ReadEntry { id, address, length }).into_iter().collect());
            }
            Instruction::SyncRead { address, length, ids } => {
                put(range(address, length, ids).iter().filter_map(|entry| self.read(entry)).collect());
            }
            Instruction::BulkRead { entries } => {
                put(entries.iter().filter_map(|entry| self.read(entry)).collect());
            }
            Instruction::FastSyncRead { address, length, ids } => {
                let entries = range(address, length, ids);
                emit_joined(
                    &entries.iter().filter_map(|entry| self.read(entry)).collect::<Vec<_>>(),
                    &mut reply,
                );
            }
            Instruction::FastBulkRead { entries } => {
                emit_joined(
                    &entries.iter().filter_map(|entry| self.read(entry)).collect::<Vec<_>>(),
                    &mut reply,
                );
            }
            Instruction::Write { id, address, data } => {
                self.write(id, address, &data);
                put(vec![Status { id, error: self.error, parameters: Vec::new() }]);
                self.writes.push(WriteEntry { id, address, data });
            }
            Instruction::SyncWrite { address, entries, .. } => {
                for (id, data) in entries {
                    self.write(id, address, &data);
                    self.writes.push(WriteEntry { id, address, data });
                }
            }
            Instruction::BulkWrite { entries } => {
                for entry in entries {
                    self.write(entry.id, entry.address, &entry.data);
                    self.writes.push(entry);
                }
            }
            other => panic!("the driver sends {other:?}"),
        }
        reply
    }
}

/// The port to them. `answer` may change what they answer.
pub(super) struct TableBus<F> {
    pub(super) tables: Arc<Mutex<Tables>>,
    pub(super) answer: F,
    pub(super) now: Time,
}

pub(super) fn honest(tables: &mut Tables, instruction: &[u8]) -> Vec<u8> {
    tables.answer(instruction)
}

impl<F: FnMut(&mut Tables, &[u8]) -> Vec<u8> + Send> TableBus<F> {
    pub(super) fn new(tables: &Arc<Mutex<Tables>>, answer: F) -> Self {
        Self { tables: Arc::clone(tables), answer, now: Time::ZERO }
    }

    fn done(&self, kind: ExchangeKind, instruction: &[u8], reply: Vec<u8>, outcome: Outcome) -> Exchange {
        let error = if outcome == Outcome::Ok { String::new() } else { "unplugged".to_owned() };
        let instruction = instruction.to_vec();
        Exchange { sequence: 0, kind, sent: self.now, duration_us: 0, instruction, reply, outcome, error }
    }
}

impl<F: FnMut(&mut Tables, &[u8]) -> Vec<u8> + Send> Bus for TableBus<F> {
    fn begin_step(&mut self, now: Time) {
        self.now = now;
    }

    fn set_line(&mut self, _line: LineSettings) {}

    fn open(&mut self, _port: &str) -> Exchange {
        let is_plugged = self.tables.lock().is_plugged;
        let outcome = if is_plugged { Outcome::Ok } else { Outcome::Failed };
        self.done(ExchangeKind::Open, &[], Vec::new(), outcome)
    }

    fn exchange(&mut self, instruction: &[u8], _expected: &[ExpectedStatus]) -> Exchange {
        let mut tables = self.tables.lock();
        if !tables.is_plugged {
            drop(tables);
            return self.done(ExchangeKind::Transfer, instruction, Vec::new(), Outcome::Failed);
        }
        let reply = (self.answer)(&mut tables, instruction);
        drop(tables);
        self.done(ExchangeKind::Transfer, instruction, reply, Outcome::Ok)
    }

    fn close(&mut self) -> Exchange {
        self.done(ExchangeKind::Close, &[], Vec::new(), Outcome::Ok)
    }
}

/// A description like STS3215 in the protocol that has the high byte first.
pub(super) fn scs(folder: &std::path::Path) -> Description {
    let model = include_str!("../models/sts3215.toml")
        .replace("STS3215", "SCS")
        .replace("number = 777", "number = 5")
        .replace("initial = 777", "initial = 5")
        .replace("protocols = [\"feetech_sts\"]", "protocols = [\"feetech_scs\"]")
        .replace("reads = \"sync\"", "reads = \"one_by_one\"");
    std::fs::write(folder.join("scs.toml"), model).unwrap();
    let text = arm("feetech_scs", "SCS", "").replacen("[[bus]]", "models = [\"scs.toml\"]\n[[bus]]", 1);
    std::fs::write(folder.join("arm.toml"), text).unwrap();
    Description::load(folder.join("arm.toml").to_str().unwrap()).unwrap()
}

/// Whether a protocol reports errors that a test sets.
pub(super) fn has_position_alarm(protocol: Protocol) -> bool {
    matches!(protocol, Protocol::FeetechSts | Protocol::FeetechScs)
}
