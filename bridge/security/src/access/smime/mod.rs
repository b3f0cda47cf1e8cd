//! Signed documents (S/MIME, RFC 8551): a text in the clear, and the signature of the permissions authority.

mod mime;
mod signature;

use std::time::SystemTime;

use sha2::{Digest, Sha256};

use crate::pki::{Certificate, PrivateKey};

const MAX_BYTES: usize = 1 << 20;

/// Why a signed document is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SmimeError {
    /// The length of a document that is too long.
    #[error("the signed document has {0} bytes, the most that is read is {MAX_BYTES}")]
    TooLong(usize),
    /// The document is something else, for example the XML itself.
    #[error(
        "this is no signed document: it does not begin with the header of multipart/signed; sign it, for \
             example by `openssl smime -sign -text`"
    )]
    NotSigned,
    /// The text is inside of the signature.
    #[error(
        "the text is inside of the signature (application/pkcs7-mime); sign it in the clear, without -nodetach"
    )]
    Opaque,
    /// The header names no boundary.
    #[error("the header multipart/signed names no boundary")]
    NoBoundary,
    /// The end is missing, or there are more than two parts.
    #[error(
        "the signed document is not made of a text and a signature between its boundaries; is it cut off?"
    )]
    CutOff,
    /// The second part is not in base64.
    #[error("the part with the signature is not readable as base64")]
    SignaturePart,
    /// The first part is neither XML nor plain text.
    #[error("the signed part is not plain text; sign it with -text")]
    TextPart,
    /// The signature is malformed.
    #[error("the signature is not readable as a detached PKCS #7 signature")]
    SignedData,
    /// There is no signer.
    #[error("the document has a place for signatures, but none is there")]
    NoSignature,
    /// Another digest than SHA-256; its number.
    #[error("the digest has algorithm {0}, only SHA-256 is supported; sign with -md sha256")]
    Digest(String),
    /// Another algorithm of the signature; its number.
    #[error("the signature has algorithm {0}, only ECDSA with SHA-256 on P-256 is supported, as sros2 signs")]
    Algorithm(String),
    /// The text is not what was signed.
    #[error("the text was changed after it was signed; sign it again")]
    Changed,
    /// The signature names the right certificate, but is not by its key.
    #[error("the signature does not verify with the key of \"{0}\", the permissions authority")]
    Signature(String),
    /// The signature is by the holder of another certificate.
    #[error(
        "the document is signed by somebody else than \"{0}\", the permissions authority; sign it with its key"
    )]
    OtherSigner(String),
}

/// Checks that the key of the permissions authority signed a document, and returns its content with line
/// ends as they are signed (CR LF). Certificates within the document have no influence.
///
/// # Errors
/// If the document is not signed by that key, or in a way that is not supported.
pub fn verify(document: &[u8], ca: &Certificate) -> Result<Vec<u8>, SmimeError> {
    if document.len() > MAX_BYTES {
        return Err(SmimeError::TooLong(document.len()));
    }
    let parts = mime::split(document)?;
    signature::verify(&parts.signature, &parts.text, ca)?;
    mime::content(&parts.text).map(<[u8]>::to_vec)
}

/// Signs a text as `openssl smime -sign -text` does.
pub fn sign(content: &[u8], certificate: &Certificate, key: &PrivateKey, now: SystemTime) -> Vec<u8> {
    let part = mime::text_part(content);
    let signature = signature::sign(&part, certificate, key, now);
    let boundary: String = Sha256::digest(&part).iter().take(16).map(|byte| format!("{byte:02X}")).collect();
    mime::join(&part, &signature, &format!("----{boundary}"))
}

#[cfg(test)]
mod tests;
