//! Messages and their submessages (sections 9.4.4 and 9.4.5).

use super::bytes::Cursor;
use super::parameters::ParameterList;
use super::{
    ByteOrder, EntityId, FragmentSet, GuidPrefix, InlineQos, Malformed, SequenceNumber, SequenceNumberSet,
    Timestamp, VendorId,
};

/// Kinds of submessages (section 9.4.5.1.1).
pub(super) mod id {
    pub(in crate::wire) const PAD: u8 = 0x01;
    pub(in crate::wire) const ACK_NACK: u8 = 0x06;
    pub(in crate::wire) const HEARTBEAT: u8 = 0x07;
    pub(in crate::wire) const GAP: u8 = 0x08;
    pub(in crate::wire) const INFO_TIMESTAMP: u8 = 0x09;
    pub(in crate::wire) const INFO_SOURCE: u8 = 0x0c;
    pub(in crate::wire) const INFO_REPLY_IP4: u8 = 0x0d;
    pub(in crate::wire) const INFO_DESTINATION: u8 = 0x0e;
    pub(in crate::wire) const INFO_REPLY: u8 = 0x0f;
    pub(in crate::wire) const NACK_FRAGMENT: u8 = 0x12;
    pub(in crate::wire) const HEARTBEAT_FRAGMENT: u8 = 0x13;
    pub(in crate::wire) const DATA: u8 = 0x15;
    pub(in crate::wire) const DATA_FRAGMENT: u8 = 0x16;
    /// From SEC_BODY to SRTPS_POSTFIX (DDS Security 1.1, section 7.3.7.2).
    pub(super) const SECURITY: std::ops::RangeInclusive<u8> = 0x30..=0x34;
}

/// Flags of submessages. Their meaning depends on the kind (section 9.4.5).
pub(super) mod flag {
    /// In all kinds.
    pub(in crate::wire) const LITTLE_ENDIAN: u8 = 0x01;
    /// In DATA and DATA_FRAG.
    pub(in crate::wire) const INLINE_QOS: u8 = 0x02;
    /// In DATA.
    pub(in crate::wire) const DATA: u8 = 0x04;
    /// In DATA.
    pub(in crate::wire) const KEY: u8 = 0x08;
    /// In DATA_FRAG.
    pub(in crate::wire) const FRAGMENT_OF_KEY: u8 = 0x04;
    /// In ACKNACK and HEARTBEAT.
    pub(in crate::wire) const FINAL: u8 = 0x02;
    /// In HEARTBEAT.
    pub(in crate::wire) const LIVELINESS: u8 = 0x04;
    /// In INFO_TS: there is no timestamp.
    pub(in crate::wire) const INVALIDATE: u8 = 0x02;
}

/// The header of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Header {
    /// Major and minor.
    pub version: [u8; 2],
    pub vendor: VendorId,
    /// The participant that sent the message.
    pub prefix: GuidPrefix,
}

impl Header {
    /// Bytes on the wire.
    pub const LEN: usize = 20;

    /// The header of our own messages.
    pub const fn ours(prefix: GuidPrefix) -> Self {
        Self { version: [2, 3], vendor: VendorId::OURS, prefix }
    }
}

/// One part of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Submessage<'a> {
    /// Source timestamp of the data that follow; `None` cancels an earlier one.
    InfoTimestamp(Option<Timestamp>),
    /// Destination of the submessages that follow; [`GuidPrefix::UNKNOWN`] is every participant.
    InfoDestination(GuidPrefix),
    /// Source of the submessages that follow.
    InfoSource(Header),
    /// Locators for answers. Its content is ignored, since answers go to announced locators only.
    InfoReply,
    Data(Data<'a>),
    DataFragment(DataFragment<'a>),
    AckNack(AckNack),
    Heartbeat(Heartbeat),
    Gap(Gap),
    NackFragment(NackFragment),
    HeartbeatFragment(HeartbeatFragment),
    /// Padding.
    Pad,
    /// Part of DDS Security: ids 0x30 to 0x34.
    Security {
        id: u8,
        body: &'a [u8],
    },
    /// Of a later version of the specification, or specific to a vendor.
    Unknown {
        id: u8,
    },
}

/// A sample, or the end of an instance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Data<'a> {
    /// [`EntityId::UNKNOWN`] is every matched reader.
    pub reader: EntityId,
    pub writer: EntityId,
    pub number: SequenceNumber,
    pub inline_qos: InlineQos,
    pub payload: Payload<'a>,
}

/// The content of a sample, with the four bytes of its encapsulation in front.
///
/// On the wire a payload is padded to a multiple of four bytes. The last two bits of the encapsulation hold the length of the
/// padding (DDS-XTypes 1.3, section 7.6.3.1.2), which is removed on reception. Fast DDS does not set these bits, so up to
/// three bytes of padding may remain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Payload<'a> {
    /// No payload; the inline QoS is the content.
    None,
    /// A sample.
    Data(&'a [u8]),
    /// Only the key of an instance.
    Key(&'a [u8]),
}

/// Consecutive fragments of a sample. They lie within the sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DataFragment<'a> {
    /// [`EntityId::UNKNOWN`] is every matched reader.
    pub reader: EntityId,
    pub writer: EntityId,
    pub number: SequenceNumber,
    /// Number of the first of these fragments. The first fragment of the sample is 1.
    pub first: u32,
    /// How many fragments these are, at least 1.
    pub count: u16,
    /// Bytes of each fragment except the last of the sample, at least 1.
    pub fragment_size: u16,
    /// Bytes of the sample including its encapsulation, at least 4.
    pub sample_size: u32,
    /// Cyclone DDS sends it with the first fragment only.
    pub inline_qos: InlineQos,
    /// The bytes of the fragments, of exactly the length that the fields above imply.
    pub payload: &'a [u8],
    /// Whether the sample is only the key of an instance.
    pub is_key: bool,
}

impl DataFragment<'_> {
    /// Offset of the payload in the sample.
    pub fn offset(&self) -> u32 {
        // Checked when parsed: the range is within the sample, whose size is 32 bits.
        (self.first - 1) * u32::from(self.fragment_size)
    }
}

/// The samples that a reader has received and those it is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AckNack {
    pub reader: EntityId,
    pub writer: EntityId,
    /// All samples below the base are received. An empty set with base 0 requests a first [`Heartbeat`]; Fast DDS sends it.
    pub missing: SequenceNumberSet,
    /// Increases with each one from this reader to this writer.
    pub count: u32,
    /// Whether no answer is required.
    pub is_final: bool,
}

/// The samples that a writer has available.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// [`EntityId::UNKNOWN`] is every matched reader.
    pub reader: EntityId,
    pub writer: EntityId,
    /// The oldest available sample.
    pub first: SequenceNumber,
    /// The newest sample written; `first - 1` if none is available.
    pub last: SequenceNumber,
    /// Increases with each one of this writer.
    pub count: u32,
    /// Whether no answer is required.
    pub is_final: bool,
    /// Whether the application asserts the liveliness of the writer with it.
    pub is_liveliness: bool,
}

/// Samples that are no longer available: those from `start` to before the base of the list, and those in the list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// [`EntityId::UNKNOWN`] is every matched reader.
    pub reader: EntityId,
    pub writer: EntityId,
    /// At most the base of the list.
    pub start: SequenceNumber,
    pub list: SequenceNumberSet,
}

/// Fragments of one sample that a reader is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NackFragment {
    pub reader: EntityId,
    pub writer: EntityId,
    pub number: SequenceNumber,
    /// Its base is at least 1.
    pub missing: FragmentSet,
    /// Increases with each one from this reader to this writer.
    pub count: u32,
}

/// Fragments of one sample that a writer has available.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeartbeatFragment {
    /// [`EntityId::UNKNOWN`] is every matched reader.
    pub reader: EntityId,
    pub writer: EntityId,
    pub number: SequenceNumber,
    /// The last available fragment, at least 1. All before it are available too.
    pub last: u32,
    /// Increases with each one of this writer.
    pub count: u32,
}

/// Reads the header of a message and returns an iterator over its submessages.
///
/// # Errors
/// If the header is not one of RTPS 2.x. Errors in submessages are items of the iterator.
pub fn parse(bytes: &[u8]) -> Result<(Header, Submessages<'_>), Malformed> {
    let Some(rest) = bytes.strip_prefix(b"RTPS") else { return Err(Malformed::NotRtps) };
    // The header knows no byte order: it consists of single bytes.
    let mut cursor = Cursor::new(rest, ByteOrder::Big);
    let header = Header::read(&mut cursor)?;
    match header.version {
        [2, _] => Ok((header, Submessages { rest: cursor.rest() })),
        [major, _] => Err(Malformed::Version(major)),
    }
}

/// The submessages of a message. The iterator ends after the first malformed one, as section 8.3.4.1 requires.
#[derive(Clone, Debug)]
pub struct Submessages<'a> {
    rest: &'a [u8],
}

impl<'a> Iterator for Submessages<'a> {
    type Item = Result<Submessage<'a>, Malformed>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        let submessage = self.read();
        if submessage.is_err() {
            self.rest = &[];
        }
        Some(submessage)
    }
}

impl<'a> Submessages<'a> {
    fn read(&mut self) -> Result<Submessage<'a>, Malformed> {
        let &[id, flags, ref rest @ ..] = self.rest else { return Err(Malformed::Truncated) };
        let order = match flags & flag::LITTLE_ENDIAN {
            0 => ByteOrder::Big,
            _ => ByteOrder::Little,
        };
        let mut cursor = Cursor::new(rest, order);
        let length = match cursor.u16()? {
            // The last one may be as long as the datagram; these two may be empty (section 9.4.5.1.3).
            0 if !matches!(id, id::PAD | id::INFO_TIMESTAMP) => cursor.remaining(),
            length => length.into(),
        };
        let body = Cursor::new(cursor.take(length)?, order);
        self.rest = cursor.rest();
        Submessage::read(id, flags, body)
    }
}

impl Header {
    fn read(cursor: &mut Cursor<'_>) -> Result<Self, Malformed> {
        let (version, vendor) = (cursor.array()?, VendorId(cursor.array()?));
        Ok(Self { version, vendor, prefix: GuidPrefix(cursor.array()?) })
    }
}

impl<'a> Submessage<'a> {
    fn read(id: u8, flags: u8, mut body: Cursor<'a>) -> Result<Self, Malformed> {
        Ok(match id {
            id::PAD => Self::Pad,
            id::ACK_NACK => Self::AckNack(AckNack::read(flags, &mut body)?),
            id::HEARTBEAT => Self::Heartbeat(Heartbeat::read(flags, &mut body)?),
            id::GAP => Self::Gap(Gap::read(&mut body)?),
            id::INFO_TIMESTAMP if flags & flag::INVALIDATE != 0 => Self::InfoTimestamp(None),
            id::INFO_TIMESTAMP => Self::InfoTimestamp(Timestamp::read(&mut body)?),
            id::INFO_SOURCE => {
                body.u32()?; // unused
                Self::InfoSource(Header::read(&mut body)?)
            }
            id::INFO_REPLY | id::INFO_REPLY_IP4 => Self::InfoReply,
            id::INFO_DESTINATION => Self::InfoDestination(GuidPrefix(body.array()?)),
            id::NACK_FRAGMENT => Self::NackFragment(NackFragment::read(&mut body)?),
            id::HEARTBEAT_FRAGMENT => Self::HeartbeatFragment(HeartbeatFragment::read(&mut body)?),
            id::DATA => Self::Data(Data::read(flags, body)?),
            id::DATA_FRAGMENT => Self::DataFragment(DataFragment::read(flags, body)?),
            id if id::SECURITY.contains(&id) => Self::Security { id, body: body.rest() },
            id => Self::Unknown { id },
        })
    }
}

/// Reads the reader and the writer, with which most submessages begin.
fn read_ends(body: &mut Cursor<'_>) -> Result<(EntityId, EntityId), Malformed> {
    Ok((EntityId(body.array()?), EntityId(body.array()?)))
}

/// Reads the beginning of DATA and DATA_FRAG. The returned cursor is at the inline QoS, whose offset allows later versions to
/// add fields in front.
fn read_data_ends<'a>(body: &mut Cursor<'a>) -> Result<(EntityId, EntityId, Cursor<'a>), Malformed> {
    body.u16()?; // extra flags: none are defined
    let offset = body.u16()?;
    let mut rest = *body;
    rest.take(offset.into())?;
    let (reader, writer) = read_ends(body)?;
    Ok((reader, writer, rest))
}

fn read_inline_qos(flags: u8, rest: &mut Cursor<'_>) -> Result<InlineQos, Malformed> {
    match flags & flag::INLINE_QOS {
        0 => Ok(InlineQos::default()),
        _ => InlineQos::from_list(ParameterList::read(rest)?),
    }
}

impl<'a> Data<'a> {
    fn read(flags: u8, mut body: Cursor<'a>) -> Result<Self, Malformed> {
        let (reader, writer, mut rest) = read_data_ends(&mut body)?;
        let number = SequenceNumber::read(&mut body, SequenceNumber::FIRST)?;
        if rest.position() < body.position() {
            return Err(Malformed::Truncated);
        }
        let inline_qos = read_inline_qos(flags, &mut rest)?;
        let payload = match flags & (flag::DATA | flag::KEY) {
            0 => Payload::None,
            flag::KEY => Payload::Key(without_padding(rest.rest())?),
            _ => Payload::Data(without_padding(rest.rest())?),
        };
        Ok(Self { reader, writer, number, inline_qos, payload })
    }
}

/// Removes the padding that the encapsulation declares.
fn without_padding(payload: &[u8]) -> Result<&[u8], Malformed> {
    match *payload {
        [0, _, _, options, ref content @ ..] => {
            let padding = usize::from(options & 3).min(content.len());
            Ok(&payload[..payload.len() - padding])
        }
        // No encapsulation of the standard, so its options are unknown.
        [_, _, _, _, ..] => Ok(payload),
        _ => Err(Malformed::Encapsulation),
    }
}

impl<'a> DataFragment<'a> {
    fn read(flags: u8, mut body: Cursor<'a>) -> Result<Self, Malformed> {
        let (reader, writer, mut rest) = read_data_ends(&mut body)?;
        let number = SequenceNumber::read(&mut body, SequenceNumber::FIRST)?;
        let (first, count, fragment_size) = (body.u32()?, body.u16()?, body.u16()?);
        let sample_size = body.u32()?;
        if rest.position() < body.position() {
            return Err(Malformed::Truncated);
        }
        let inline_qos = read_inline_qos(flags, &mut rest)?;
        let length =
            length_of_fragments(first, count, fragment_size, sample_size).ok_or(Malformed::Fragment)?;
        let is_key = flags & flag::FRAGMENT_OF_KEY != 0;
        let payload = rest.take(length)?;
        Ok(Self {
            reader,
            writer,
            number,
            first,
            count,
            fragment_size,
            sample_size,
            inline_qos,
            payload,
            is_key,
        })
    }
}

/// Bytes in `count` fragments from `first` on, where the last fragment of the sample may be short. `None` if they do not lie
/// within the sample, or the sample is shorter than an encapsulation.
fn length_of_fragments(first: u32, count: u16, fragment_size: u16, sample_size: u32) -> Option<usize> {
    if count == 0 || fragment_size == 0 || sample_size < 4 {
        return None;
    }
    let (fragment_size, sample_size) = (u64::from(fragment_size), u64::from(sample_size));
    let before = u64::from(first.checked_sub(1)?);
    let after = before + u64::from(count);
    if after > sample_size.div_ceil(fragment_size) {
        return None;
    }
    usize::try_from((after * fragment_size).min(sample_size) - before * fragment_size).ok()
}

impl AckNack {
    fn read(flags: u8, body: &mut Cursor<'_>) -> Result<Self, Malformed> {
        let (reader, writer) = read_ends(body)?;
        let missing = read_set(body, SequenceNumber::ZERO)?;
        if missing.contains(SequenceNumber::ZERO) {
            return Err(Malformed::SequenceNumber);
        }
        Ok(Self { reader, writer, missing, count: body.u32()?, is_final: flags & flag::FINAL != 0 })
    }
}

fn read_set(body: &mut Cursor<'_>, lowest: SequenceNumber) -> Result<SequenceNumberSet, Malformed> {
    let base = SequenceNumber::read(body, lowest)?;
    SequenceNumberSet::read_bits(body, base)
}

impl Heartbeat {
    fn read(flags: u8, body: &mut Cursor<'_>) -> Result<Self, Malformed> {
        let (reader, writer) = read_ends(body)?;
        let first = SequenceNumber::read(body, SequenceNumber::FIRST)?;
        let last = SequenceNumber::read(body, first.previous())?;
        Ok(Self {
            reader,
            writer,
            first,
            last,
            count: body.u32()?,
            is_final: flags & flag::FINAL != 0,
            is_liveliness: flags & flag::LIVELINESS != 0,
        })
    }
}

impl Gap {
    fn read(body: &mut Cursor<'_>) -> Result<Self, Malformed> {
        let (reader, writer) = read_ends(body)?;
        let start = SequenceNumber::read(body, SequenceNumber::FIRST)?;
        let list = read_set(body, SequenceNumber::FIRST)?;
        // A range that runs backwards is empty.
        Ok(Self { reader, writer, start: start.min(list.base()), list })
    }
}

impl NackFragment {
    fn read(body: &mut Cursor<'_>) -> Result<Self, Malformed> {
        let (reader, writer) = read_ends(body)?;
        let number = SequenceNumber::read(body, SequenceNumber::FIRST)?;
        let base = body.u32()?;
        if base == 0 {
            return Err(Malformed::Fragment);
        }
        let missing = FragmentSet::read_bits(body, base)?;
        Ok(Self { reader, writer, number, missing, count: body.u32()? })
    }
}

impl HeartbeatFragment {
    fn read(body: &mut Cursor<'_>) -> Result<Self, Malformed> {
        let (reader, writer) = read_ends(body)?;
        let number = SequenceNumber::read(body, SequenceNumber::FIRST)?;
        let last = body.u32()?;
        if last == 0 {
            return Err(Malformed::Fragment);
        }
        Ok(Self { reader, writer, number, last, count: body.u32()? })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// A message written by hand, big-endian except for the DATA.
    const MESSAGE: &[u8] = &[
        b'R', b'T', b'P', b'S', 2, 1, 0x01, 0x10, // header
        1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, // its prefix
        0x0e, 0x00, 0, 12, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, // INFO_DST
        0x09, 0x00, 0, 8, 0, 0, 0, 1, 0x80, 0, 0, 0, // INFO_TS of 1.5 s
        0x80, 0x00, 0, 4, 0xde, 0xad, 0xbe, 0xef, // of a vendor
        0x15, 0x05, 29, 0, // DATA, little-endian
        0, 0, 16, 0, 0, 0, 2, 4, 0, 0, 1, 3, 0, 0, 0, 0, 7, 0, 0, 0, // ends and number 7
        0, 1, 0, 0, 5, 6, 7, 8, 9, // payload
        0x01, 0x00, 0, 0, // PAD
        0x07, 0x06, 0, 28, // HEARTBEAT, final, of liveliness
        0, 0, 0, 0, 0, 0, 1, 3, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 5, 0, 0, 0, 9, 0x06, 0x00, 0,
        0, // ACKNACK to the end
        0, 0, 2, 4, 0, 0, 1, 3, 0, 0, 0, 0, 0, 0, 0, 7, 0, 0, 0, 2, 0x40, 0, 0, 0, 0, 0, 0, 3,
    ];

    const READER: EntityId = EntityId::user_reader(2);
    const WRITER: EntityId = EntityId::user_writer(1);

    fn submessages(bytes: &[u8]) -> Vec<Result<Submessage<'_>, Malformed>> {
        parse(bytes).unwrap().1.collect()
    }

    /// Reads a message with one submessage.
    fn read(id: u8, flags: u8, body: &[u8]) -> Result<Submessage<'static>, Malformed> {
        let length = u16::try_from(body.len()).unwrap_or(0).to_be_bytes();
        let bytes = [&MESSAGE[..20], &[id, flags], &length, body].concat();
        let mut all = submessages(Vec::leak(bytes));
        assert_eq!(all.len(), 1);
        all.remove(0)
    }

    fn body(parts: &[&[u8]]) -> Vec<u8> {
        parts.concat()
    }

    const ENDS: &[u8] = &[0, 0, 2, 4, 0, 0, 1, 3];
    const ONE: &[u8] = &[0, 0, 0, 0, 0, 0, 0, 1];
    const ZERO: &[u8] = &[0; 8];
    const TOO_HIGH: &[u8] = &[0x40, 0, 0, 0, 0, 0, 0, 1];
    const COUNT: &[u8] = &[0, 0, 0, 5];
    const NO_BITS: &[u8] = &[0; 4];

    #[test]
    fn a_message_is_read_to_its_end() {
        let (header, _) = parse(MESSAGE).unwrap();
        let prefix = GuidPrefix([1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]);
        assert_eq!(header, Header { version: [2, 1], vendor: VendorId::CYCLONE, prefix });
        let mut missing = SequenceNumberSet::new(SequenceNumber(7));
        assert!(missing.insert(SequenceNumber(8)));
        let expected = [
            Submessage::InfoDestination(GuidPrefix([12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1])),
            Submessage::InfoTimestamp(Some(Timestamp::from_nanos(1_500_000_000))),
            Submessage::Unknown { id: 0x80 },
            Submessage::Data(Data {
                reader: READER,
                writer: WRITER,
                number: SequenceNumber(7),
                inline_qos: InlineQos::default(),
                payload: Payload::Data(&[0, 1, 0, 0, 5, 6, 7, 8, 9]),
            }),
            Submessage::Pad,
            Submessage::Heartbeat(Heartbeat {
                reader: EntityId::UNKNOWN,
                writer: WRITER,
                first: SequenceNumber(1 << 32),
                last: SequenceNumber((1 << 32) + 5),
                count: 9,
                is_final: true,
                is_liveliness: true,
            }),
            Submessage::AckNack(AckNack {
                reader: READER,
                writer: WRITER,
                missing,
                count: 3,
                is_final: false,
            }),
        ];
        assert_eq!(submessages(MESSAGE), expected.map(Ok));
    }

    #[test]
    fn a_message_may_end_anywhere_without_harm() {
        for length in 0..MESSAGE.len() {
            match parse(&MESSAGE[..length]) {
                Err(fault) => assert!(length < 20, "{length}: {fault}"),
                Ok((_, submessages)) => assert!(submessages.count() <= 7),
            }
        }
    }

    #[test]
    fn nothing_is_read_behind_a_malformed_submessage() {
        let mut bytes = MESSAGE.to_vec();
        bytes[20 + 3] = 11; // INFO_DST one byte short
        assert_eq!(submessages(&bytes), [Err(Malformed::Truncated)]);
    }

    #[test]
    fn other_protocols_and_versions_are_refused() {
        assert_eq!(parse(b"").err(), Some(Malformed::NotRtps));
        assert_eq!(parse(b"RTPX").err(), Some(Malformed::NotRtps));
        assert_eq!(parse(&MESSAGE[..19]).err(), Some(Malformed::Truncated));
        for (version, result) in
            [(1, Some(Malformed::Version(1))), (3, Some(Malformed::Version(3))), (2, None)]
        {
            let mut bytes = MESSAGE.to_vec();
            (bytes[4], bytes[5]) = (version, 99);
            assert_eq!(parse(&bytes).err(), result);
        }
    }

    #[test]
    fn submessages_that_end_early_are_malformed() {
        for (id, length) in
            [(0x06, 28), (0x07, 28), (0x08, 28), (0x09, 8), (0x0c, 20), (0x0e, 12), (0x12, 28), (0x13, 24)]
        {
            let bytes = body(&[ENDS, ONE, &[0, 0, 0, 1], &[0; 8]]);
            for short in 1..length {
                assert!(read(id, 0, &bytes[..short]).is_err(), "{id:#x} of {short} bytes");
            }
        }
        assert_eq!(submessages(&[&MESSAGE[..20], &[0x07, 0, 0]].concat()), [Err(Malformed::Truncated)]);
        assert_eq!(
            submessages(&[&MESSAGE[..20], &[0x80, 0, 0xff, 0xff, 1]].concat()),
            [Err(Malformed::Truncated)]
        );
    }

    #[test]
    fn a_timestamp_can_be_taken_back() {
        assert_eq!(read(0x09, 0x02, &[]), Ok(Submessage::InfoTimestamp(None)));
        assert_eq!(read(0x09, 0x00, &[0xff; 8]), Ok(Submessage::InfoTimestamp(None)));
        assert_eq!(read(0x09, 0x00, &[]), Err(Malformed::Truncated));
    }

    #[test]
    fn a_source_replaces_the_header() {
        let source = read(0x0c, 0, &body(&[&[9; 4], &[2, 3, 1, 0x0f], &[7; 12]])).unwrap();
        let header = Header { version: [2, 3], vendor: VendorId::FAST_DDS, prefix: GuidPrefix([7; 12]) };
        assert_eq!(source, Submessage::InfoSource(header));
    }

    #[test]
    fn security_is_handed_on_and_replies_are_not_read() {
        assert_eq!(read(0x33, 0, &[1, 2]), Ok(Submessage::Security { id: 0x33, body: &[1, 2] }));
        assert_eq!(read(0x35, 0, &[1, 2]), Ok(Submessage::Unknown { id: 0x35 }));
        assert_eq!(read(0x0f, 0, &[1, 2]), Ok(Submessage::InfoReply));
    }

    #[test]
    fn data_numbers_are_from_1_to_2_to_the_62() {
        let with = |number: &[u8]| read(0x15, 0, &body(&[&[0, 0, 0, 16], ENDS, number]));
        assert!(with(ONE).is_ok());
        for bad in [ZERO, TOO_HIGH, &[0xff; 8], &[0x7f, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff]] {
            assert_eq!(with(bad), Err(Malformed::SequenceNumber));
        }
    }

    #[test]
    fn inline_qos_lies_where_its_offset_says() {
        let list: &[u8] = &[0, 0x71, 0, 4, 0, 0, 0, 3, 0, 1, 0, 0];
        let with = |offset: u8, between: &[u8], list: &[u8]| {
            read(0x15, 0x06, &body(&[&[0, 0, 0, offset], ENDS, ONE, between, list, &[0, 1, 0, 0]]))
        };
        for (offset, between) in [(16, &[][..]), (20, &[9; 4])] {
            let Ok(Submessage::Data(data)) = with(offset, between, list) else { panic!("no data") };
            assert_eq!(data.inline_qos.status.map(|status| status.0), Some(3));
            assert_eq!(data.payload, Payload::Data(&[0, 1, 0, 0]));
        }
        assert_eq!(with(12, &[], list), Err(Malformed::Truncated), "within the fields");
        assert_eq!(with(0xff, &[], list), Err(Malformed::Truncated), "behind the end");
        let without_end = body(&[&[0, 0, 0, 16], ENDS, ONE, &list[..8]]);
        assert_eq!(read(0x15, 0x06, &without_end), Err(Malformed::Truncated));
        assert_eq!(with(16, &[], &[0, 0x71, 0, 3, 0, 0, 0, 3]), Err(Malformed::ParameterList));
    }

    #[test]
    fn a_payload_loses_the_padding_it_declares() {
        let with = |flags: u8, payload: &[u8]| {
            let data = read(0x15, flags, &body(&[&[0, 0, 0, 16], ENDS, ONE, payload]))?;
            let Submessage::Data(data) = data else { panic!("no data") };
            Ok(data.payload)
        };
        assert_eq!(with(0x04, &[0, 1, 0, 3, 9, 0, 0, 0]), Ok(Payload::Data(&[0, 1, 0, 3, 9])));
        assert_eq!(with(0x08, &[0, 1, 0, 3, 9, 0, 0, 0]), Ok(Payload::Key(&[0, 1, 0, 3, 9])));
        assert_eq!(with(0x04, &[0, 1, 0, 3]), Ok(Payload::Data(&[0, 1, 0, 3])));
        assert_eq!(with(0x04, &[9, 1, 0, 3, 9, 0, 0, 0]), Ok(Payload::Data(&[9, 1, 0, 3, 9, 0, 0, 0])));
        assert_eq!(with(0x00, &[1, 2, 3]), Ok(Payload::None));
        for short in [&[][..], &[0], &[0, 1, 0]] {
            assert_eq!(with(0x04, short), Err(Malformed::Encapsulation));
            assert_eq!(with(0x08, short), Err(Malformed::Encapsulation));
        }
    }

    /// Reads a DATA_FRAG with `payload` bytes of payload.
    fn fragment(first: u32, count: u16, size: u16, sample: u32, payload: usize) -> Result<usize, Malformed> {
        let numbers =
            body(&[&first.to_be_bytes(), &count.to_be_bytes(), &size.to_be_bytes(), &sample.to_be_bytes()]);
        match read(0x16, 0, &body(&[&[0, 0, 0, 28], ENDS, ONE, &numbers, &vec![7; payload]]))? {
            Submessage::DataFragment(fragment) => {
                let end = fragment.offset() as usize + fragment.payload.len();
                assert!(end <= sample as usize, "{fragment:?}");
                Ok(fragment.payload.len())
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn fragments_lie_within_their_sample() {
        assert_eq!(fragment(1, 1, 100, 250, 100), Ok(100));
        assert_eq!(fragment(1, 2, 100, 250, 200), Ok(200));
        assert_eq!(fragment(3, 1, 100, 250, 50), Ok(50), "the last is short");
        assert_eq!(fragment(1, 3, 100, 250, 252), Ok(250), "and padded");
        assert_eq!(fragment(1, 1, 65_535, 4, 4), Ok(4));
        assert_eq!(fragment(u32::MAX, 1, 1, u32::MAX, 1), Ok(1));
        assert_eq!(fragment(0x1_0001, 1, 65_535, u32::MAX, 65_535), Ok(65_535));
        for (first, count, size, sample) in [
            (0, 1, 100, 250),
            (4, 1, 100, 250),
            (1, 0, 100, 250),
            (1, 1, 0, 250),
            (1, 4, 100, 250),
            (3, 2, 100, 250),
            (1, 1, 100, 0),
            (1, 1, 100, 3),
            (u32::MAX, 1, 100, 250),
            (u32::MAX, 65_535, 65_535, u32::MAX),
            (0x1_0002, 1, 65_535, u32::MAX), // 2³² and a bit
        ] {
            assert_eq!(
                fragment(first, count, size, sample, 300),
                Err(Malformed::Fragment),
                "{first} {count} {size}"
            );
        }
    }

    #[test]
    fn fragments_that_bring_fewer_bytes_than_they_say_are_malformed() {
        assert_eq!(fragment(1, 2, 100, 250, 199), Err(Malformed::Truncated));
        assert_eq!(fragment(3, 1, 100, 250, 49), Err(Malformed::Truncated));
        assert_eq!(fragment(1, 65_535, 65_535, u32::MAX, 1000), Err(Malformed::Truncated));
    }

    #[test]
    fn a_heartbeat_runs_forward() {
        let with = |first: i64, last: i64| {
            read(0x07, 0, &body(&[ENDS, &first.to_be_bytes(), &last.to_be_bytes(), COUNT]))
        };
        assert!(with(1, 0).is_ok());
        assert!(with(1, 1 << 60).is_ok());
        assert!(with(SequenceNumber::MAX.0, SequenceNumber::MAX.0).is_ok());
        for (first, last) in
            [(0, 0), (-5, 5), (5, 3), (1, -1), (1, i64::MAX), (i64::MAX, i64::MAX), (1, i64::MIN)]
        {
            assert_eq!(with(first, last), Err(Malformed::SequenceNumber), "{first} {last}");
        }
    }

    #[test]
    fn an_acknowledgement_of_nothing_is_one_and_one_that_asks_for_number_zero_is_not() {
        let with = |base: &[u8], bits: &[u8]| read(0x06, 0, &body(&[ENDS, base, bits, COUNT]));
        assert!(with(ZERO, NO_BITS).is_ok());
        assert!(with(ONE, &[0, 0, 0, 1, 0x80, 0, 0, 0]).is_ok());
        assert_eq!(with(ZERO, &[0, 0, 0, 1, 0x80, 0, 0, 0]), Err(Malformed::SequenceNumber));
        assert_eq!(with(&[0xff; 8], NO_BITS), Err(Malformed::SequenceNumber));
        assert_eq!(with(ONE, &[0, 0, 1, 1]), Err(Malformed::NumberSet));
        assert_eq!(with(ONE, &[0xff; 4]), Err(Malformed::NumberSet));
    }

    #[test]
    fn a_gap_that_runs_backwards_is_empty() {
        let with = |start: i64, base: i64| match read(
            0x08,
            0,
            &body(&[ENDS, &start.to_be_bytes(), &base.to_be_bytes(), NO_BITS]),
        )? {
            Submessage::Gap(gap) => Ok((gap.start.0, gap.list.base().0)),
            other => panic!("{other:?}"),
        };
        assert_eq!(with(5, 1 << 40), Ok((5, 1 << 40)));
        assert_eq!(with(9, 5), Ok((5, 5)));
        for (start, base) in [(0, 5), (5, 0), (-1, 5), (1, i64::MAX), (i64::MAX, 1)] {
            assert_eq!(with(start, base), Err(Malformed::SequenceNumber));
        }
    }

    #[test]
    fn fragments_count_from_one() {
        let nack = |base: &[u8]| read(0x12, 0, &body(&[ENDS, ONE, base, NO_BITS, COUNT]));
        let heartbeat = |last: &[u8]| read(0x13, 0, &body(&[ENDS, ONE, last, COUNT]));
        assert!(nack(&[0, 0, 0, 1]).is_ok() && heartbeat(&[0, 0, 0, 1]).is_ok());
        assert_eq!(nack(&[0; 4]), Err(Malformed::Fragment));
        assert_eq!(heartbeat(&[0; 4]), Err(Malformed::Fragment));
    }
}
