//! What readers hand out.

use bytes::Bytes;

use crate::wire::{Guid, InlineQos, SequenceNumber, Timestamp};

/// A sample that was received.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sample {
    pub writer: Guid,
    pub number: SequenceNumber,
    /// When the writer wrote it, by the clock of its host.
    pub source_timestamp: Option<Timestamp>,
    pub inline_qos: InlineQos,
    /// Whether the payload is only the key of an instance.
    pub is_key: bool,
    /// With the four bytes of its encapsulation; empty if there is none.
    pub payload: Bytes,
}

/// What happened at a reader, in its order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Received {
    /// A sample. Samples of a reliable writer come in the order of their numbers; each gap is reported as lost.
    Sample(Sample),
    /// Samples of a writer that will not come any more.
    Lost { writer: Guid, count: u64 },
    /// Nothing came for so many further periods.
    DeadlineMissed { count: u64 },
    /// A writer with a lease is heard for the first time, was silent for its lease, or is heard again.
    LivelinessChanged { writer: Guid, is_alive: bool },
}
