//! Instructions from the computer to the devices.

use super::{Id, Packet, emit_packet};

const PING: u8 = 0x01;
const READ: u8 = 0x02;
const WRITE: u8 = 0x03;
const REG_WRITE: u8 = 0x04;
const ACTION: u8 = 0x05;
const FACTORY_RESET: u8 = 0x06;
const SYNC_WRITE: u8 = 0x83;
const BULK_READ: u8 = 0x92;

/// An instruction, with bytes borrowed from the packet or the sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instruction<'a> {
    /// Requests an answer without data.
    Ping {
        /// The device.
        id: Id,
    },
    /// Reads from the control table.
    Read {
        /// The device.
        id: Id,
        /// First address.
        address: u8,
        /// The number of bytes.
        length: u8,
    },
    /// Writes to the control table.
    Write {
        /// The device.
        id: Id,
        /// First address.
        address: u8,
        /// The bytes.
        data: &'a [u8],
    },
    /// Registers a write that is executed by ACTION.
    RegWrite {
        /// The device.
        id: Id,
        /// First address.
        address: u8,
        /// The bytes.
        data: &'a [u8],
    },
    /// Executes a registered write.
    Action {
        /// The device.
        id: Id,
    },
    /// Resets all settings, including the id.
    FactoryReset {
        /// The device.
        id: Id,
    },
    /// Writes to the control tables of several devices at once. Sent to all devices, without answers.
    SyncWrite {
        /// First address, the same for all devices.
        address: u8,
        /// The devices and their bytes.
        block: SyncWriteBlock<'a>,
    },
    /// Reads from several devices, which answer one after another.
    BulkRead {
        /// The devices and the requested ranges.
        block: BulkReadBlock<'a>,
    },
}

/// Why a valid packet is not an instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InstructionError {
    /// No instruction has this code.
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

impl<'a> Instruction<'a> {
    /// Parses a packet sent to the devices.
    ///
    /// # Errors
    /// Returns an error if no instruction has this code, or its parameters do not fit.
    pub fn parse<T: AsRef<[u8]>>(packet: &'a Packet<T>) -> Result<Self, InstructionError> {
        let (id, code, parameters) = (packet.id(), packet.code(), packet.parameters());
        let misfit = InstructionError::Parameters { code, count: parameters.len() };
        let to_all = || {
            if id.is_broadcast() { Ok(()) } else { Err(InstructionError::NotBroadcast { code, id }) }
        };
        match (code, parameters) {
            (PING, []) => Ok(Self::Ping { id }),
            (READ, &[address, length]) => Ok(Self::Read { id, address, length }),
            (WRITE, [address, data @ ..]) => Ok(Self::Write { id, address: *address, data }),
            (REG_WRITE, [address, data @ ..]) => Ok(Self::RegWrite { id, address: *address, data }),
            (ACTION, []) => Ok(Self::Action { id }),
            (FACTORY_RESET, []) => Ok(Self::FactoryReset { id }),
            (SYNC_WRITE, [address, data_length, bytes @ ..]) => {
                to_all()?;
                let block = SyncWriteBlock::new(*data_length, bytes).ok_or(misfit)?;
                Ok(Self::SyncWrite { address: *address, block })
            }
            (BULK_READ, [0, bytes @ ..]) => {
                to_all()?;
                Ok(Self::BulkRead { block: BulkReadBlock::new(bytes).ok_or(misfit)? })
            }
            (PING..=FACTORY_RESET | SYNC_WRITE | BULK_READ, _) => Err(misfit),
            _ => Err(InstructionError::Unknown { code }),
        }
    }

    /// Appends the packet to `out`.
    ///
    /// # Panics
    /// Panics if there are more bytes than a packet can hold: 252 to write, 251 in a SYNC_WRITE, 252 in a
    /// BULK_READ.
    pub fn emit(&self, out: &mut Vec<u8>) {
        let id = self.id();
        match *self {
            Self::Ping { .. } => emit_packet(id, PING, &[], out),
            Self::Read { address, length, .. } => emit_packet(id, READ, &[address, length], out),
            Self::Write { address, data, .. } => emit_packet(id, WRITE, &joined(&[address], data), out),
            Self::RegWrite { address, data, .. } => {
                emit_packet(id, REG_WRITE, &joined(&[address], data), out)
            }
            Self::Action { .. } => emit_packet(id, ACTION, &[], out),
            Self::FactoryReset { .. } => emit_packet(id, FACTORY_RESET, &[], out),
            Self::SyncWrite { address, block } => {
                emit_packet(id, SYNC_WRITE, &joined(&[address, block.data_length()], block.as_bytes()), out);
            }
            Self::BulkRead { block } => emit_packet(id, BULK_READ, &joined(&[0], block.as_bytes()), out),
        }
    }

    /// The packet as a separate buffer.
    ///
    /// # Panics
    /// See [`emit`](Self::emit).
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::new();
        self.emit(&mut out);
        out
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
            | Self::FactoryReset { id } => id,
            Self::SyncWrite { .. } | Self::BulkRead { .. } => Id::BROADCAST,
        }
    }
}

fn joined(front: &[u8], back: &[u8]) -> Vec<u8> {
    [front, back].concat()
}

#[cfg(test)]
#[path = "instruction_tests.rs"]
mod tests;

/// The data of SYNC_WRITE: for each device its id and the same number of bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SyncWriteBlock<'a> {
    data_length: u8,
    bytes: &'a [u8],
}

impl<'a> SyncWriteBlock<'a> {
    /// Creates a block from the bytes on the wire: `id, data_length bytes` for each device.
    ///
    /// `None` if the bytes are not a whole number of entries, or an id is 0xFF.
    #[must_use]
    pub fn new(data_length: u8, bytes: &'a [u8]) -> Option<Self> {
        let mut entries = bytes.chunks_exact(usize::from(data_length) + 1);
        let sound = entries.all(|entry| Id::new(entry[0]).is_some()) && entries.remainder().is_empty();
        sound.then_some(Self { data_length, bytes })
    }

    /// The number of bytes for each device.
    #[must_use]
    pub fn data_length(&self) -> u8 {
        self.data_length
    }

    /// The bytes on the wire.
    #[must_use]
    pub fn as_bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Each device and its bytes.
    pub fn entries(&self) -> impl Iterator<Item = (Id, &'a [u8])> + use<'a> {
        let chunks = self.bytes.chunks_exact(usize::from(self.data_length) + 1);
        chunks.filter_map(|entry| Some((Id::new(entry[0])?, &entry[1..])))
    }
}

/// One entry of a BULK_READ: what to read from whom.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BulkReadEntry {
    /// The number of bytes.
    pub length: u8,
    /// The device.
    pub id: Id,
    /// The address in its control table.
    pub address: u8,
}

impl BulkReadEntry {
    /// The bytes on the wire.
    #[must_use]
    pub fn to_bytes(self) -> [u8; 3] {
        [self.length, self.id.raw(), self.address]
    }
}

/// The data of BULK_READ: what each device answers, in the order of the answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BulkReadBlock<'a> {
    bytes: &'a [u8],
}

impl<'a> BulkReadBlock<'a> {
    /// Creates a block from the bytes on the wire: `length, id, address` for each device.
    ///
    /// `None` if the bytes are not a whole number of entries, or an id is 0xFF.
    #[must_use]
    pub fn new(bytes: &'a [u8]) -> Option<Self> {
        let mut entries = bytes.chunks_exact(3);
        let sound = entries.all(|entry| Id::new(entry[1]).is_some()) && entries.remainder().is_empty();
        sound.then_some(Self { bytes })
    }

    /// The bytes on the wire.
    #[must_use]
    pub fn as_bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// The entries, in the order in which the devices answer.
    pub fn entries(&self) -> impl Iterator<Item = BulkReadEntry> + use<'a> {
        self.bytes.chunks_exact(3).filter_map(|entry| {
            Some(BulkReadEntry { length: entry[0], id: Id::new(entry[1])?, address: entry[2] })
        })
    }
}
