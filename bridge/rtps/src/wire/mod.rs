//! RTPS messages: bytes on one side, checked views and plain values on the other.
//!
//! [`parse`] reads a datagram of either byte order without copying, [`MessageBuilder`] writes one. Whatever exists as a
//! value here is valid: numbers are in range, fragments lie within their sample, lists end. No input makes this module
//! panic or allocate more than the input is long.
//!
//! Sections are those of the OMG specification DDSI-RTPS 2.5 (formal/2022-04-01).

mod builder;
mod bytes;
mod endpoint_data;
mod guid;
mod inline_qos;
mod locator;
mod message;
mod number;
mod parameters;
mod participant_data;
mod participant_message;
mod time;
mod values;

pub use builder::MessageBuilder;
pub use endpoint_data::EndpointData;
pub use guid::{EntityId, Guid, GuidPrefix, SampleIdentity, VendorId};
pub use inline_qos::{InlineQos, StatusInfo};
pub use locator::Locator;
pub use message::{
    AckNack, Data, DataFragment, Gap, Header, Heartbeat, HeartbeatFragment, NackFragment, Payload,
    Submessage, Submessages, parse,
};
pub use number::{FragmentSet, Number, NumberSet, SequenceNumber, SequenceNumberSet};
pub use participant_data::{BuiltinEndpoints, ParticipantData};
pub use participant_message::ParticipantMessage;
pub use time::Timestamp;

use bytes::ByteOrder;

/// Why bytes are not taken for what they claim to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Malformed {
    /// The datagram does not begin with `RTPS`.
    #[error("is no RTPS message")]
    NotRtps,
    /// The major version of the protocol is not 2.
    #[error("has the major protocol version {0}, not 2")]
    Version(u8),
    /// Something ends before all of it was read.
    #[error("ends early")]
    Truncated,
    /// A sequence number is zero, negative or above [`SequenceNumber::MAX`], or a range runs backwards.
    #[error("has a sequence number that cannot be")]
    SequenceNumber,
    /// A set of numbers has more than 256 bits or leaves the range of its numbers.
    #[error("has a set of numbers that cannot be")]
    NumberSet,
    /// A fragment lies outside its sample, or has no size.
    #[error("has a fragment outside its sample")]
    Fragment,
    /// The length of a parameter is not a multiple of four, or the list has no end.
    #[error("has a parameter list without order or end")]
    ParameterList,
    /// A parameter holds a value that its type does not have.
    #[error("has a bad value for parameter {0:#06x}")]
    Parameter(u16),
    /// A parameter is absent without which the entity means nothing.
    #[error("lacks parameter {0:#06x}")]
    Lacks(u16),
    /// A parameter is unknown here, and its sender demands that it be understood.
    #[error("demands that the unknown parameter {0:#06x} be understood")]
    MustUnderstand(u16),
    /// The payload is neither a parameter list nor CDR where it has to be.
    #[error("has an encapsulation that does not fit")]
    Encapsulation,
}
