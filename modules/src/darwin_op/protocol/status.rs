//! Answers from the devices.

use super::{Id, Packet, emit_packet};
use std::fmt;
use std::ops::{BitOr, BitOrAssign};

/// The error bits of an answer.
#[derive(Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct StatusError(u8);

impl StatusError {
    /// No error.
    pub const NONE: Self = Self(0);
    /// The supply voltage is outside its limits.
    pub const INPUT_VOLTAGE: Self = Self(1);
    /// The goal position is outside the angle limits.
    pub const ANGLE_LIMIT: Self = Self(1 << 1);
    /// The temperature is above its limit.
    pub const OVERHEATING: Self = Self(1 << 2);
    /// A value or an address is out of range.
    pub const RANGE: Self = Self(1 << 3);
    /// The instruction had a wrong checksum.
    pub const CHECKSUM: Self = Self(1 << 4);
    /// The permitted torque cannot hold the load.
    pub const OVERLOAD: Self = Self(1 << 5);
    /// The instruction does not exist, or ACTION without REG_WRITE.
    pub const INSTRUCTION: Self = Self(1 << 6);

    const NAMES: [(Self, &str); 7] = [
        (Self::INPUT_VOLTAGE, "input voltage"),
        (Self::ANGLE_LIMIT, "angle limit"),
        (Self::OVERHEATING, "overheating"),
        (Self::RANGE, "range"),
        (Self::CHECKSUM, "checksum"),
        (Self::OVERLOAD, "overload"),
        (Self::INSTRUCTION, "instruction"),
    ];

    /// The bits as on the wire. The eighth has no meaning.
    #[must_use]
    pub const fn from_bits(bits: u8) -> Self {
        Self(bits)
    }

    /// The bits as on the wire.
    #[must_use]
    pub const fn bits(self) -> u8 {
        self.0
    }

    /// Returns whether no bit is set.
    #[must_use]
    pub const fn is_none(self) -> bool {
        self.0 == 0
    }

    /// Returns whether all bits of `other` are set.
    #[must_use]
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

impl BitOr for StatusError {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl BitOrAssign for StatusError {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

impl fmt::Display for StatusError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut separator = "";
        for (bit, name) in Self::NAMES {
            if self.contains(bit) {
                write!(formatter, "{separator}{name}")?;
                separator = ", ";
            }
        }
        if separator.is_empty() { formatter.write_str("none") } else { Ok(()) }
    }
}

impl fmt::Debug for StatusError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "StatusError({self})")
    }
}

/// An answer, with bytes borrowed from the packet or the sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status<'a> {
    /// The device that answers.
    pub id: Id,
    /// Its error bits.
    pub error: StatusError,
    /// The requested data.
    pub parameters: &'a [u8],
}

/// Why a valid packet is not an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("an answer cannot come from id 254, the broadcast address")]
pub struct StatusParseError;

impl<'a> Status<'a> {
    /// Parses a packet from a device.
    ///
    /// # Errors
    /// Returns an error if its id is the broadcast address.
    pub fn parse<T: AsRef<[u8]>>(packet: &'a Packet<T>) -> Result<Self, StatusParseError> {
        if packet.id().is_broadcast() {
            return Err(StatusParseError);
        }
        let error = StatusError::from_bits(packet.code());
        Ok(Self { id: packet.id(), error, parameters: packet.parameters() })
    }

    /// Appends the packet to `out`.
    ///
    /// # Panics
    /// Panics if there are more than 253 bytes of parameters.
    pub fn emit(&self, out: &mut Vec<u8>) {
        emit_packet(self.id, self.error.bits(), self.parameters, out);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn error_bits_match_the_manual() {
        let packet = Packet::new_checked([0xFF, 0xFF, 0x01, 0x02, 0x24, 0xD8]).unwrap();
        let status = Status::parse(&packet).unwrap();
        assert_eq!(status.error, StatusError::OVERLOAD | StatusError::OVERHEATING);
        assert_eq!(status.error.to_string(), "overheating, overload");
    }

    #[test]
    fn an_answer_from_the_broadcast_address_is_refused() {
        let packet = Packet::new_checked([0xFF, 0xFF, 0xFE, 0x02, 0x00, 0xFF]).unwrap();
        assert_eq!(Status::parse(&packet), Err(StatusParseError));
    }

    proptest! {
        #[test]
        fn answers_survive_a_round_trip(
            id in 0..=253_u8, bits: u8, parameters in proptest::collection::vec(any::<u8>(), 0..=253),
        ) {
            let error = StatusError::from_bits(bits);
            let status = Status { id: Id::new(id).unwrap(), error, parameters: &parameters };
            let mut bytes = Vec::new();
            status.emit(&mut bytes);
            let packet = Packet::new_checked(&bytes).unwrap();
            prop_assert_eq!(Status::parse(&packet), Ok(status));
        }
    }
}
