//! Protected payloads (sections 9.5.3.3.4.4 and 9.5.3.3.5): header, content with its length if encrypted,
//! footer.
//!
//! Fast DDS, Cyclone DDS and RustDDS protect each fragment of a large sample by itself, so a payload may be
//! any bytes, without encapsulation.
//!
//! The specification does not say whether the footer is aligned. Fast DDS aligns the number of MACs to four
//! bytes, Cyclone DDS and RustDDS do not. So a payload is padded before it is encrypted, as a plain one is on
//! its way into a submessage, and up to three more zeros are accepted after the MAC.

use super::footer::{CryptoFooter, write_footer};
use super::header::{CryptoHeader, Transform};
use super::{OpenError, Opener, SealError, Sealer};

/// Which key opens a protected payload.
///
/// # Errors
/// The bytes do not begin with a valid header.
pub fn payload_transform(payload: &[u8]) -> Result<Transform, OpenError> {
    CryptoHeader::parse(payload).map(|(header, _)| header.transform)
}

impl Sealer {
    /// Protects the payload of a DATA or DATA_FRAG. A payload whose length is not a multiple of four is
    /// padded with zeros; the encapsulation of a sample declares them already.
    ///
    /// # Errors
    /// The payload is longer than 4 GiB.
    pub fn payload(&mut self, payload: &[u8]) -> Result<Vec<u8>, SealError> {
        let padded = payload.len().next_multiple_of(4);
        let header = self.next(padded);
        let mut out = Vec::with_capacity(CryptoHeader::LEN + 4 + padded + CryptoFooter::MIN_LEN);
        header.write(&mut out);
        if header.transform.kind.encrypts() {
            out.extend(u32::try_from(padded).map_err(|_| SealError::TooLong)?.to_be_bytes());
        }
        let start = out.len();
        out.extend_from_slice(payload);
        out.resize(start + padded, 0);
        let content = out.get_mut(start..).unwrap_or_default();
        let mac = self.protect(&header, content)?;
        write_footer(&mac, &[], &mut out);
        Ok(out)
    }
}

impl Opener {
    /// Checks a protected payload and returns its content, with its padding.
    ///
    /// # Errors
    /// See [`OpenError`].
    pub fn payload(&mut self, payload: &[u8]) -> Result<Vec<u8>, OpenError> {
        let (header, rest) = CryptoHeader::parse(payload)?;
        let mut out = Vec::new();
        if header.transform.kind.encrypts() {
            let (len, rest) = rest.split_first_chunk().ok_or(OpenError::Truncated)?;
            let len = u32::from_be_bytes(*len) as usize;
            let (content, footer) = rest.split_at_checked(len).ok_or(OpenError::Length)?;
            self.open(&header, content, &parse_footer(footer)?, &mut out)?;
            return Ok(out);
        }
        // Nothing tells how long readable content is, so only its MAC tells padding from a footer.
        let mut result = Err(OpenError::Truncated);
        for footer_len in CryptoFooter::MIN_LEN..=CryptoFooter::MIN_LEN + MAX_PADDING {
            let Some(len) = rest.len().checked_sub(footer_len) else { break };
            let (content, footer) = rest.split_at(len);
            match parse_footer(footer) {
                Ok(footer) => result = self.open(&header, content, &footer, &mut out),
                Err(_) if result == Err(OpenError::Forged) => break,
                Err(error) => return Err(error),
            }
            if result != Err(OpenError::Forged) {
                break;
            }
        }
        result.map(|()| out)
    }
}

/// Bytes of zeros between the MAC and the number of MACs, or behind it.
const MAX_PADDING: usize = 3;

fn parse_footer(bytes: &[u8]) -> Result<CryptoFooter<'_>, OpenError> {
    let (mac, count) = bytes.split_first_chunk().ok_or(OpenError::Truncated)?;
    match count.len() {
        ..4 => Err(OpenError::Truncated),
        len if len <= 4 + MAX_PADDING && count.iter().all(|byte| *byte == 0) => {
            Ok(CryptoFooter::common(*mac))
        }
        _ => Err(OpenError::Length),
    }
}
