//! RTPS messages and discovery data, between bytes and values.
//!
//! [`parse`] reads a datagram of either byte order without copying, [`MessageBuilder`] writes one. A parsed
//! value is valid: numbers are in range, fragments lie within their sample, lists end. No input makes this
//! module panic or allocate more than a small multiple of the input's length.
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
mod payload;
mod time;
mod values;

pub use builder::MessageBuilder;
pub use endpoint_data::EndpointData;
pub use guid::{EntityId, Guid, GuidPrefix, SampleIdentity, VendorId};
pub use inline_qos::{InlineQos, StatusInfo};
pub use locator::Locator;
pub use message::{
    AckNack, Data, DataFragment, Gap, Header, Heartbeat, HeartbeatFragment, NackFragment, Submessage,
    Submessages, parse,
};
pub use number::{FragmentSet, Number, NumberSet, SequenceNumber, SequenceNumberSet};
pub use participant_data::{BuiltinEndpoints, ParticipantData, ParticipantSecurity, SecurityAttributes};
pub use participant_message::ParticipantMessage;
pub use payload::Payload;
pub use time::Timestamp;

use bytes::ByteOrder;

/// Why a message, or a part of it, is not accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Malformed {
    /// The datagram does not begin with `RTPS`.
    #[error("not an RTPS message")]
    NotRtps,
    /// The major version of the protocol is not 2.
    #[error("unsupported major protocol version {0}")]
    Version(u8),
    /// A field lies beyond the end of its submessage.
    #[error("message ends early")]
    Truncated,
    /// A sequence number is zero, negative or above [`SequenceNumber::MAX`], or a heartbeat ends before it
    /// begins.
    #[error("invalid sequence number")]
    SequenceNumber,
    /// A set of numbers has more than 256 bits.
    #[error("set of numbers with more than 256 bits")]
    NumberSet,
    /// A fragment lies outside its sample, or has no size.
    #[error("fragment outside its sample")]
    Fragment,
    /// The length of a parameter is not a multiple of four.
    #[error("length of a parameter is not a multiple of four")]
    ParameterList,
    /// The value of a parameter is invalid or too long.
    #[error("invalid value of parameter {0:#06x}")]
    Parameter(u16),
    /// A required parameter is missing.
    #[error("parameter {0:#06x} is missing")]
    Lacks(u16),
    /// A parameter is unknown, and its sender requires that it is understood.
    #[error("unknown parameter {0:#06x} that must be understood")]
    MustUnderstand(u16),
    /// The payload has no encapsulation, or not the required one.
    #[error("missing or unexpected encapsulation of a payload")]
    Encapsulation,
}
