//! The protocols of serial servos: Dynamixel 1.0 and 2.0, Feetech STS and SCS.
//!
//! Three layers, none of which does input or output:
//!
//! - [`Packet`]: a checked view of the bytes of one packet, the framing that both directions share;
//! - [`Instruction`] and [`Status`]: the meaning of a packet, common to all protocols, with `parse` and
//!   `emit`;
//! - [`Receiver`]: finds packets in a fragmented stream of bytes that may contain garbage.
//!
//! ```
//! use downbeat_servos::servo_bus::protocol::{Id, Instruction, Packet, Protocol, Status};
//!
//! let ping = Instruction::Ping { id: Id::CM730 };
//! assert_eq!(ping.to_bytes(Protocol::Dynamixel1)?, [0xFF, 0xFF, 0xC8, 0x02, 0x01, 0x34]);
//!
//! let answer = [0xFF, 0xFF, 0x01, 0x03, 0x00, 0x20, 0xDB];
//! let packet = Packet::new_checked(Protocol::Dynamixel1, &answer)?;
//! assert_eq!(Status::parse(&packet)?.parameters, [0x20]); // 32 degrees Celsius
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Not supported: the instructions Clear, Control Table Backup and Fast Sync Write of Dynamixel 2.0, and the
//! MX series' own instruction 0x82 in Dynamixel 1.0 (undocumented for the MX-28).
//!
//! # References
//! ROBOTIS e-Manual, "DYNAMIXEL Protocol 1.0" and "Protocol 2.0". Feetech: huggingface/lerobot,
//! `src/lerobot/motors/feetech`, and its `tests/mocks/mock_feetech.py`.

mod instruction;
mod packet;
mod receiver;
mod status;

pub use instruction::{Instruction, InstructionError, ReadEntry, WriteEntry, echo_end};
pub use packet::{EmitError, Id, Packet, PacketError, checksum, crc16};
pub use receiver::Receiver;
pub(crate) use status::emit_joined;
pub use status::{Status, StatusError, StatusParseError, joined_parameters, split_joined};

use std::fmt;
use std::str::FromStr;

/// A protocol of serial servos.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Protocol {
    /// Dynamixel 1.0: AX, and MX by default.
    Dynamixel1,
    /// Dynamixel 2.0: X, P, and MX on request.
    Dynamixel2,
    /// Feetech STS and SMS: numbers have the low byte first.
    FeetechSts,
    /// Feetech SCS: numbers have the high byte first, and there is no sync read.
    FeetechScs,
}

/// A name that is not a protocol.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "unknown protocol \"{found}\"; there are \"dynamixel1\", \"dynamixel2\", \"feetech_sts\" and \"feetech_scs\""
)]
pub struct UnknownProtocol {
    found: String,
}

impl Protocol {
    /// All protocols.
    pub const ALL: [Self; 4] = [Self::Dynamixel1, Self::Dynamixel2, Self::FeetechSts, Self::FeetechScs];

    /// The name in files and on the command line.
    #[must_use]
    pub fn key(self) -> &'static str {
        match self {
            Self::Dynamixel1 => "dynamixel1",
            Self::Dynamixel2 => "dynamixel2",
            Self::FeetechSts => "feetech_sts",
            Self::FeetechScs => "feetech_scs",
        }
    }

    /// The length of a status packet with this number of parameters, without bytes inserted by Dynamixel 2.0.
    #[must_use]
    pub const fn status_length(self, parameters: u16) -> usize {
        match self {
            Self::Dynamixel2 => parameters as usize + 11,
            _ => parameters as usize + 6,
        }
    }

    /// Returns whether numbers of more than one byte have the high byte first.
    #[must_use]
    pub const fn is_big_endian(self) -> bool {
        matches!(self, Self::FeetechScs)
    }
}

impl fmt::Display for Protocol {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Dynamixel1 => "Dynamixel 1.0",
            Self::Dynamixel2 => "Dynamixel 2.0",
            Self::FeetechSts => "Feetech STS",
            Self::FeetechScs => "Feetech SCS",
        })
    }
}

impl FromStr for Protocol {
    type Err = UnknownProtocol;

    fn from_str(text: &str) -> Result<Self, UnknownProtocol> {
        let found = || UnknownProtocol { found: text.to_owned() };
        Self::ALL.into_iter().find(|protocol| protocol.key() == text).ok_or_else(found)
    }
}
