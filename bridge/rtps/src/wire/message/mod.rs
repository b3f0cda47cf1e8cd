//! Messages and their submessages (sections 9.4.4 and 9.4.5).

use super::bytes::Cursor;
use super::parameters::ParameterList;
use super::{
    ByteOrder, EntityId, FragmentSet, GuidPrefix, InlineQos, Malformed, Payload, SequenceNumber,
    SequenceNumberSet, Timestamp, VendorId,
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
    /// [`EntityId::UNKNOWN`] means every matched reader.
    pub reader: EntityId,
    pub writer: EntityId,
    pub number: SequenceNumber,
    pub inline_qos: InlineQos,
    pub payload: Payload<'a>,
}

/// Consecutive fragments of a sample. They lie within the sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DataFragment<'a> {
    /// [`EntityId::UNKNOWN`] means every matched reader.
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
    /// All samples below the base are received. An empty set with base 0 requests a first [`Heartbeat`]; Fast
    /// DDS sends it.
    pub missing: SequenceNumberSet,
    /// Increases with each one from this reader to this writer.
    pub count: u32,
    /// Whether no answer is required.
    pub is_final: bool,
}

/// The samples that a writer has available.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// [`EntityId::UNKNOWN`] means every matched reader.
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

/// Samples that are no longer available: those from `start` to before the base of the list, and those in the
/// list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// [`EntityId::UNKNOWN`] means every matched reader.
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
    /// [`EntityId::UNKNOWN`] means every matched reader.
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
/// Returns an error if the header is not one of RTPS 2.x. Errors in submessages are items of the iterator.
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

/// The submessages of a message. The iterator ends after the first malformed one, as section 8.3.4.1
/// requires.
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

/// Reads the beginning of DATA and DATA_FRAG. The returned cursor is at the inline QoS, whose offset allows
/// later versions to add fields in front.
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
        // Not a standard encapsulation, so its options are unknown.
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

/// Bytes in `count` fragments from `first` on, where the last fragment of the sample may be short. `None` if
/// they do not lie within the sample, or the sample is shorter than an encapsulation.
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
        // A backward range is empty.
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
mod tests;
