//! The common framing of instructions and answers.
//!
//! `FF FF | id | length | code | parameters | checksum`, where length counts everything after itself, and
//! code is the instruction or, in an answer, the error bits.

use std::fmt;

/// The first two bytes of every packet.
pub const HEADER: [u8; 2] = [0xFF, 0xFF];

/// Header, id, length, code and checksum.
const OVERHEAD: usize = 6;

/// Why bytes are not a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    /// The bytes end before the packet does.
    #[error("the packet is truncated: it needs {needed} bytes, found {found}")]
    Truncated {
        /// The required number of bytes, as far as known.
        needed: usize,
        /// The available number of bytes.
        found: usize,
    },
    /// The bytes do not start with FF FF.
    #[error("a packet starts with FF FF, found {found:02X?}")]
    Header {
        /// The first two bytes.
        found: [u8; 2],
    },
    /// The id is 0xFF, which no device has.
    #[error("the id of the packet is FF, which no device can have")]
    Id,
    /// The length is too small to hold a code and a checksum.
    #[error("the length of a packet is at least 2, found {found}")]
    Length {
        /// The length on the wire.
        found: u8,
    },
    /// The checksum does not fit the bytes.
    #[error("the checksum of the packet should be {expected:02X}, found {found:02X}")]
    Checksum {
        /// The computed checksum.
        expected: u8,
        /// The checksum in the packet.
        found: u8,
    },
}

/// A view of the bytes of one packet, checked on creation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet<T: AsRef<[u8]>> {
    buffer: T,
    id: Id,
}

impl<T: AsRef<[u8]>> Packet<T> {
    /// Views bytes as a packet. Bytes after its end are ignored.
    ///
    /// # Errors
    /// Returns an error if the bytes do not start with a complete, valid packet.
    pub fn new_checked(buffer: T) -> Result<Self, PacketError> {
        let bytes = buffer.as_ref();
        let truncated = |needed| PacketError::Truncated { needed, found: bytes.len() };
        let [first, second, raw_id, length, ..] = *bytes else { return Err(truncated(OVERHEAD)) };
        if [first, second] != HEADER {
            return Err(PacketError::Header { found: [first, second] });
        }
        let id = Id::new(raw_id).ok_or(PacketError::Id)?;
        if length < 2 {
            return Err(PacketError::Length { found: length });
        }
        let total = usize::from(length) + 4;
        let Some((&found, covered)) = bytes.get(2..total).and_then(<[u8]>::split_last) else {
            return Err(truncated(total));
        };
        let expected = checksum(covered);
        if expected != found {
            return Err(PacketError::Checksum { expected, found });
        }
        Ok(Self { buffer, id })
    }

    /// The device it goes to or comes from.
    #[must_use]
    pub fn id(&self) -> Id {
        self.id
    }

    /// The instruction, or the error bits of an answer.
    #[must_use]
    pub fn code(&self) -> u8 {
        self.buffer.as_ref()[4]
    }

    /// The bytes after the code.
    #[must_use]
    pub fn parameters(&self) -> &[u8] {
        let bytes = self.as_bytes();
        &bytes[5..bytes.len() - 1]
    }

    /// The whole packet, including header and checksum.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        let bytes = self.buffer.as_ref();
        &bytes[..usize::from(bytes[3]) + 4]
    }
}

/// The checksum over id, length, code and parameters.
#[must_use]
pub fn checksum(covered: &[u8]) -> u8 {
    !covered.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte))
}

/// Appends a packet to `out`.
///
/// # Panics
/// Panics if there are more than 253 bytes of parameters, which the length byte cannot represent.
pub fn emit_packet(id: Id, code: u8, parameters: &[u8], out: &mut Vec<u8>) {
    let length = u8::try_from(parameters.len() + 2).unwrap_or_else(|_| {
        panic!("a packet holds at most 253 bytes of parameters, not {}", parameters.len())
    });
    let start = out.len();
    out.reserve(OVERHEAD + parameters.len());
    out.extend_from_slice(&HEADER);
    out.extend_from_slice(&[id.raw(), length, code]);
    out.extend_from_slice(parameters);
    out.push(checksum(&out[start + 2..]));
}

/// The address of a device on the bus, or of all of them.
///
/// 0xFF is not an address: it would be mistaken for a header byte.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Id(u8);

impl Id {
    /// All devices. They execute the instruction and do not answer, except to a bulk read.
    pub const BROADCAST: Self = Self(254);
    /// The sub controller, which sits between the computer and the servo bus.
    pub const CM730: Self = Self(200);

    /// The address with this number, unless it is 0xFF.
    #[must_use]
    pub const fn new(raw: u8) -> Option<Self> {
        if raw == 0xFF { None } else { Some(Self(raw)) }
    }

    /// The number on the wire.
    #[must_use]
    pub const fn raw(self) -> u8 {
        self.0
    }

    /// Returns whether it stands for all devices.
    #[must_use]
    pub const fn is_broadcast(self) -> bool {
        self.0 == Self::BROADCAST.0
    }
}

impl fmt::Debug for Id {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Id({})", self.0)
    }
}

impl fmt::Display for Id {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(formatter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEMPERATURE: [u8; 7] = [0xFF, 0xFF, 0x01, 0x03, 0x00, 0x20, 0xDB];

    #[test]
    fn a_valid_packet_is_parsed() {
        let packet =
            Packet::new_checked(TEMPERATURE).map(|p| (p.id().raw(), p.code(), p.parameters().to_vec()));
        assert_eq!(packet, Ok((1, 0, vec![0x20])));
    }

    #[test]
    fn bytes_after_the_packet_are_ignored() {
        let mut bytes = TEMPERATURE.to_vec();
        bytes.extend_from_slice(&[1, 2, 3]);
        assert_eq!(Packet::new_checked(&bytes).map(|p| p.as_bytes().to_vec()), Ok(TEMPERATURE.to_vec()));
    }

    #[test]
    fn invalid_bytes_are_reported_with_the_reason() {
        assert_eq!(
            Packet::new_checked(&TEMPERATURE[..5]),
            Err(PacketError::Truncated { needed: 7, found: 5 })
        );
        let with = |index: usize, value| {
            let mut bytes = TEMPERATURE;
            bytes[index] = value;
            Packet::new_checked(bytes)
        };
        assert_eq!(with(1, 0x7F), Err(PacketError::Header { found: [0xFF, 0x7F] }));
        assert_eq!(with(2, 0xFF), Err(PacketError::Id));
        assert_eq!(with(3, 1), Err(PacketError::Length { found: 1 }));
        assert_eq!(with(5, 0x21), Err(PacketError::Checksum { expected: 0xDA, found: 0xDB }));
    }
}
