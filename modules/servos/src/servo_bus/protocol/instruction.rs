//! Instructions from the computer to the devices.

use super::packet::emit_packet;
use super::{EmitError, Id, Packet, Protocol};

const PING: u8 = 0x01;
const READ: u8 = 0x02;
const WRITE: u8 = 0x03;
const REG_WRITE: u8 = 0x04;
const ACTION: u8 = 0x05;
const FACTORY_RESET: u8 = 0x06;
const REBOOT: u8 = 0x08;
const SYNC_READ: u8 = 0x82;
const SYNC_WRITE: u8 = 0x83;
const FAST_SYNC_READ: u8 = 0x8A;
const BULK_READ: u8 = 0x92;
const BULK_WRITE: u8 = 0x93;
const FAST_BULK_READ: u8 = 0x9A;

/// The option of a factory reset in Dynamixel 2.0 that keeps id and baud rate.
const KEEP_ID_AND_BAUD_RATE: u8 = 0x02;

/// An instruction. Which ones exist depends on the protocol and the device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Instruction {
    /// Requests an answer; in Dynamixel 2.0 it has the model and the firmware.
    Ping {
        /// The device.
        id: Id,
    },
    /// Reads from the control table.
    Read {
        /// The device.
        id: Id,
        /// First address.
        address: u16,
        /// The number of bytes.
        length: u16,
    },
    /// Writes to the control table.
    Write {
        /// The device.
        id: Id,
        /// First address.
        address: u16,
        /// The bytes.
        data: Vec<u8>,
    },
    /// Registers a write that is executed by ACTION.
    RegWrite {
        /// The device.
        id: Id,
        /// First address.
        address: u16,
        /// The bytes.
        data: Vec<u8>,
    },
    /// Executes a registered write.
    Action {
        /// The device.
        id: Id,
    },
    /// Resets all settings; in Dynamixel 2.0 except id and baud rate.
    FactoryReset {
        /// The device.
        id: Id,
    },
    /// Restarts the device (Dynamixel 2.0).
    Reboot {
        /// The device.
        id: Id,
    },
    /// Reads the same range from several devices, which answer one after another (Dynamixel 2.0, Feetech
    /// STS).
    SyncRead {
        /// First address.
        address: u16,
        /// The number of bytes.
        length: u16,
        /// The devices, in the order of their answers.
        ids: Vec<Id>,
    },
    /// Like a sync read, but all devices answer in one packet (Dynamixel 2.0).
    FastSyncRead {
        /// First address.
        address: u16,
        /// The number of bytes.
        length: u16,
        /// The devices, in the order of their answers.
        ids: Vec<Id>,
    },
    /// Writes to the control tables of several devices at once. Sent to all devices, without answers.
    SyncWrite {
        /// First address, the same for all devices.
        address: u16,
        /// The number of bytes for each device.
        length: u16,
        /// The devices and their bytes.
        entries: Vec<(Id, Vec<u8>)>,
    },
    /// Reads different ranges from several devices, which answer one after another (Dynamixel).
    BulkRead {
        /// The devices and ranges, in the order of the answers.
        entries: Vec<ReadEntry>,
    },
    /// Like a bulk read, but all devices answer in one packet (Dynamixel 2.0).
    FastBulkRead {
        /// The devices and ranges, in the order of the answers.
        entries: Vec<ReadEntry>,
    },
    /// Writes different ranges of several devices at once, without answers (Dynamixel 2.0).
    BulkWrite {
        /// The devices, ranges and bytes.
        entries: Vec<WriteEntry>,
    },
}

/// What to read from whom.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadEntry {
    /// The device.
    pub id: Id,
    /// The address in its control table.
    pub address: u16,
    /// The number of bytes.
    pub length: u16,
}

/// What to write where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WriteEntry {
    /// The device.
    pub id: Id,
    /// The address in its control table.
    pub address: u16,
    /// The bytes.
    pub data: Vec<u8>,
}

/// Why a valid packet is not an instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InstructionError {
    /// The protocol has no instruction with this code.
    #[error("no instruction has the code {code:02X}")]
    Unknown {
        /// The code on the wire.
        code: u8,
    },
    /// The parameters do not fit the instruction.
    #[error("{count} bytes of parameters do not fit the instruction {code:02X}")]
    Parameters {
        /// The code on the wire.
        code: u8,
        /// The number of parameter bytes.
        count: usize,
    },
    /// The instruction exists only for all devices at once.
    #[error("the instruction {code:02X} must go to id 254, not to {id}")]
    NotBroadcast {
        /// The code on the wire.
        code: u8,
        /// The device it was sent to.
        id: Id,
    },
}

/// The noise in front of an echo, such as that of a switch of direction, in bytes.
const NOISE: usize = 2;

/// Where the instruction itself ends at the start of a reply: the adapter echoes what is sent. `None` if it
/// does not.
///
/// Only a ping proves nothing: in the protocols that distinguish answers by their length alone, a device that
/// reports its supply voltage answers one with the same bytes.
#[must_use]
pub fn echo_end(protocol: Protocol, instruction: &[u8], reply: &[u8]) -> Option<usize> {
    let code = instruction.get(4)?;
    if protocol != Protocol::Dynamixel2 && *code == PING {
        return None;
    }
    let starts =
        (0..=NOISE).find(|start| reply.get(*start..).is_some_and(|rest| rest.starts_with(instruction)))?;
    Some(starts + instruction.len())
}

impl Instruction {
    /// Parses a packet sent to the devices.
    ///
    /// # Errors
    /// Returns an error if the protocol has no instruction with this code, or its parameters do not fit.
    pub fn parse(packet: &Packet<'_>) -> Result<Self, InstructionError> {
        let (id, code) = (packet.id(), packet.code());
        let parameters = packet.parameters();
        let count = parameters.len();
        let parsed = match packet.protocol() {
            Protocol::Dynamixel2 => parse_2(id, code, &parameters),
            protocol => parse_1(protocol, id, code, &parameters),
        };
        match parsed {
            Parsed::Instruction(instruction) => match instruction {
                Self::SyncRead { .. }
                | Self::FastSyncRead { .. }
                | Self::SyncWrite { .. }
                | Self::BulkRead { .. }
                | Self::FastBulkRead { .. }
                | Self::BulkWrite { .. }
                    if !id.is_broadcast() =>
                {
                    Err(InstructionError::NotBroadcast { code, id })
                }
                instruction => Ok(instruction),
            },
            Parsed::Misfit => Err(InstructionError::Parameters { code, count }),
            Parsed::Unknown => Err(InstructionError::Unknown { code }),
        }
    }

    /// Appends the packet to `out`.
    ///
    /// # Errors
    /// Returns an error if the protocol has no such instruction, or one packet cannot hold it.
    pub fn emit(&self, protocol: Protocol, out: &mut Vec<u8>) -> Result<(), EmitError> {
        let (code, parameters) =
            if protocol == Protocol::Dynamixel2 { self.parameters_2() } else { self.parameters_1(protocol)? };
        emit_packet(protocol, self.id(), code, &parameters, out)
    }

    /// The packet as a separate buffer.
    ///
    /// # Errors
    /// See [`emit`](Self::emit).
    pub fn to_bytes(&self, protocol: Protocol) -> Result<Vec<u8>, EmitError> {
        let mut out = Vec::new();
        self.emit(protocol, &mut out)?;
        Ok(out)
    }

    /// The device.
    #[must_use]
    pub fn id(&self) -> Id {
        match *self {
            Self::Ping { id }
            | Self::Read { id, .. }
            | Self::Write { id, .. }
            | Self::RegWrite { id, .. }
            | Self::Action { id }
            | Self::FactoryReset { id }
            | Self::Reboot { id } => id,
            _ => Id::BROADCAST,
        }
    }

    /// Returns whether several devices answer it.
    #[must_use]
    pub fn is_read_of_several(&self) -> bool {
        matches!(
            self,
            Self::SyncRead { .. }
                | Self::FastSyncRead { .. }
                | Self::BulkRead { .. }
                | Self::FastBulkRead { .. }
        )
    }

    fn parameters_1(&self, protocol: Protocol) -> Result<(u8, Vec<u8>), EmitError> {
        let byte = |number: u16| u8::try_from(number).map_err(|_| EmitError::Address { protocol, number });
        let lacks = |instruction| Err(EmitError::Instruction { protocol, instruction });
        Ok(match self {
            Self::Ping { .. } => (PING, Vec::new()),
            Self::Read { address, length, .. } => (READ, vec![byte(*address)?, byte(*length)?]),
            Self::Write { address, data, .. } => (WRITE, joined(&[byte(*address)?], data)),
            Self::RegWrite { address, data, .. } => (REG_WRITE, joined(&[byte(*address)?], data)),
            Self::Action { .. } => (ACTION, Vec::new()),
            Self::FactoryReset { .. } => (FACTORY_RESET, Vec::new()),
            Self::SyncWrite { address, length, entries } => {
                let front = [byte(*address)?, byte(*length)?];
                (SYNC_WRITE, joined(&front, &sync_entries(entries)))
            }
            Self::SyncRead { address, length, ids } if protocol == Protocol::FeetechSts => {
                let front = [byte(*address)?, byte(*length)?];
                (SYNC_READ, joined(&front, &raw(ids)))
            }
            Self::BulkRead { entries } if protocol == Protocol::Dynamixel1 => {
                let mut parameters = vec![0];
                for entry in entries {
                    parameters.extend([byte(entry.length)?, entry.id.raw(), byte(entry.address)?]);
                }
                (BULK_READ, parameters)
            }
            Self::Reboot { .. } => return lacks("reboot"),
            Self::SyncRead { .. } => return lacks("sync read"),
            Self::FastSyncRead { .. } => return lacks("fast sync read"),
            Self::BulkRead { .. } => return lacks("bulk read"),
            Self::FastBulkRead { .. } => return lacks("fast bulk read"),
            Self::BulkWrite { .. } => return lacks("bulk write"),
        })
    }

    fn parameters_2(&self) -> (u8, Vec<u8>) {
        let words =
            |numbers: &[u16]| numbers.iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<u8>>();
        let ranges = |entries: &[ReadEntry]| {
            let range = |entry: &ReadEntry| joined(&[entry.id.raw()], &words(&[entry.address, entry.length]));
            entries.iter().flat_map(range).collect::<Vec<u8>>()
        };
        match self {
            Self::Ping { .. } => (PING, Vec::new()),
            Self::Read { address, length, .. } => (READ, words(&[*address, *length])),
            Self::Write { address, data, .. } => (WRITE, joined(&words(&[*address]), data)),
            Self::RegWrite { address, data, .. } => (REG_WRITE, joined(&words(&[*address]), data)),
            Self::Action { .. } => (ACTION, Vec::new()),
            Self::FactoryReset { .. } => (FACTORY_RESET, vec![KEEP_ID_AND_BAUD_RATE]),
            Self::Reboot { .. } => (REBOOT, Vec::new()),
            Self::SyncRead { address, length, ids } => {
                (SYNC_READ, joined(&words(&[*address, *length]), &raw(ids)))
            }
            Self::FastSyncRead { address, length, ids } => {
                (FAST_SYNC_READ, joined(&words(&[*address, *length]), &raw(ids)))
            }
            Self::SyncWrite { address, length, entries } => {
                (SYNC_WRITE, joined(&words(&[*address, *length]), &sync_entries(entries)))
            }
            Self::BulkRead { entries } => (BULK_READ, ranges(entries)),
            Self::FastBulkRead { entries } => (FAST_BULK_READ, ranges(entries)),
            Self::BulkWrite { entries } => {
                let mut parameters = Vec::new();
                for entry in entries {
                    parameters.push(entry.id.raw());
                    // A longer one is refused with the whole packet.
                    let length = u16::try_from(entry.data.len()).unwrap_or(u16::MAX);
                    parameters.extend(words(&[entry.address, length]));
                    parameters.extend_from_slice(&entry.data);
                }
                (BULK_WRITE, parameters)
            }
        }
    }
}

enum Parsed {
    Instruction(Instruction),
    Misfit,
    Unknown,
}

impl From<Option<Instruction>> for Parsed {
    fn from(instruction: Option<Instruction>) -> Self {
        instruction.map_or(Self::Misfit, Self::Instruction)
    }
}

fn parse_1(protocol: Protocol, id: Id, code: u8, parameters: &[u8]) -> Parsed {
    let number = |byte: u8| u16::from(byte);
    let instruction = match (code, parameters) {
        (PING, []) => Instruction::Ping { id },
        (READ, &[address, length]) => {
            Instruction::Read { id, address: number(address), length: number(length) }
        }
        (WRITE, [address, data @ ..]) => {
            Instruction::Write { id, address: number(*address), data: data.to_vec() }
        }
        (REG_WRITE, [address, data @ ..]) => {
            Instruction::RegWrite { id, address: number(*address), data: data.to_vec() }
        }
        (ACTION, []) => Instruction::Action { id },
        (FACTORY_RESET, []) => Instruction::FactoryReset { id },
        (SYNC_WRITE, [address, length, bytes @ ..]) => {
            let (address, length) = (number(*address), number(*length));
            let entries = parse_sync_entries(length, bytes);
            return entries.map(|entries| Instruction::SyncWrite { address, length, entries }).into();
        }
        (SYNC_READ, [address, length, ids @ ..]) if protocol == Protocol::FeetechSts => {
            let (address, length) = (number(*address), number(*length));
            return parse_ids(ids).map(|ids| Instruction::SyncRead { address, length, ids }).into();
        }
        (BULK_READ, [0, bytes @ ..]) if protocol == Protocol::Dynamixel1 => {
            let entry = |entry: &[u8]| {
                let (length, address) = (number(entry[0]), number(entry[2]));
                Some(ReadEntry { id: Id::new(entry[1])?, address, length })
            };
            return chunks(bytes, 3, entry).map(|entries| Instruction::BulkRead { entries }).into();
        }
        (PING..=FACTORY_RESET | SYNC_WRITE, _) => return Parsed::Misfit,
        (BULK_READ, _) if protocol == Protocol::Dynamixel1 => return Parsed::Misfit,
        (SYNC_READ, _) if protocol == Protocol::FeetechSts => return Parsed::Misfit,
        _ => return Parsed::Unknown,
    };
    Parsed::Instruction(instruction)
}

fn parse_2(id: Id, code: u8, parameters: &[u8]) -> Parsed {
    let word = |low: u8, high: u8| u16::from_le_bytes([low, high]);
    let instruction = match (code, parameters) {
        (PING, []) => Instruction::Ping { id },
        (READ, &[a, b, c, d]) => Instruction::Read { id, address: word(a, b), length: word(c, d) },
        (WRITE, [a, b, data @ ..]) => Instruction::Write { id, address: word(*a, *b), data: data.to_vec() },
        (REG_WRITE, [a, b, data @ ..]) => {
            Instruction::RegWrite { id, address: word(*a, *b), data: data.to_vec() }
        }
        (ACTION, []) => Instruction::Action { id },
        (FACTORY_RESET, [_]) => Instruction::FactoryReset { id },
        (REBOOT, []) => Instruction::Reboot { id },
        (SYNC_READ | FAST_SYNC_READ, [a, b, c, d, ids @ ..]) => {
            let (address, length) = (word(*a, *b), word(*c, *d));
            return parse_ids(ids)
                .map(|ids| match code {
                    SYNC_READ => Instruction::SyncRead { address, length, ids },
                    _ => Instruction::FastSyncRead { address, length, ids },
                })
                .into();
        }
        (SYNC_WRITE, [a, b, c, d, bytes @ ..]) => {
            let (address, length) = (word(*a, *b), word(*c, *d));
            let entries = parse_sync_entries(length, bytes);
            return entries.map(|entries| Instruction::SyncWrite { address, length, entries }).into();
        }
        (BULK_READ | FAST_BULK_READ, bytes) => {
            let entry = |entry: &[u8]| {
                let (address, length) = (word(entry[1], entry[2]), word(entry[3], entry[4]));
                Some(ReadEntry { id: Id::new(entry[0])?, address, length })
            };
            return chunks(bytes, 5, entry)
                .map(|entries| match code {
                    BULK_READ => Instruction::BulkRead { entries },
                    _ => Instruction::FastBulkRead { entries },
                })
                .into();
        }
        (BULK_WRITE, bytes) => {
            return parse_bulk_write(bytes).map(|entries| Instruction::BulkWrite { entries }).into();
        }
        (PING..=FACTORY_RESET | REBOOT | SYNC_READ | FAST_SYNC_READ | SYNC_WRITE, _) => {
            return Parsed::Misfit;
        }
        _ => return Parsed::Unknown,
    };
    Parsed::Instruction(instruction)
}

fn parse_bulk_write(mut bytes: &[u8]) -> Option<Vec<WriteEntry>> {
    let mut entries = Vec::new();
    while let [id, a, b, c, d, rest @ ..] = bytes {
        let length = usize::from(u16::from_le_bytes([*c, *d]));
        let (data, rest) = rest.split_at_checked(length)?;
        let address = u16::from_le_bytes([*a, *b]);
        entries.push(WriteEntry { id: Id::new(*id)?, address, data: data.to_vec() });
        bytes = rest;
    }
    bytes.is_empty().then_some(entries)
}

fn parse_sync_entries(length: u16, bytes: &[u8]) -> Option<Vec<(Id, Vec<u8>)>> {
    chunks(bytes, usize::from(length) + 1, |entry| Some((Id::new(entry[0])?, entry[1..].to_vec())))
}

fn parse_ids(bytes: &[u8]) -> Option<Vec<Id>> {
    bytes.iter().map(|raw| Id::new(*raw)).collect()
}

/// Parses entries of `size` bytes each; `None` if one is invalid or incomplete.
fn chunks<T>(bytes: &[u8], size: usize, parse: impl Fn(&[u8]) -> Option<T>) -> Option<Vec<T>> {
    let entries = bytes.chunks_exact(size);
    if entries.remainder().is_empty() { entries.map(parse).collect() } else { None }
}

fn sync_entries(entries: &[(Id, Vec<u8>)]) -> Vec<u8> {
    entries.iter().flat_map(|(id, data)| joined(&[id.raw()], data)).collect()
}

fn raw(ids: &[Id]) -> Vec<u8> {
    ids.iter().map(|id| id.raw()).collect()
}

fn joined(front: &[u8], back: &[u8]) -> Vec<u8> {
    [front, back].concat()
}

#[cfg(test)]
#[path = "instruction_tests.rs"]
mod tests;
