//! Dynamixel protocol 1.0: the packets on the servo bus of the Darwin OP.
//!
//! Three layers, none of which does input or output:
//!
//! - [`Packet`]: a checked view of the bytes of one packet, the framing that both directions share;
//! - [`Instruction`] and [`Status`]: the meaning of a packet, with `parse` and `emit`;
//! - [`Receiver`]: finds packets in a fragmented stream of bytes that may contain garbage.
//!
//! ```
//! use downbeat_modules::darwin_op::protocol::{Id, Instruction, Packet, Status};
//!
//! let ping = Instruction::Ping { id: Id::CM730 }.to_bytes();
//! assert_eq!(ping, [0xFF, 0xFF, 0xC8, 0x02, 0x01, 0x34]);
//!
//! let answer = [0xFF, 0xFF, 0x01, 0x03, 0x00, 0x20, 0xDB];
//! let packet = Packet::new_checked(&answer[..])?;
//! assert_eq!(Status::parse(&packet)?.parameters, [0x20]); // 32 degrees Celsius
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Not supported: protocol 2.0, and the MX series' own instruction 0x82 (undocumented for the MX-28).
//!
//! # References
//! ROBOTIS e-Manual, "DYNAMIXEL Protocol 1.0".

mod instruction;
mod packet;
mod receiver;
mod status;

pub use instruction::{BulkReadBlock, BulkReadEntry, SyncWriteBlock};
pub use instruction::{Instruction, InstructionError};
pub use packet::Id;
pub use packet::{HEADER, Packet, PacketError, checksum, emit_packet};
pub use receiver::Receiver;
pub use status::{Status, StatusError, StatusParseError};
