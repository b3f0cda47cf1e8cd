//! Protection of payloads, submessages and messages by AES-GCM and AES-GMAC (DDS Security 1.1, section 9.5).
//!
//! A [`Sealer`] protects with one [`KeyMaterial`] at each of three levels, as the kind of its key says; the
//! [`Opener`] of the same material checks and decrypts:
//!
//! | level | key | what it protects |
//! | --- | --- | --- |
//! | `payload` | of a writer | the payload of a DATA or DATA_FRAG |
//! | `submessage` | of a writer or reader | one submessage |
//! | `message` | of a participant | a whole datagram |
//!
//! [`payload_transform`], [`submessage_transform`] and [`message_transform`] tell which key a receiver needs.
//! Everything here works on bytes. Nothing is allocated beyond the length of the input.

mod footer;
pub(crate) mod framing;
mod header;
mod material;
mod message;
mod opener;
mod payload;
mod sealer;
mod session;
mod submessage;

#[cfg(test)]
mod tests;

pub use header::Transform;
pub use material::{KeyId, KeyMaterial, MaterialError, ReceiverKey, TransformKind};
pub use message::message_transform;
pub use opener::Opener;
pub use payload::payload_transform;
pub use sealer::Sealer;
pub use submessage::{split_submessage_group, submessage_session, submessage_transform};

/// Why data cannot be protected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SealError {
    /// The data and the MACs of its receivers do not fit into a submessage.
    #[error("data is too long to be protected")]
    TooLong,
    /// The data is not one submessage, or not a message.
    #[error("data to be protected is not made of whole submessages")]
    NotSubmessages,
}

/// Why protected data is not accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OpenError {
    /// The bytes end before the last field.
    #[error("protected data ends early")]
    Truncated,
    /// The kind of the key is none of those of the specification.
    #[error("protected by an unknown kind of key {0:#010x}")]
    UnknownKind(u32),
    /// The key has another identifier than ours.
    #[error("protected with another key")]
    OtherKey,
    /// The data says that it is encrypted where the key only signs, or the reverse.
    #[error("protected by another kind of key than agreed")]
    OtherKind,
    /// A submessage is missing, or stands in the wrong place.
    #[error("protected data lacks its prefix, body or postfix")]
    Structure,
    /// A length contradicts another one.
    #[error("length of a part of protected data is wrong")]
    Length,
    /// The sender signed for other receivers.
    #[error("protected data is not signed for this receiver")]
    NotForThisReceiver,
    /// The MAC does not match: the data was changed, or does not come from a holder of the key.
    #[error("MAC of protected data does not match")]
    Forged,
    /// The protected INFO_SRC contradicts the header of the message.
    #[error("header of a protected message was changed")]
    Source,
    /// The decrypted bytes are not whole submessages.
    #[error("protected data does not contain whole submessages")]
    Content,
}
