//! Writing of messages.

use super::bytes::Encoder;
use super::message::{flag, id};
use super::{
    AckNack, ByteOrder, Data, DataFragment, EntityId, Gap, GuidPrefix, Header, Heartbeat, HeartbeatFragment,
    InlineQos, NackFragment, Payload, Timestamp,
};

/// Fills one datagram with submessages, in little-endian order.
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

/// Something that holds for the submessages after it.
#[derive(Clone, Copy)]
struct Announced<T> {
    /// What the message says so far.
    written: T,
    /// What must hold for the next submessage.
    wanted: T,
}

impl<T: Copy + PartialEq> Announced<T> {
    fn new(initial: T) -> Self {
        Self { written: initial, wanted: initial }
    }

    fn is_news(&self) -> bool {
        self.written != self.wanted
    }
}

/// Bytes in front of the body of a submessage.
const SUBMESSAGE_HEADER_LEN: usize = 4;

impl<'a> MessageBuilder<'a> {
    /// Bytes of a DATA with neither payload nor inline QoS.
    pub const DATA_OVERHEAD: usize = SUBMESSAGE_HEADER_LEN + 4 + DATA_OFFSET as usize;
    /// Bytes of a DATA_FRAG with neither payload nor inline QoS.
    pub const DATA_FRAGMENT_OVERHEAD: usize = SUBMESSAGE_HEADER_LEN + 4 + DATA_FRAGMENT_OFFSET as usize;

    /// Begins a message of at most `max_len` bytes at the end of `out`.
    pub fn new(out: &'a mut Vec<u8>, max_len: usize, header: Header) -> Self {
        let start = out.len();
        out.extend_from_slice(b"RTPS");
        header.write(out);
        Self {
            out,
            start,
            max_len,
            order: ByteOrder::Little,
            destination: Announced::new(GuidPrefix::UNKNOWN),
            timestamp: Announced::new(None),
        }
    }

    /// Whether there is no submessage yet.
    pub fn is_empty(&self) -> bool {
        self.len() == Header::LEN
    }

    /// Bytes of the message.
    pub fn len(&self) -> usize {
        self.out.len() - self.start
    }

    /// Bytes left for the next submessage, with its own header.
    pub fn remaining(&self) -> usize {
        let destination = if self.destination.is_news() { SUBMESSAGE_HEADER_LEN + 12 } else { 0 };
        let timestamp = match self.timestamp.wanted {
            _ if !self.timestamp.is_news() => 0,
            Some(_) => SUBMESSAGE_HEADER_LEN + 8,
            None => SUBMESSAGE_HEADER_LEN,
        };
        self.max_len.saturating_sub(self.len() + destination + timestamp)
    }

    /// Says for whom the following submessages are; [`GuidPrefix::UNKNOWN`], as at the beginning, is everybody. Written
    /// together with the next submessage, if it is news by then.
    pub fn info_destination(&mut self, prefix: GuidPrefix) {
        self.destination.wanted = prefix;
    }

    /// Says when the following data were written. Written together with the next submessage, if it is news by then.
    pub fn info_timestamp(&mut self, timestamp: Option<Timestamp>) {
        self.timestamp.wanted = timestamp;
    }

    /// Appends a sample. On the wire its payload is a multiple of four bytes, see [`Payload`].
    #[must_use]
    pub fn data(&mut self, data: &Data<'_>) -> bool {
        let (payload_flag, payload) = match data.payload {
            Payload::None => (0, &[][..]),
            Payload::Data(payload) => (flag::DATA, payload),
            Payload::Key(payload) => (flag::KEY, payload),
        };
        let padded = payload.len().next_multiple_of(4);
        if self.remaining() < Self::DATA_OVERHEAD + data.inline_qos.encoded_len() + padded {
            return false;
        }
        self.submessage(id::DATA, payload_flag | flag_of(&data.inline_qos), |out| {
            write_data_ends(out, DATA_OFFSET, data.reader, data.writer);
            data.number.write(out);
            data.inline_qos.write(out);
            match *payload {
                [0, format, options_high, options_low, ref content @ ..] => {
                    let padding = (padded - payload.len()) as u8;
                    out.bytes(&[0, format, options_high, options_low & !3 | padding]);
                    out.bytes(content);
                }
                _ => out.bytes(payload),
            }
        })
    }

    /// Appends fragments of a sample.
    #[must_use]
    pub fn data_fragment(&mut self, fragment: &DataFragment<'_>) -> bool {
        let padded = fragment.payload.len().next_multiple_of(4);
        if self.remaining() < Self::DATA_FRAGMENT_OVERHEAD + fragment.inline_qos.encoded_len() + padded {
            return false;
        }
        let key_flag = if fragment.is_key { flag::FRAGMENT_OF_KEY } else { 0 };
        self.submessage(id::DATA_FRAGMENT, key_flag | flag_of(&fragment.inline_qos), |out| {
            write_data_ends(out, DATA_FRAGMENT_OFFSET, fragment.reader, fragment.writer);
            fragment.number.write(out);
            out.u32(fragment.first);
            out.u16(fragment.count);
            out.u16(fragment.fragment_size);
            out.u32(fragment.sample_size);
            fragment.inline_qos.write(out);
            out.bytes(fragment.payload);
        })
    }

    /// Appends an acknowledgement.
    #[must_use]
    pub fn ack_nack(&mut self, ack_nack: &AckNack) -> bool {
        let flags = if ack_nack.is_final { flag::FINAL } else { 0 };
        self.submessage(id::ACK_NACK, flags, |out| {
            write_ends(out, ack_nack.reader, ack_nack.writer);
            ack_nack.missing.base().write(out);
            ack_nack.missing.write_bits(out);
            out.u32(ack_nack.count);
        })
    }

    /// Appends a heartbeat.
    #[must_use]
    pub fn heartbeat(&mut self, heartbeat: &Heartbeat) -> bool {
        let is_final = if heartbeat.is_final { flag::FINAL } else { 0 };
        let is_liveliness = if heartbeat.is_liveliness { flag::LIVELINESS } else { 0 };
        self.submessage(id::HEARTBEAT, is_final | is_liveliness, |out| {
            write_ends(out, heartbeat.reader, heartbeat.writer);
            heartbeat.first.write(out);
            heartbeat.last.write(out);
            out.u32(heartbeat.count);
        })
    }

    /// Appends a gap.
    #[must_use]
    pub fn gap(&mut self, gap: &Gap) -> bool {
        self.submessage(id::GAP, 0, |out| {
            write_ends(out, gap.reader, gap.writer);
            gap.start.write(out);
            gap.list.base().write(out);
            gap.list.write_bits(out);
        })
    }

    /// Appends a request for fragments.
    #[must_use]
    pub fn nack_fragment(&mut self, nack: &NackFragment) -> bool {
        self.submessage(id::NACK_FRAGMENT, 0, |out| {
            write_ends(out, nack.reader, nack.writer);
            nack.number.write(out);
            out.u32(nack.missing.base());
            nack.missing.write_bits(out);
            out.u32(nack.count);
        })
    }

    /// Appends a heartbeat of fragments.
    #[must_use]
    pub fn heartbeat_fragment(&mut self, heartbeat: &HeartbeatFragment) -> bool {
        self.submessage(id::HEARTBEAT_FRAGMENT, 0, |out| {
            write_ends(out, heartbeat.reader, heartbeat.writer);
            heartbeat.number.write(out);
            out.u32(heartbeat.last);
            out.u32(heartbeat.count);
        })
    }

    /// Appends what is news and a submessage, or nothing.
    fn submessage(&mut self, id: u8, flags: u8, body: impl FnOnce(&mut Encoder<'_>)) -> bool {
        let before = self.out.len();
        let is_complete = self.write_news() && self.write_submessage(id, flags, body);
        if is_complete && self.len() <= self.max_len {
            self.destination.written = self.destination.wanted;
            self.timestamp.written = self.timestamp.wanted;
            true
        } else {
            self.out.truncate(before);
            false
        }
    }

    fn write_news(&mut self) -> bool {
        let (destination, timestamp) = (self.destination, self.timestamp);
        let destination_fits = !destination.is_news()
            || self.write_submessage(id::INFO_DESTINATION, 0, |out| out.bytes(&destination.wanted.0));
        let timestamp_fits = !timestamp.is_news()
            || match timestamp.wanted {
                Some(time) => self.write_submessage(id::INFO_TIMESTAMP, 0, |out| time.write(out)),
                None => self.write_submessage(id::INFO_TIMESTAMP, flag::INVALIDATE, |_| {}),
            };
        destination_fits && timestamp_fits
    }

    /// `false` if the body is longer than its header can say.
    fn write_submessage(&mut self, id: u8, flags: u8, body: impl FnOnce(&mut Encoder<'_>)) -> bool {
        let order_flag = match self.order {
            ByteOrder::Big => 0,
            ByteOrder::Little => flag::LITTLE_ENDIAN,
        };
        let mut out = Encoder::new(self.out, self.order);
        out.bytes(&[id, flags | order_flag]);
        out.u16(0);
        let start = out.len();
        body(&mut out);
        out.align(start);
        let Ok(length) = u16::try_from(out.len() - start) else { return false };
        out.set_u16(start - 2, length);
        true
    }
}

impl Header {
    fn write(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.version);
        out.extend_from_slice(&self.vendor.0);
        out.extend_from_slice(&self.prefix.0);
    }
}

/// Bytes from behind the offset of the inline QoS to the inline QoS.
const DATA_OFFSET: u16 = 16;
const DATA_FRAGMENT_OFFSET: u16 = 28;

fn write_data_ends(out: &mut Encoder<'_>, offset: u16, reader: EntityId, writer: EntityId) {
    out.u16(0); // extra flags
    out.u16(offset);
    write_ends(out, reader, writer);
}

fn write_ends(out: &mut Encoder<'_>, reader: EntityId, writer: EntityId) {
    out.bytes(&reader.0);
    out.bytes(&writer.0);
}

fn flag_of(inline_qos: &InlineQos) -> u8 {
    if inline_qos.is_empty() { 0 } else { flag::INLINE_QOS }
}
