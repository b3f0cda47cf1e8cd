//! How the devices of a bus are read in each cycle, by as few exchanges as the protocol permits.

use super::bus::{Exchange, ExpectedStatus};
use super::description::{BusPlan, DevicePlan};
use super::joint::Measurement;
use super::line::for_each_status;
use super::models::{Model, Reads, Register};
use super::protocol::{
    Id, Instruction, Protocol, ReadEntry, Status, echo_end, joined_parameters, split_joined,
};
use downbeat_executor::Time;

/// A device of a bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Unit {
    /// The position in [`BusPlan::devices`].
    Device(usize),
    /// The position in [`BusPlan::joints`].
    Joint(usize),
}

/// A read of some units by one exchange.
pub(crate) struct Request {
    pub(crate) instruction: Instruction,
    pub(crate) expected: Vec<ExpectedStatus>,
    pub(crate) units: Vec<Unit>,
    entries: Vec<ReadEntry>,
}

/// The result of one exchange.
pub(crate) struct Answered {
    /// The unit and what it answered, in the order of the request.
    pub(crate) units: Vec<(Unit, Option<Answer>)>,
    /// The position in the request of the first device that did not answer.
    pub(crate) first_missing: Option<usize>,
    /// Whether any device after that one answered.
    pub(crate) chain_went_on: bool,
}

/// What a unit answered.
pub(crate) enum Answer {
    Joint(Measurement, Status),
    Device(Status),
}

/// The result of the reads of one cycle.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// When the first of them was requested.
    pub sent: Time,
    /// Whether any joint answered.
    pub has_joints: bool,
    /// The devices, in the order of the plan: the range that is read of those that answered.
    pub devices: Vec<Option<Vec<u8>>>,
}

/// The most devices in one request, so that a packet of any protocol holds it.
const MOST: usize = 60;

impl BusPlan {
    fn model(&self, unit: Unit) -> &Model {
        match unit {
            Unit::Device(index) => &self.devices[index].model,
            Unit::Joint(index) => &self.joints[index].model,
        }
    }

    fn entry(&self, unit: Unit) -> ReadEntry {
        let (id, (address, length)) = match unit {
            Unit::Device(index) => (self.devices[index].id, self.devices[index].span()),
            Unit::Joint(index) => (self.joints[index].id, self.joints[index].registers.span()),
        };
        ReadEntry { id, address, length }
    }

    /// The address of a unit, and its name for logs.
    pub(crate) fn label(&self, unit: Unit) -> (Id, &str) {
        match unit {
            Unit::Device(index) => (self.devices[index].id, &self.devices[index].name),
            Unit::Joint(index) => (self.joints[index].id, &self.joints[index].name),
        }
    }
}

impl DevicePlan {
    /// The range that is read in every cycle: first address and length.
    #[must_use]
    pub fn span(&self) -> (u16, u16) {
        let first = self.read.iter().map(|register| register.address).min().unwrap_or(0);
        let end = self.read.iter().map(Register::end).max().unwrap_or(0);
        (first, end - first)
    }

    /// The value of a register in the range that is read, in its unit.
    #[must_use]
    pub fn value(&self, protocol: Protocol, register: &Register, piece: &[u8]) -> Option<f64> {
        register.raw_in(protocol, piece, self.span().0).map(|raw| register.to_si(raw))
    }
}

/// The instructions that read these units.
pub(crate) fn requests(plan: &BusPlan, units: &[Unit]) -> Vec<Request> {
    let units: Vec<Unit> = units.iter().copied().filter(|unit| plan.entry(*unit).length > 0).collect();
    let mut requests = Vec::new();
    let protocol = plan.line.protocol;
    let (alone, together): (Vec<Unit>, Vec<Unit>) = units
        .iter()
        .partition(|unit| protocol == Protocol::FeetechScs || plan.model(**unit).reads == Reads::OneByOne);
    let range = |unit: &Unit| (plan.entry(*unit).address, plan.entry(*unit).length);
    let is_uniform = together.iter().all(|unit| range(unit) == range(&together[0]));
    let groups: Vec<Vec<Unit>> = if protocol == Protocol::FeetechSts {
        // There is no bulk read: one sync read for each range.
        let mut ranges: Vec<_> = together.iter().map(range).collect();
        ranges.dedup();
        ranges.sort_unstable();
        ranges.dedup();
        let of = |wanted| together.iter().copied().filter(move |unit| range(unit) == wanted).collect();
        ranges.into_iter().map(of).collect()
    } else {
        vec![together.clone()]
    };
    for units in groups.iter().flat_map(|group| group.chunks(MOST)) {
        let entries: Vec<ReadEntry> = units.iter().map(|unit| plan.entry(*unit)).collect();
        let ids = || entries.iter().map(|entry| entry.id).collect::<Vec<Id>>();
        let (address, length) = (entries[0].address, entries[0].length);
        let instruction = match protocol {
            Protocol::Dynamixel1 => Instruction::BulkRead { entries: entries.clone() },
            Protocol::Dynamixel2 => match (is_uniform, plan.fast_reads) {
                (true, false) => Instruction::SyncRead { address, length, ids: ids() },
                (true, true) => Instruction::FastSyncRead { address, length, ids: ids() },
                (false, false) => Instruction::BulkRead { entries: entries.clone() },
                (false, true) => Instruction::FastBulkRead { entries: entries.clone() },
            },
            Protocol::FeetechSts | Protocol::FeetechScs => {
                Instruction::SyncRead { address, length, ids: ids() }
            }
        };
        let expected = if plan.fast_reads {
            let parameters = joined_parameters(entries.iter().map(|entry| entry.length));
            vec![ExpectedStatus { id: Id::BROADCAST, parameters }]
        } else {
            entries.iter().map(expected).collect()
        };
        requests.push(Request { instruction, expected, units: units.to_vec(), entries });
    }
    for unit in alone {
        let entry = plan.entry(unit);
        let ReadEntry { id, address, length } = entry;
        let instruction = Instruction::Read { id, address, length };
        requests.push(Request {
            instruction,
            expected: vec![expected(&entry)],
            units: vec![unit],
            entries: vec![entry],
        });
    }
    requests
}

fn expected(entry: &ReadEntry) -> ExpectedStatus {
    ExpectedStatus { id: entry.id, parameters: entry.length }
}

/// Parses the answers to a request.
pub(crate) fn understand(plan: &BusPlan, request: &Request, exchange: &Exchange) -> Answered {
    let protocol = plan.line.protocol;
    let mut statuses: Vec<Option<Status>> = vec![None; request.units.len()];
    let mut put = |status: Status| {
        if let Some(position) = request.entries.iter().position(|entry| entry.id == status.id) {
            statuses[position] = Some(status);
        }
    };
    if plan.fast_reads && request.expected[0].id.is_broadcast() {
        let parts: Vec<_> = request.entries.iter().map(|entry| (entry.id, entry.length)).collect();
        split_joined(&exchange.reply, &parts).into_iter().for_each(&mut put);
    } else {
        let start = echo_end(protocol, &exchange.instruction, &exchange.reply).unwrap_or(0);
        for_each_status(protocol, &exchange.reply[start..], &mut put);
    }
    let units: Vec<_> = request
        .units
        .iter()
        .zip(request.entries.iter().zip(statuses))
        .map(|(unit, (entry, status))| {
            let status = status.filter(|status| status.parameters.len() == usize::from(entry.length));
            let answer = status.and_then(|status| match unit {
                Unit::Device(_) => Some(Answer::Device(status)),
                Unit::Joint(index) => {
                    let measurement = plan.joints[*index].measurement(protocol, &status.parameters)?;
                    Some(Answer::Joint(measurement, status))
                }
            });
            (*unit, answer)
        })
        .collect();
    let mut answered = units.iter().map(|(_, answer)| answer.is_some());
    let first_missing = answered.position(|answered| !answered);
    let chain_went_on = answered.any(|answered| answered);
    Answered { units, first_missing, chain_went_on }
}
