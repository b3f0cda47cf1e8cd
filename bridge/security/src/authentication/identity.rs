//! What participants know of themselves and of each other.

use std::fmt;

use zeroize::{Zeroize, ZeroizeOnDrop};

use crate::pki::{Authority, Certificate, PrivateKey};
use crate::tokens::Token;

const CLASS: &str = "DDS:Auth:PKI-DH:1.0";
pub(super) const SIGNATURE_ALGORITHM: &str = "ECDSA-SHA256";

/// What a participant proves its identity with.
#[derive(Clone, Debug)]
pub struct Identity {
    /// The certificate of the enclave.
    pub certificate: Certificate,
    /// Its private key.
    pub key: PrivateKey,
    /// The authority that all participants trust.
    pub authority: Authority,
    /// The signed permissions, as the enclave has them.
    pub permissions_document: Vec<u8>,
}

/// Another participant that has proven its identity. Its permissions have not been checked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RemoteIdentity {
    /// The certificate, which the authority trusts.
    pub certificate: Certificate,
    /// The signed permissions.
    pub permissions_document: Vec<u8>,
    /// The participant's announcement, as a big-endian parameter list without encapsulation.
    pub participant_data: Vec<u8>,
}

/// The secret of two participants after a handshake, from which the keys of their volatile channel follow. It
/// is wiped from memory when dropped, and not shown by `Debug`.
#[derive(Clone, PartialEq, Eq, Zeroize, ZeroizeOnDrop)]
pub struct SharedSecret {
    /// The initiator's random number.
    pub challenge1: [u8; 32],
    /// The replier's random number.
    pub challenge2: [u8; 32],
    /// The hash of the agreed key.
    pub secret: [u8; 32],
}

impl fmt::Debug for SharedSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SharedSecret(..)")
    }
}

/// The token by which a participant announces that it can authenticate itself. It proves nothing.
pub fn identity_token(certificate: &Certificate, authority: &Certificate) -> Token {
    // Fast DDS before 2.14.5 compares the algorithm with this name.
    let properties = [
        ("dds.cert.sn", certificate.subject()),
        ("dds.cert.algo", SIGNATURE_ALGORITHM),
        ("dds.ca.sn", authority.subject()),
        ("dds.ca.algo", SIGNATURE_ALGORITHM),
    ];
    let properties = properties.map(|(name, value)| (name.to_owned(), value.to_owned()));
    Token { properties: properties.into(), ..Token::new(CLASS) }
}

/// The token by which a participant announces that it has permissions. The optional names of the authority
/// are left out: Fast DDS compares them in a form of its own.
pub fn permissions_token() -> Token {
    Token::new("DDS:Access:Permissions:1.0")
}
