//! Messages and their submessages (sections 9.4.4 and 9.4.5).

use super::bytes::Cursor;
use super::{
    ByteOrder, EntityId, FragmentSet, Guid, GuidPrefix, InlineQos, Malformed, SequenceNumber,
    SequenceNumberSet, Timestamp, VendorId,
};

/// The beginning of every message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Header {
    /// Major and minor.
    pub version: [u8; 2],
    #[allow(missing_docs)]
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
    /// Source timestamp of the data that follow; `None` takes an earlier one back.
    InfoTimestamp(Option<Timestamp>),
    /// For whom the following is; [`GuidPrefix::UNKNOWN`] is everybody.
    InfoDestination(GuidPrefix),
    /// From whom the following is.
    InfoSource(Header),
    /// Where to answer. We answer to announced locators only, so its content is ignored.
    InfoReply,
    #[allow(missing_docs)]
    Data(Data<'a>),
    #[allow(missing_docs)]
    DataFragment(DataFragment<'a>),
    #[allow(missing_docs)]
    AckNack(AckNack),
    #[allow(missing_docs)]
    Heartbeat(Heartbeat),
    #[allow(missing_docs)]
    Gap(Gap),
    #[allow(missing_docs)]
    NackFragment(NackFragment),
    #[allow(missing_docs)]
    HeartbeatFragment(HeartbeatFragment),
    /// Filler.
    Pad,
    /// Part of DDS Security: ids 0x30 to 0x34.
    #[allow(missing_docs)]
    Security { id: u8, body: &'a [u8] },
    /// Of a later version or another vendor: skipped.
    #[allow(missing_docs)]
    Unknown { id: u8 },
}

/// A sample, or the end of an instance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Data<'a> {
    /// [`EntityId::UNKNOWN`] is every matched reader.
    pub reader: EntityId,
    #[allow(missing_docs)]
    pub writer: EntityId,
    #[allow(missing_docs)]
    pub number: SequenceNumber,
    #[allow(missing_docs)]
    pub inline_qos: InlineQos,
    #[allow(missing_docs)]
    pub payload: Payload<'a>,
}

impl Data<'_> {
    /// The entity that a removal in discovery data is about: from the key hash, as Fast DDS says it, or from the key, as
    /// Cyclone DDS does. `None` if this is no removal, or tells nobody.
    pub fn removed(&self) -> Option<Guid> {
        todo!()
    }
}

/// The content of a sample, with the four bytes of its encapsulation in front.
///
/// A payload is a multiple of four bytes on the wire. How much of the end is padding is told by the last two bits of the
/// encapsulation (DDS-XTypes 1.3, section 7.6.3.1.2): those bytes are taken off here. Fast DDS does not set them, so up
/// to three bytes of padding may remain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Payload<'a> {
    /// Nothing: the inline QoS says it all.
    None,
    /// A sample.
    Data(&'a [u8]),
    /// Only the key of an instance.
    Key(&'a [u8]),
}

/// A run of consecutive fragments of a sample. It lies within the sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DataFragment<'a> {
    /// [`EntityId::UNKNOWN`] is every matched reader.
    pub reader: EntityId,
    #[allow(missing_docs)]
    pub writer: EntityId,
    #[allow(missing_docs)]
    pub number: SequenceNumber,
    /// The first fragment in here; the first of the sample is 1.
    pub first: u32,
    /// How many are in here, at least 1.
    pub count: u16,
    /// Bytes of every fragment but the last of the sample, at least 1.
    pub fragment_size: u16,
    /// Bytes of the sample with its encapsulation, at least 1.
    pub sample_size: u32,
    /// Cyclone DDS sends it with the first fragment only.
    pub inline_qos: InlineQos,
    /// The fragments' bytes: neither fewer nor more than the numbers above say.
    pub payload: &'a [u8],
    /// Whether the sample is only the key of an instance.
    pub is_key: bool,
}

impl DataFragment<'_> {
    /// Where in the sample the payload begins.
    pub fn offset(&self) -> u32 {
        // Checked when parsed: the range is within the sample, whose size is 32 bits.
        (self.first - 1) * u32::from(self.fragment_size)
    }
}

/// What a reader has and what it lacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AckNack {
    #[allow(missing_docs)]
    pub reader: EntityId,
    #[allow(missing_docs)]
    pub writer: EntityId,
    /// All below the base are received. Base 0 without a number is how Fast DDS asks for a first [`Heartbeat`].
    pub missing: SequenceNumberSet,
    /// Rises with each one of this reader to this writer.
    pub count: u32,
    /// Whether no answer is needed.
    pub is_final: bool,
}

/// What a writer has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// [`EntityId::UNKNOWN`] is every matched reader.
    pub reader: EntityId,
    #[allow(missing_docs)]
    pub writer: EntityId,
    /// The oldest sample there is.
    pub first: SequenceNumber,
    /// The newest sample there was; one less than `first` if there is none.
    pub last: SequenceNumber,
    /// Rises with each one of this writer.
    pub count: u32,
    /// Whether no answer is needed.
    pub is_final: bool,
    /// Whether it asserts that the writer is alive, by the application's wish.
    pub is_liveliness: bool,
}

/// Samples that will never come: those from `start` to below the base of the list, and those in the list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// [`EntityId::UNKNOWN`] is every matched reader.
    pub reader: EntityId,
    #[allow(missing_docs)]
    pub writer: EntityId,
    /// At most the base of the list.
    pub start: SequenceNumber,
    #[allow(missing_docs)]
    pub list: SequenceNumberSet,
}

/// Fragments of one sample that a reader lacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NackFragment {
    #[allow(missing_docs)]
    pub reader: EntityId,
    #[allow(missing_docs)]
    pub writer: EntityId,
    #[allow(missing_docs)]
    pub number: SequenceNumber,
    /// Its base is at least 1.
    pub missing: FragmentSet,
    /// Rises with each one of this reader to this writer.
    pub count: u32,
}

/// Fragments of one sample that a writer has ready.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeartbeatFragment {
    /// [`EntityId::UNKNOWN`] is every matched reader.
    pub reader: EntityId,
    #[allow(missing_docs)]
    pub writer: EntityId,
    #[allow(missing_docs)]
    pub number: SequenceNumber,
    /// The last fragment that is ready, at least 1; all before it are too.
    pub last: u32,
    /// Rises with each one of this writer.
    pub count: u32,
}

/// Reads the header of a message and gives its submessages.
///
/// # Errors
/// [`Malformed::NotRtps`] and [`Malformed::Version`]. What is wrong with a submessage is an item of the iterator.
pub fn parse(bytes: &[u8]) -> Result<(Header, Submessages<'_>), Malformed> {
    todo!()
}

/// The submessages of a message. Ends after the first malformed one, as section 8.3.4.1 demands.
#[derive(Clone, Debug)]
pub struct Submessages<'a> {
    rest: &'a [u8],
}

impl<'a> Iterator for Submessages<'a> {
    type Item = Result<Submessage<'a>, Malformed>;

    fn next(&mut self) -> Option<Self::Item> {
        todo!()
    }
}
