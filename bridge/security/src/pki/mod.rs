//! Certificates, private keys and revocation lists as SROS2 keystores hold them: X.509, P-256, ECDSA with
//! SHA-256.
//!
//! A keystore has one level: the authority signs the certificate of each enclave itself. Longer chains, other
//! curves and RSA are refused in words.

mod authority;
mod certificate;
mod error;
mod key;
mod name;
mod pem;

pub(crate) use authority::check_validity;
pub use authority::{Authority, Crl, Date, Distrust};
pub use certificate::Certificate;
pub use error::PkiError;
pub use key::PrivateKey;

#[cfg(test)]
pub(crate) mod openssl;
