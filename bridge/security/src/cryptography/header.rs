//! What stands in front of protected data (section 9.5.2.3).

use super::OpenError;
use super::material::{KeyId, TransformKind};
use super::session::{InitializationVector, SessionId};

/// Names the key that protects some data.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Transform {
    /// What the key does.
    pub kind: TransformKind,
    /// The key, among those of the sending participant.
    pub key: KeyId,
}

#[derive(Clone, Copy)]
pub(super) struct CryptoHeader {
    pub(super) transform: Transform,
    pub(super) iv: InitializationVector,
}

impl CryptoHeader {
    pub(super) const LEN: usize = 20;

    /// Splits the header off the front of `bytes`.
    pub(super) fn parse(bytes: &[u8]) -> Result<(Self, &[u8]), OpenError> {
        let (kind, rest) = bytes.split_first_chunk().ok_or(OpenError::Truncated)?;
        let (key, rest) = rest.split_first_chunk().ok_or(OpenError::Truncated)?;
        let (iv, rest) = rest.split_first_chunk().ok_or(OpenError::Truncated)?;
        let kind =
            TransformKind::from_bytes(*kind).ok_or(OpenError::UnknownKind(u32::from_be_bytes(*kind)))?;
        Ok((Self { transform: Transform { kind, key: KeyId(*key) }, iv: *iv }, rest))
    }

    pub(super) fn write(&self, out: &mut Vec<u8>) {
        out.extend(self.transform.kind.to_bytes());
        out.extend(self.transform.key.0);
        out.extend(self.iv);
    }

    pub(super) fn session(&self) -> SessionId {
        let [a, b, c, d, ..] = self.iv;
        [a, b, c, d]
    }
}
