//! Why a certificate, a key or a revocation list cannot be used.

/// Why a certificate, a key or a revocation list cannot be used. The caller names the file or the peer.
#[allow(missing_docs)] // the texts say it
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PkiError {
    #[error(
        "{length} bytes are too many for a certificate, a key or a revocation list, the limit is {limit}"
    )]
    TooLong { length: usize, limit: usize },
    #[error(
        "there is no PEM block \"{expected}\"; the file must have the line \"-----BEGIN {expected}-----\""
    )]
    NoBlock { expected: &'static str },
    #[error("line {line}: a second PEM block \"{label}\", but only one is supported; remove the others")]
    SecondBlock { label: &'static str, line: usize },
    #[error("line {line}: the PEM block \"{label}\" is damaged; copy the file again")]
    Pem { label: &'static str, line: usize },
    #[error("the private key is protected by a password; store it without one, as PKCS#8")]
    EncryptedKey,
    #[error("the private key is damaged or not an elliptic curve key in PKCS#8 or SEC1 form")]
    Key,
    #[error(
        "the key is of kind {found}, but only P-256 (prime256v1) keys are supported, as sros2 makes them"
    )]
    NotP256 { found: String },
    #[error("not a valid X.509 certificate: {0}")]
    Certificate(String),
    #[error("not a valid revocation list: {0}")]
    Crl(String),
    #[error("signed with algorithm {found}, but only ECDSA with SHA-256 is supported, as sros2 uses it")]
    SignatureAlgorithm { found: String },
    #[error("the critical extension {oid} is not supported")]
    CriticalExtension { oid: String },
}
