//! The outputs of readers.

use bytes::Bytes;

use crate::wire::{Guid, InlineQos, SequenceNumber, Timestamp};

/// A received sample.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sample {
    pub writer: Guid,
    pub number: SequenceNumber,
    /// When the writer wrote it, by the clock of its host.
    pub source_timestamp: Option<Timestamp>,
    pub inline_qos: InlineQos,
    /// Whether the payload is only the key of an instance.
    pub is_key: bool,
    /// Includes the four bytes of the encapsulation header; empty if there is no payload.
    pub payload: Bytes,
}

/// An event of a reader.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Received {
    /// A sample. Samples of a reliable writer are in the order of their numbers; each gap is reported as
    /// lost.
    Sample(Sample),
    /// Samples of a writer that will not arrive.
    Lost { writer: Guid, count: u64 },
    /// No sample arrived for `count` further periods.
    DeadlineMissed { count: u64 },
    /// A writer with a lease was asserted for the first time or again, or was not asserted within its lease.
    LivelinessChanged { writer: Guid, is_alive: bool },
}
