//! Writing of messages.

use super::{
    AckNack, ByteOrder, Data, DataFragment, Gap, GuidPrefix, Header, Heartbeat, HeartbeatFragment,
    NackFragment, Timestamp,
};

/// Fills one datagram with submessages.
///
/// Each method that adds a submessage returns `false` if it does not fit: then nothing is written, and what was written
/// before remains a valid message.
pub struct MessageBuilder<'a> {
    out: &'a mut Vec<u8>,
    start: usize,
    max_len: usize,
    order: ByteOrder,
    destination: Announced<GuidPrefix>,
    timestamp: Announced<Option<Timestamp>>,
}

/// What the message says so far, and what holds for the next submessage.
struct Announced<T> {
    written: T,
    wanted: T,
}

impl<'a> MessageBuilder<'a> {
    /// Bytes of a DATA with neither payload nor inline QoS.
    pub const DATA_OVERHEAD: usize = 24;
    /// Bytes of a DATA_FRAG with neither payload nor inline QoS.
    pub const DATA_FRAGMENT_OVERHEAD: usize = 36;

    /// Begins a message of at most `max_len` bytes at the end of `out`.
    pub fn new(out: &'a mut Vec<u8>, max_len: usize, header: Header) -> Self {
        todo!()
    }

    /// Whether there is no submessage yet.
    pub fn is_empty(&self) -> bool {
        self.len() == Header::LEN
    }

    /// Bytes of the message.
    pub fn len(&self) -> usize {
        self.out.len() - self.start
    }

    /// Bytes left for the next submessage, with its own header of four.
    pub fn remaining(&self) -> usize {
        todo!()
    }

    /// Says for whom the following submessages are; [`GuidPrefix::UNKNOWN`], as at the beginning, is everybody. Written
    /// together with the next submessage, if it is news by then.
    pub fn info_destination(&mut self, prefix: GuidPrefix) {
        self.destination.wanted = prefix;
    }

    /// Says when the following data were written. Written together with the next data, if it is news by then.
    pub fn info_timestamp(&mut self, timestamp: Option<Timestamp>) {
        self.timestamp.wanted = timestamp;
    }

    /// Appends a sample. Its length is made a multiple of four.
    #[must_use]
    pub fn data(&mut self, data: &Data<'_>) -> bool {
        todo!()
    }

    /// Appends fragments of a sample.
    #[must_use]
    pub fn data_fragment(&mut self, fragment: &DataFragment<'_>) -> bool {
        todo!()
    }

    /// Appends an acknowledgement.
    #[must_use]
    pub fn ack_nack(&mut self, ack_nack: &AckNack) -> bool {
        todo!()
    }

    /// Appends a heartbeat.
    #[must_use]
    pub fn heartbeat(&mut self, heartbeat: &Heartbeat) -> bool {
        todo!()
    }

    /// Appends a gap.
    #[must_use]
    pub fn gap(&mut self, gap: &Gap) -> bool {
        todo!()
    }

    /// Appends a request for fragments.
    #[must_use]
    pub fn nack_fragment(&mut self, nack: &NackFragment) -> bool {
        todo!()
    }

    /// Appends a heartbeat of fragments.
    #[must_use]
    pub fn heartbeat_fragment(&mut self, heartbeat: &HeartbeatFragment) -> bool {
        todo!()
    }
}
