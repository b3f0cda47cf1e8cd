//! Builds messages, the inverse of [`parse`](super::parse).

use super::bytes::Encoder;
use super::message::{flag, id};
use super::{
    AckNack, ByteOrder, Data, DataFragment, EntityId, Gap, GuidPrefix, Header, Heartbeat, HeartbeatFragment,
    InlineQos, NackFragment, Payload, SequenceNumber, Timestamp,
};

/// Fills one datagram with submessages, in little-endian order.
///
/// Each method that appends a submessage returns `false` if it does not fit. The message is unchanged then,
/// and remains valid.
pub struct MessageBuilder<'a> {
    out: &'a mut Vec<u8>,
    start: usize,
    max_len: usize,
    /// Bytes by which each submessage will grow.
    growth: usize,
    /// Added to the numbers of samples.
    offset: i64,
    order: ByteOrder,
    destination: Announced<GuidPrefix>,
    timestamp: Announced<Option<Timestamp>>,
}

/// A property that applies to all following submessages.
#[derive(Clone, Copy)]
struct Announced<T> {
    /// The value that the message states so far.
    written: T,
    /// The value that applies to the next submessage.
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
            growth: 0,
            offset: 0,
            order: ByteOrder::Little,
            destination: Announced::new(GuidPrefix::UNKNOWN),
            timestamp: Announced::new(None),
        }
    }

    /// Returns whether there is no submessage yet.
    pub fn is_empty(&self) -> bool {
        self.len() == Header::LEN
    }

    /// Bytes of the message.
    pub fn len(&self) -> usize {
        self.out.len() - self.start
    }

    /// Bytes left for the next submessage, including its header.
    pub fn remaining(&self) -> usize {
        let destination = if self.destination.is_news() { SUBMESSAGE_HEADER_LEN + 12 } else { 0 };
        let timestamp = match self.timestamp.wanted {
            _ if !self.timestamp.is_news() => 0,
            Some(_) => SUBMESSAGE_HEADER_LEN + 8,
            None => SUBMESSAGE_HEADER_LEN,
        };
        self.max_len.saturating_sub(self.len() + destination + timestamp + self.growth)
    }

    /// Leaves room in the message for each submessage to grow by `growth` bytes.
    pub(crate) fn reserve(&mut self, growth: usize) {
        self.growth = growth;
    }

    /// Sets what is added to the numbers of samples in the following submessages of writers.
    pub(crate) fn shift_numbers(&mut self, offset: i64) {
        self.offset = offset;
    }

    fn shifted(&self, number: SequenceNumber) -> SequenceNumber {
        SequenceNumber(number.0.saturating_add(self.offset))
    }

    /// Sets the destination of the following submessages. Initially it is [`GuidPrefix::UNKNOWN`], which
    /// means all participants. An INFO_DST is written in front of the next submessage, if the destination
    /// differs by then.
    pub fn info_destination(&mut self, prefix: GuidPrefix) {
        self.destination.wanted = prefix;
    }

    /// Sets the source timestamp of the following data. An INFO_TS is written in front of the next
    /// submessage, if the timestamp differs by then.
    pub fn info_timestamp(&mut self, timestamp: Option<Timestamp>) {
        self.timestamp.wanted = timestamp;
    }

    /// Appends a sample. Its payload is padded to a multiple of four bytes, see [`Payload`].
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
        let number = self.shifted(data.number);
        self.submessage(id::DATA, payload_flag | flag_of(&data.inline_qos), |out| {
            write_data_ends(out, DATA_OFFSET, data.reader, data.writer);
            number.write(out);
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
        let number = self.shifted(fragment.number);
        self.submessage(id::DATA_FRAGMENT, key_flag | flag_of(&fragment.inline_qos), |out| {
            write_data_ends(out, DATA_FRAGMENT_OFFSET, fragment.reader, fragment.writer);
            number.write(out);
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
        let (first, last) = (self.shifted(heartbeat.first), self.shifted(heartbeat.last));
        self.submessage(id::HEARTBEAT, is_final | is_liveliness, |out| {
            write_ends(out, heartbeat.reader, heartbeat.writer);
            first.write(out);
            last.write(out);
            out.u32(heartbeat.count);
        })
    }

    /// Appends a gap.
    #[must_use]
    pub fn gap(&mut self, gap: &Gap) -> bool {
        let (start, base) = (self.shifted(gap.start), self.shifted(gap.list.base()));
        self.submessage(id::GAP, 0, |out| {
            write_ends(out, gap.reader, gap.writer);
            start.write(out);
            base.write(out);
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
        let number = self.shifted(heartbeat.number);
        self.submessage(id::HEARTBEAT_FRAGMENT, 0, |out| {
            write_ends(out, heartbeat.reader, heartbeat.writer);
            number.write(out);
            out.u32(heartbeat.last);
            out.u32(heartbeat.count);
        })
    }

    /// Appends a submessage, preceded by its destination and timestamp if these have changed; or nothing.
    fn submessage(&mut self, id: u8, flags: u8, body: impl FnOnce(&mut Encoder<'_>)) -> bool {
        let before = self.out.len();
        let is_complete = self.write_news() && self.write_submessage(id, flags, body);
        if is_complete && self.len() + self.growth <= self.max_len {
            self.max_len -= self.growth;
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

    /// Returns `false` if the length of the body exceeds the 16 bits in its header.
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

/// Value of `octetsToInlineQos` (section 9.4.5.3.3): bytes between that field and the inline QoS.
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::super::{
        FragmentSet, Guid, SampleIdentity, SequenceNumber, SequenceNumberSet, Submessage, parse,
    };
    use super::*;

    const READER: EntityId = EntityId::user_reader(2);
    const WRITER: EntityId = EntityId::user_writer(1);
    const HEADER: Header = Header::ours(GuidPrefix([1, 0x44, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]));
    const NUMBER: SequenceNumber = SequenceNumber((7 << 32) + 9);

    fn data(payload: Payload<'_>) -> Data<'_> {
        Data { reader: READER, writer: WRITER, number: NUMBER, inline_qos: InlineQos::default(), payload }
    }

    fn with_inline_qos<'a>(payload: Payload<'a>) -> Data<'a> {
        let identity = SampleIdentity { writer: Guid::new(HEADER.prefix, READER), number: NUMBER };
        let inline_qos = InlineQos {
            related_sample_identity: Some(identity),
            ..InlineQos::removal(Guid::new(HEADER.prefix, WRITER))
        };
        Data { inline_qos, ..data(payload) }
    }

    fn heartbeat(count: u32) -> Heartbeat {
        let (first, last) = (NUMBER.previous(), NUMBER);
        Heartbeat { reader: READER, writer: WRITER, first, last, count, is_final: true, is_liveliness: false }
    }

    /// One submessage of each kind that can be written.
    fn all(payload: &[u8]) -> Vec<Submessage<'_>> {
        let mut missing = SequenceNumberSet::new(NUMBER);
        assert!(missing.insert(SequenceNumber(NUMBER.0 + 255)));
        let mut fragments = FragmentSet::new(3);
        assert!(fragments.insert(4));
        let fragment = DataFragment {
            reader: READER,
            writer: WRITER,
            number: NUMBER,
            first: 2,
            count: 2,
            fragment_size: 5,
            sample_size: 14,
            inline_qos: InlineQos::default(),
            payload: &payload[..9],
            is_key: false,
        };
        let key = with_inline_qos(Payload::Key(payload));
        vec![
            Submessage::Data(data(Payload::Data(payload))),
            Submessage::Data(data(Payload::None)),
            Submessage::Data(key),
            Submessage::Data(Data { payload: Payload::None, ..key }),
            Submessage::DataFragment(fragment),
            Submessage::DataFragment(DataFragment { inline_qos: key.inline_qos, is_key: true, ..fragment }),
            Submessage::AckNack(AckNack {
                reader: READER,
                writer: WRITER,
                missing,
                count: 4,
                is_final: true,
            }),
            Submessage::Heartbeat(heartbeat(5)),
            Submessage::Heartbeat(Heartbeat { is_final: false, is_liveliness: true, ..heartbeat(6) }),
            Submessage::Gap(Gap { reader: READER, writer: WRITER, start: NUMBER.previous(), list: missing }),
            Submessage::NackFragment(NackFragment {
                reader: READER,
                writer: WRITER,
                number: NUMBER,
                missing: fragments,
                count: 7,
            }),
            Submessage::HeartbeatFragment(HeartbeatFragment {
                reader: READER,
                writer: WRITER,
                number: NUMBER,
                last: 8,
                count: 9,
            }),
        ]
    }

    fn add(message: &mut MessageBuilder<'_>, submessage: &Submessage<'_>) -> bool {
        match submessage {
            Submessage::Data(data) => message.data(data),
            Submessage::DataFragment(fragment) => message.data_fragment(fragment),
            Submessage::AckNack(ack_nack) => message.ack_nack(ack_nack),
            Submessage::Heartbeat(heartbeat) => message.heartbeat(heartbeat),
            Submessage::Gap(gap) => message.gap(gap),
            Submessage::NackFragment(nack) => message.nack_fragment(nack),
            Submessage::HeartbeatFragment(heartbeat) => message.heartbeat_fragment(heartbeat),
            other => panic!("{other:?} cannot be written"),
        }
    }

    fn read(bytes: &[u8]) -> Vec<Submessage<'_>> {
        let (header, submessages) = parse(bytes).unwrap();
        assert_eq!(header, HEADER);
        submessages.collect::<Result<_, _>>().unwrap()
    }

    #[test]
    fn messages_round_trip_in_both_byte_orders() {
        let payload = [0, 1, 0, 0, 1, 2, 3, 4, 5, 6, 7];
        for order in [ByteOrder::Big, ByteOrder::Little] {
            for length in 9..=payload.len() {
                let written = all(&payload[..length]);
                let mut bytes = Vec::new();
                let mut message = MessageBuilder::new(&mut bytes, 1472, HEADER);
                message.order = order;
                assert!(written.iter().all(|submessage| add(&mut message, submessage)));
                // The length of the padding is in the encapsulation options, which our reader ignores.
                let read = read(&bytes).into_iter().map(|submessage| match submessage {
                    Submessage::Data(data) => {
                        Submessage::Data(Data { payload: without_options(data.payload), ..data })
                    }
                    other => other,
                });
                assert_eq!(read.collect::<Vec<_>>(), written);
                assert_eq!(bytes.len() % 4, 0);
            }
        }
    }

    fn without_options(payload: Payload<'_>) -> Payload<'_> {
        let clear = |payload: &[u8]| {
            let mut payload = payload.to_vec();
            payload[3] &= !3;
            &*payload.leak()
        };
        match payload {
            Payload::None => Payload::None,
            Payload::Data(payload) => Payload::Data(clear(payload)),
            Payload::Key(payload) => Payload::Key(clear(payload)),
        }
    }

    #[test]
    fn a_submessage_that_does_not_fit_leaves_the_message_unchanged() {
        let payload = [0, 1, 0, 0, 1, 2, 3, 4, 5, 6, 7];
        for submessage in all(&payload) {
            let mut enough = Vec::new();
            let mut message = MessageBuilder::new(&mut enough, 1472, HEADER);
            message.info_destination(GuidPrefix([9; 12]));
            message.info_timestamp(Some(Timestamp::from_nanos(1)));
            let before = message.remaining();
            assert!(add(&mut message, &submessage));
            let needed = message.len();
            assert_eq!(before - message.remaining(), needed - Header::LEN - 16 - 12);

            for max_len in Header::LEN..needed {
                let mut bytes = vec![0xaa];
                let mut message = MessageBuilder::new(&mut bytes, max_len, HEADER);
                message.info_destination(GuidPrefix([9; 12]));
                message.info_timestamp(Some(Timestamp::from_nanos(1)));
                assert!(!add(&mut message, &submessage));
                assert!(message.is_empty());
                assert_eq!(bytes.len(), 1 + Header::LEN);
            }
            let mut exact = Vec::new();
            let mut message = MessageBuilder::new(&mut exact, needed, HEADER);
            message.info_destination(GuidPrefix([9; 12]));
            message.info_timestamp(Some(Timestamp::from_nanos(1)));
            assert!(add(&mut message, &submessage));
            assert_eq!((message.remaining(), message.is_empty()), (0, false));
            assert_eq!(exact, enough);
        }
    }

    #[test]
    fn constants_and_lengths_predict_what_fits() {
        let payload = vec![0; 1001];
        let data = with_inline_qos(Payload::Data(&payload));
        let needed = MessageBuilder::DATA_OVERHEAD + data.inline_qos.encoded_len() + 1004;
        for (max_len, fits) in [(Header::LEN + needed, true), (Header::LEN + needed - 1, false)] {
            let mut bytes = Vec::new();
            assert_eq!(MessageBuilder::new(&mut bytes, max_len, HEADER).data(&data), fits);
        }
        let Submessage::DataFragment(fragment) = all(&payload)[4] else { panic!("no fragment") };
        let mut bytes = Vec::new();
        let mut message = MessageBuilder::new(&mut bytes, 1472, HEADER);
        assert!(message.data_fragment(&fragment));
        assert_eq!(message.len(), Header::LEN + MessageBuilder::DATA_FRAGMENT_OVERHEAD + 12);
    }

    #[test]
    fn a_payload_that_exceeds_its_length_field_does_not_fit() {
        let payload = vec![0; 65_536];
        let mut bytes = Vec::new();
        let mut message = MessageBuilder::new(&mut bytes, 1 << 20, HEADER);
        assert!(!message.data(&data(Payload::Data(&payload))));
        assert!(message.is_empty());
        assert!(message.data(&data(Payload::Data(&payload[..65_512]))));
    }

    #[test]
    fn destination_and_time_are_written_once_and_only_before_data() {
        let time = Timestamp::from_nanos(1_500_000_000);
        let (a, b) = (GuidPrefix([0xa; 12]), GuidPrefix([0xb; 12]));
        let mut bytes = Vec::new();
        let mut message = MessageBuilder::new(&mut bytes, 1472, HEADER);
        message.info_destination(b);
        message.info_destination(a);
        assert!(message.heartbeat(&heartbeat(1)));
        message.info_destination(a);
        message.info_timestamp(Some(time));
        assert!(message.data(&data(Payload::None)));
        assert!(message.data(&data(Payload::None)));
        message.info_timestamp(None);
        message.info_destination(GuidPrefix::UNKNOWN);
        assert!(message.data(&data(Payload::None)));
        message.info_destination(b);
        let data = Submessage::Data(data(Payload::None));
        let expected = [
            Submessage::InfoDestination(a),
            Submessage::Heartbeat(heartbeat(1)),
            Submessage::InfoTimestamp(Some(time)),
            data,
            data,
            Submessage::InfoDestination(GuidPrefix::UNKNOWN),
            Submessage::InfoTimestamp(None),
            data,
        ];
        assert_eq!(read(&bytes), expected);
    }
}
