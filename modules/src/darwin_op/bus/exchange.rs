//! One exchange on the bus, as a value that can be recorded.

use super::super::protocol::Id;
use downbeat_executor::Time;

/// What was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExchangeKind {
    /// The port was opened.
    Open,
    /// An instruction was sent, and its answers were awaited.
    Transfer,
    /// The port was closed.
    Close,
}

/// How it ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All that was expected came, whole and sound.
    Ok,
    /// The port works, but at least one answer did not come, or came corrupt.
    Timeout,
    /// The port does not work: it cannot be opened, was unplugged or closed.
    Failed,
}

/// A status packet that is to come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExpectedStatus {
    /// From whom.
    pub id: Id,
    /// With how many bytes of parameters.
    pub parameters: u8,
}

impl ExpectedStatus {
    /// How long the packet is, header and checksum included.
    #[must_use]
    pub const fn packet_length(&self) -> usize {
        self.parameters as usize + 6
    }
}

/// One exchange on the bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Exchange {
    /// Counts all exchanges of this bus, from 0.
    pub sequence: u64,
    /// What was done.
    pub kind: ExchangeKind,
    /// When the instruction was sent.
    pub sent: Time,
    /// From sending to the last byte, or to giving up, in microseconds.
    pub duration_us: u32,
    /// The instruction packet; empty unless it is a transfer.
    pub instruction: Vec<u8>,
    /// All bytes that came, as they came.
    pub reply: Vec<u8>,
    /// How it ended.
    pub outcome: Outcome,
    /// What went wrong, for people; empty if all went well.
    pub error: String,
}

/// Why a recorded message is no exchange.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ExchangeMessageError {
    /// The kind is none of those defined.
    #[error("exchange {sequence} of the recording is of kind {found}, which does not exist")]
    Kind {
        /// Which exchange.
        sequence: u64,
        /// The kind it has.
        found: u8,
    },
    /// The outcome is none of those defined.
    #[error("exchange {sequence} of the recording ended in outcome {found}, which does not exist")]
    Outcome {
        /// Which exchange.
        sequence: u64,
        /// The outcome it has.
        found: u8,
    },
}
