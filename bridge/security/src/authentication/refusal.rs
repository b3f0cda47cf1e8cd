//! Why a message of a handshake is not accepted.

use downbeat_rtps::wire::GuidPrefix;

use crate::pki::{Distrust, PkiError};

/// Why a message of a handshake is not accepted, or why there is no secret yet.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)] // the texts say it
pub enum Refusal {
    #[error("the handshake message of class \"{found}\" is not expected from this participant")]
    Class { found: String },
    #[error("the handshake message has {found} tokens instead of one")]
    Tokens { found: usize },
    #[error("the handshake message lacks {field}")]
    Missing { field: &'static str },
    #[error("the handshake message has {field} twice")]
    Twice { field: String },
    #[error("{field} of the handshake message has {found} bytes instead of {expected}")]
    Length { field: &'static str, found: usize, expected: usize },
    #[error("{field} of the handshake message is not what it must be in this handshake")]
    Mismatch { field: &'static str },
    #[error("the participant signs with {found}, but only ECDSA-SHA256 is supported")]
    SignatureAlgorithm { found: String },
    #[error("the participant wants to agree on a key by {found}, which is not supported")]
    KeyAgreement { found: String },
    #[error("the participant has sent no permissions document")]
    Permissions,
    #[error("the participant's data in the handshake message holds no readable GUID")]
    ParticipantData,
    #[error("the handshake message is of participant {found}, but came as that of {expected}")]
    OtherParticipant { found: GuidPrefix, expected: GuidPrefix },
    #[error("the certificate of the participant cannot be used: {0}")]
    Certificate(#[from] PkiError),
    #[error("the certificate of the participant is not trusted: {0}")]
    Distrust(#[from] Distrust),
    #[error("the GUID {prefix} does not belong to the certificate of \"{subject}\"")]
    Subject { prefix: GuidPrefix, subject: String },
    #[error("{field} of the handshake message is not a valid public key")]
    PublicKey { field: &'static str },
    #[error("the signature is wrong: the sender does not have the private key of \"{subject}\"")]
    Signature { subject: String },
    #[error("no valid message of the handshake has arrived for {seconds} s; is security enabled there?")]
    NoAnswer { seconds: u64 },
}

/// Text from a peer for an error: short, without control characters.
pub(super) fn shown(bytes: &[u8]) -> String {
    let bytes = bytes.get(..64).unwrap_or(bytes);
    String::from_utf8_lossy(bytes).escape_debug().collect()
}
