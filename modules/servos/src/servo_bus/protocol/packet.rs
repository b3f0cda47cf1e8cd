//! The framing of packets.
//!
//! | protocol | packet |
//! | --- | --- |
//! | Dynamixel 1.0, Feetech | `FF FF`, id, length, code, parameters, checksum |
//! | Dynamixel 2.0 | `FF FF FD 00`, id, length (2 bytes), code, parameters, CRC (2 bytes) |
//!
//! The length counts everything after itself. The code is the instruction; in an answer it is the error byte,
//! or in Dynamixel 2.0 always 0x55, followed by the error byte.

use super::Protocol;
use std::borrow::Cow;
use std::fmt;

/// Id, length, code, checksum and the two bytes of the header.
const OVERHEAD_1: usize = 6;
/// Header, id, length, code and CRC.
const OVERHEAD_2: usize = 10;

/// The first bytes of every packet of Dynamixel 1.0 and Feetech.
pub(super) const HEADER_1: [u8; 2] = [0xFF, 0xFF];
/// The first bytes of every packet of Dynamixel 2.0.
pub(super) const HEADER_2: [u8; 4] = [0xFF, 0xFF, 0xFD, 0x00];
/// In the code and parameters of Dynamixel 2.0, a byte 0xFD is inserted after this.
const STUFFED: [u8; 3] = [0xFF, 0xFF, 0xFD];

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
    /// The bytes do not start with the header.
    #[error("a packet starts with FF FF, or FF FF FD 00 in Dynamixel 2.0; found {found:02X?}")]
    Header {
        /// The first two bytes.
        found: [u8; 2],
    },
    /// No device can have this id.
    #[error("no device can have the id {found:02X} of the packet")]
    Id {
        /// The id on the wire.
        found: u8,
    },
    /// The length is too small to hold a code and a checksum.
    #[error("the length of a packet is at least 2, or 3 in Dynamixel 2.0; found {found}")]
    Length {
        /// The length on the wire.
        found: u16,
    },
    /// The checksum does not fit the bytes.
    #[error("the checksum of the packet should be {expected:02X}, found {found:02X}")]
    Checksum {
        /// The computed checksum.
        expected: u16,
        /// The checksum in the packet.
        found: u16,
    },
}

/// A view of the bytes of one packet, checked on creation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet<'a> {
    protocol: Protocol,
    /// Exactly the packet.
    bytes: &'a [u8],
    id: Id,
}

impl<'a> Packet<'a> {
    /// Views bytes as a packet. Bytes after its end are ignored.
    ///
    /// # Errors
    /// Returns an error if the bytes do not start with a complete, valid packet.
    pub fn new_checked(protocol: Protocol, bytes: &'a [u8]) -> Result<Self, PacketError> {
        match protocol {
            Protocol::Dynamixel2 => Self::checked_2(bytes),
            _ => Self::checked_1(protocol, bytes),
        }
    }

    fn checked_1(protocol: Protocol, bytes: &'a [u8]) -> Result<Self, PacketError> {
        let truncated = |needed| PacketError::Truncated { needed, found: bytes.len() };
        let [first, second, raw_id, length, ..] = *bytes else { return Err(truncated(OVERHEAD_1)) };
        if [first, second] != HEADER_1 {
            return Err(PacketError::Header { found: [first, second] });
        }
        let id = Id::new(raw_id).ok_or(PacketError::Id { found: raw_id })?;
        if length < 2 {
            return Err(PacketError::Length { found: u16::from(length) });
        }
        let total = usize::from(length) + 4;
        let Some((&found, covered)) = bytes.get(2..total).and_then(<[u8]>::split_last) else {
            return Err(truncated(total));
        };
        let expected = checksum(covered);
        if expected != found {
            return Err(PacketError::Checksum { expected: u16::from(expected), found: u16::from(found) });
        }
        Ok(Self { protocol, bytes: &bytes[..total], id })
    }

    fn checked_2(bytes: &'a [u8]) -> Result<Self, PacketError> {
        let truncated = |needed| PacketError::Truncated { needed, found: bytes.len() };
        let [first, second, third, fourth, raw_id, low, high, ..] = *bytes else {
            return Err(truncated(OVERHEAD_2));
        };
        if [first, second, third, fourth] != HEADER_2 {
            return Err(PacketError::Header { found: [first, second] });
        }
        let id = Id::new(raw_id).filter(|id| id.raw() != 0xFD).ok_or(PacketError::Id { found: raw_id })?;
        let length = u16::from_le_bytes([low, high]);
        if length < 3 {
            return Err(PacketError::Length { found: length });
        }
        let total = usize::from(length) + 7;
        let Some((covered, crc)) = bytes.get(..total).and_then(<[u8]>::split_last_chunk) else {
            return Err(truncated(total));
        };
        let (expected, found) = (crc16(covered), u16::from_le_bytes(*crc));
        if expected != found {
            return Err(PacketError::Checksum { expected, found });
        }
        Ok(Self { protocol: Protocol::Dynamixel2, bytes: &bytes[..total], id })
    }

    /// The protocol.
    #[must_use]
    pub fn protocol(&self) -> Protocol {
        self.protocol
    }

    /// The device it goes to or comes from.
    #[must_use]
    pub fn id(&self) -> Id {
        self.id
    }

    /// The instruction; in an answer the error bits, or 0x55 in Dynamixel 2.0.
    #[must_use]
    pub fn code(&self) -> u8 {
        self.content()[0]
    }

    /// The bytes after the code, without the bytes that Dynamixel 2.0 inserts.
    #[must_use]
    pub fn parameters(&self) -> Cow<'a, [u8]> {
        match self.protocol {
            Protocol::Dynamixel2 => match unstuffed(self.content()) {
                Cow::Borrowed(content) => Cow::Borrowed(&content[1..]),
                Cow::Owned(content) => Cow::Owned(content[1..].to_vec()),
            },
            _ => Cow::Borrowed(&self.content()[1..]),
        }
    }

    /// Code and parameters as on the wire.
    fn content(&self) -> &'a [u8] {
        match self.protocol {
            Protocol::Dynamixel2 => &self.bytes[7..self.bytes.len() - 2],
            _ => &self.bytes[4..self.bytes.len() - 1],
        }
    }

    /// The whole packet, including header and checksum.
    #[must_use]
    pub fn as_bytes(&self) -> &'a [u8] {
        self.bytes
    }
}

/// The checksum of Dynamixel 1.0 and Feetech over id, length, code and parameters.
#[must_use]
pub fn checksum(covered: &[u8]) -> u8 {
    !covered.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte))
}

/// The CRC of Dynamixel 2.0 over everything before it: polynomial 0x8005, start 0 (CRC-16/BUYPASS).
#[must_use]
pub fn crc16(covered: &[u8]) -> u16 {
    const TABLE: [u16; 256] = {
        let mut table = [0; 256];
        let mut index = 0;
        while index < 256 {
            let mut crc = (index as u16) << 8;
            let mut bit = 0;
            while bit < 8 {
                crc = if crc & 0x8000 == 0 { crc << 1 } else { crc << 1 ^ 0x8005 };
                bit += 1;
            }
            table[index] = crc;
            index += 1;
        }
        table
    };
    covered.iter().fold(0, |crc: u16, byte| crc << 8 ^ TABLE[usize::from((crc >> 8) as u8 ^ byte)])
}

/// Why a packet cannot be built.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EmitError {
    /// There are more bytes than the length can represent.
    #[error("{count} bytes do not fit into one packet of {protocol}, at most {most} do")]
    TooLong {
        /// The protocol.
        protocol: Protocol,
        /// The number of bytes of code and parameters.
        count: usize,
        /// The largest possible number.
        most: usize,
    },
    /// An address or a length needs two bytes, but the protocol has one.
    #[error("{protocol} has addresses and lengths up to 255, not {number}")]
    Address {
        /// The protocol.
        protocol: Protocol,
        /// The address or length.
        number: u16,
    },
    /// The protocol has no such instruction.
    #[error("{protocol} has no {instruction}")]
    Instruction {
        /// The protocol.
        protocol: Protocol,
        /// The name of the instruction.
        instruction: &'static str,
    },
}

/// Appends a packet with this code and these parameters to `out`.
pub(super) fn emit_packet(
    protocol: Protocol,
    id: Id,
    code: u8,
    parameters: &[u8],
    out: &mut Vec<u8>,
) -> Result<(), EmitError> {
    let start = out.len();
    let count = parameters.len() + 1;
    if protocol == Protocol::Dynamixel2 {
        let content = [&[code], parameters].concat();
        let content = stuffed(&content);
        let most = usize::from(u16::MAX) - 2;
        let too_long = EmitError::TooLong { protocol, count, most };
        let length = u16::try_from(content.len() + 2).map_err(|_| too_long)?;
        out.extend_from_slice(&HEADER_2);
        out.push(id.raw());
        out.extend_from_slice(&length.to_le_bytes());
        out.extend_from_slice(&content);
        let crc = crc16(&out[start..]);
        out.extend_from_slice(&crc.to_le_bytes());
    } else {
        let too_long = EmitError::TooLong { protocol, count, most: 254 };
        let length = u8::try_from(count + 1).map_err(|_| too_long)?;
        out.extend_from_slice(&HEADER_1);
        out.extend_from_slice(&[id.raw(), length, code]);
        out.extend_from_slice(parameters);
        out.push(checksum(&out[start + 2..]));
    }
    Ok(())
}

fn stuffed(content: &[u8]) -> Cow<'_, [u8]> {
    if !content.windows(3).any(|bytes| bytes == STUFFED) {
        return Cow::Borrowed(content);
    }
    let mut out = Vec::with_capacity(content.len() + 1);
    for byte in content {
        out.push(*byte);
        if out.ends_with(&STUFFED) {
            out.push(0xFD);
        }
    }
    Cow::Owned(out)
}

fn unstuffed(content: &[u8]) -> Cow<'_, [u8]> {
    if !content.windows(3).any(|bytes| bytes == STUFFED) {
        return Cow::Borrowed(content);
    }
    let mut out = Vec::with_capacity(content.len());
    let mut bytes = content.iter().peekable();
    while let Some(byte) = bytes.next() {
        out.push(*byte);
        if out.ends_with(&STUFFED) {
            bytes.next_if_eq(&&0xFD);
        }
    }
    Cow::Owned(out)
}

/// The address of a device on the bus, or of all of them.
///
/// 0xFF is not an address: it would be mistaken for a header byte.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Id(u8);

impl Id {
    /// All devices. They execute the instruction and do not answer, except to reads of several devices.
    pub const BROADCAST: Self = Self(254);
    /// The sub controller of a Darwin OP, which sits between the computer and the servo bus.
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
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    const TEMPERATURE: [u8; 7] = [0xFF, 0xFF, 0x01, 0x03, 0x00, 0x20, 0xDB];

    fn one(bytes: &[u8]) -> Result<Packet<'_>, PacketError> {
        Packet::new_checked(Protocol::Dynamixel1, bytes)
    }

    #[test]
    fn a_valid_packet_is_parsed() {
        let packet = one(&TEMPERATURE).map(|p| (p.id().raw(), p.code(), p.parameters().to_vec()));
        assert_eq!(packet, Ok((1, 0, vec![0x20])));
    }

    #[test]
    fn bytes_after_the_packet_are_ignored() {
        let mut bytes = TEMPERATURE.to_vec();
        bytes.extend_from_slice(&[1, 2, 3]);
        assert_eq!(one(&bytes).map(|p| p.as_bytes().to_vec()), Ok(TEMPERATURE.to_vec()));
    }

    #[test]
    fn invalid_bytes_are_reported_with_the_reason() {
        assert_eq!(one(&TEMPERATURE[..5]), Err(PacketError::Truncated { needed: 7, found: 5 }));
        let with = |index: usize, value| {
            let mut bytes = TEMPERATURE;
            bytes[index] = value;
            one(&bytes).map(|_| ())
        };
        assert_eq!(with(1, 0x7F), Err(PacketError::Header { found: [0xFF, 0x7F] }));
        assert_eq!(with(2, 0xFF), Err(PacketError::Id { found: 0xFF }));
        assert_eq!(with(3, 1), Err(PacketError::Length { found: 1 }));
        assert_eq!(with(5, 0x21), Err(PacketError::Checksum { expected: 0xDA, found: 0xDB }));
    }

    #[test]
    fn the_crc_matches_the_manual() {
        let ping = [0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x03, 0x00, 0x01, 0x19, 0x4E];
        assert_eq!(crc16(&ping[..8]), 0x4E19);
        assert!(Packet::new_checked(Protocol::Dynamixel2, &ping).is_ok());
    }

    #[test]
    fn a_header_in_the_parameters_is_stuffed() {
        let mut bytes = Vec::new();
        let parameters = [1, 0xFF, 0xFF, 0xFD, 0xFD, 2];
        emit_packet(Protocol::Dynamixel2, Id(3), 3, &parameters, &mut bytes).unwrap();
        assert_eq!(bytes[5..7], [10, 0], "one byte more than without");
        assert_eq!(bytes[8..15], [1, 0xFF, 0xFF, 0xFD, 0xFD, 0xFD, 2]);
        let packet = Packet::new_checked(Protocol::Dynamixel2, &bytes).unwrap();
        assert_eq!(*packet.parameters(), parameters);
    }

    #[test]
    fn more_bytes_than_the_length_can_hold_are_refused() {
        let mut out = Vec::new();
        let error = emit_packet(Protocol::Dynamixel1, Id(1), 3, &[0; 254], &mut out).unwrap_err();
        assert_eq!(
            error.to_string(),
            "255 bytes do not fit into one packet of Dynamixel 1.0, at most 254 do"
        );
        assert!(emit_packet(Protocol::Dynamixel2, Id(1), 3, &vec![0; 65_533], &mut out).is_err());
    }

    proptest! {
        #[test]
        fn parameters_survive_stuffing(
            parameters in proptest::collection::vec(prop_oneof![Just(0xFF_u8), Just(0xFD), any::<u8>()], 0..200),
        ) {
            let mut bytes = Vec::new();
            emit_packet(Protocol::Dynamixel2, Id(9), 0x55, &parameters, &mut bytes).unwrap();
            prop_assert!(!bytes[4..].windows(4).any(|four| four == HEADER_2), "no header inside");
            let packet = Packet::new_checked(Protocol::Dynamixel2, &bytes).unwrap();
            prop_assert_eq!(&*packet.parameters(), &parameters[..]);
        }

        #[test]
        fn checking_any_bytes_never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            for protocol in Protocol::ALL {
                let _ = Packet::new_checked(protocol, &bytes).map(|packet| packet.parameters().len());
                let with_header = [&HEADER_2[..], &bytes].concat();
                let _ = Packet::new_checked(protocol, &with_header).map(|packet| packet.parameters().len());
            }
        }
    }
}
