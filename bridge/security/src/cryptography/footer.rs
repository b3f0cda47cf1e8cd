//! What follows protected data (section 9.5.2.5).

use super::OpenError;
use super::material::KeyId;
use super::session::Mac;

/// The MACs of protected data.
pub(super) struct CryptoFooter<'a> {
    pub(super) common: Mac,
    /// Of the receivers with a key of their own: [`ReceiverMac::LEN`] bytes each.
    receivers: &'a [u8],
}

/// A MAC over the common MAC with the key of one receiver.
pub(super) struct ReceiverMac {
    pub(super) key: KeyId,
    pub(super) mac: Mac,
}

impl ReceiverMac {
    pub(super) const LEN: usize = 20;
}

impl<'a> CryptoFooter<'a> {
    /// Bytes without MACs of receivers.
    pub(super) const MIN_LEN: usize = 20;

    /// A footer without MACs of receivers.
    pub(super) fn common(common: Mac) -> Self {
        Self { common, receivers: &[] }
    }

    /// Parses a footer that fills `bytes`.
    pub(super) fn parse(bytes: &'a [u8]) -> Result<Self, OpenError> {
        let (common, rest) = bytes.split_first_chunk().ok_or(OpenError::Truncated)?;
        let (count, receivers) = rest.split_first_chunk().ok_or(OpenError::Truncated)?;
        let count = u32::from_be_bytes(*count) as usize;
        if count.checked_mul(ReceiverMac::LEN) != Some(receivers.len()) {
            return Err(OpenError::Length);
        }
        Ok(Self { common: *common, receivers })
    }

    /// The MAC for the receiver with this key.
    pub(super) fn receiver(&self, key: KeyId) -> Option<Mac> {
        self.receivers
            .chunks_exact(ReceiverMac::LEN)
            .filter_map(<[u8]>::split_first_chunk)
            .find(|(id, _)| KeyId(**id) == key)
            .and_then(|(_, mac)| mac.try_into().ok())
    }
}

/// Appends a footer.
pub(super) fn write_footer(common: &Mac, receivers: &[ReceiverMac], out: &mut Vec<u8>) {
    out.extend(common);
    out.extend((receivers.len() as u32).to_be_bytes());
    for receiver in receivers {
        out.extend(receiver.key.0);
        out.extend(receiver.mac);
    }
}
