//! Protected submessages (section 7.3.7): SEC_PREFIX with the header, then SEC_BODY with the encrypted
//! submessage or the readable one, then SEC_POSTFIX with the footer.
//!
//! Fast DDS accepts a SEC_PREFIX of exactly 20 bytes and a SEC_POSTFIX without anything after its MACs.
//! Cyclone requires lengths that are multiples of four.

use super::footer::{CryptoFooter, ReceiverMac, write_footer};
use super::framing::{self, SUBMESSAGE_HEADER_LEN, close, id, write_header};
use super::header::{CryptoHeader, Transform};
use super::{OpenError, Opener, SealError, Sealer};

/// Which key opens a protected submessage. `bytes` begin with its SEC_PREFIX.
///
/// # Errors
/// The bytes do not begin with a valid SEC_PREFIX.
pub fn submessage_transform(bytes: &[u8]) -> Result<Transform, OpenError> {
    parse_prefix(id::SEC_PREFIX, bytes).map(|(header, _)| header.transform)
}

/// The session of the key of a protected submessage.
pub fn submessage_session(bytes: &[u8]) -> Option<[u8; 4]> {
    parse_prefix(id::SEC_PREFIX, bytes).ok().map(|(header, _)| header.session())
}

/// Splits the protected submessage with which `bytes` begin, from SEC_PREFIX to SEC_POSTFIX, from what
/// follows it in the message.
///
/// # Errors
/// The three submessages are not whole.
pub fn split_submessage_group(bytes: &[u8]) -> Result<(&[u8], &[u8]), OpenError> {
    let (_, rest) = parse_prefix(id::SEC_PREFIX, bytes)?;
    let body = framing::first(rest).ok_or(OpenError::Truncated)?;
    let postfix = framing::first(body.rest).ok_or(OpenError::Truncated)?;
    if postfix.id != id::SEC_POSTFIX {
        return Err(OpenError::Structure);
    }
    bytes.split_at_checked(bytes.len() - postfix.rest.len()).ok_or(OpenError::Truncated)
}

impl Sealer {
    /// Protects one submessage and appends the result to `out`, which is unchanged after an error.
    ///
    /// # Errors
    /// The submessage is too long, or `plain` is not exactly one.
    pub fn submessage(&mut self, plain: &[u8], out: &mut Vec<u8>) -> Result<(), SealError> {
        let start = out.len();
        let result = self.append_submessage(plain, out);
        if result.is_err() {
            out.truncate(start);
        }
        result
    }

    fn append_submessage(&mut self, plain: &[u8], out: &mut Vec<u8>) -> Result<(), SealError> {
        let header = self.next(plain.len());
        write_prefix(id::SEC_PREFIX, &header, out);
        write_body_header(&header, plain.len(), out)?;
        let start = out.len();
        out.extend_from_slice(plain);
        let content = out.get_mut(start..).unwrap_or_default();
        if close(content) != Some(1) {
            return Err(SealError::NotSubmessages);
        }
        let mac = self.protect(&header, content)?;
        pad_body(&header, plain.len(), out);
        write_postfix(id::SEC_POSTFIX, &mac, &self.receiver_macs(&header, &mac)?, out)
    }
}

impl Opener {
    /// Checks a protected submessage, from SEC_PREFIX to SEC_POSTFIX, and appends its content to `out`, which
    /// is unchanged after an error.
    ///
    /// The content is whole submessages, but may hold anything that an owner of the key writes, other
    /// protected submessages included.
    ///
    /// # Errors
    /// See [`OpenError`].
    pub fn submessage(&mut self, group: &[u8], out: &mut Vec<u8>) -> Result<(), OpenError> {
        let (header, rest) = parse_prefix(id::SEC_PREFIX, group)?;
        let body = framing::first(rest).ok_or(OpenError::Truncated)?;
        let data = match header.transform.kind.encrypts() {
            true if body.id == id::SEC_BODY => encrypted(body.body)?,
            true => return Err(OpenError::Structure),
            false => rest.get(..SUBMESSAGE_HEADER_LEN + body.body.len()).ok_or(OpenError::Truncated)?,
        };
        let footer = parse_postfix(id::SEC_POSTFIX, body.rest)?;
        let start = out.len();
        self.open(&header, data, &footer, out)?;
        match close(out.get_mut(start..).unwrap_or_default()) {
            Some(1..) => Ok(()),
            _ => {
                out.truncate(start);
                Err(OpenError::Content)
            }
        }
    }
}

pub(super) fn write_prefix(id: u8, header: &CryptoHeader, out: &mut Vec<u8>) {
    write_header(id, CryptoHeader::LEN as u16, out);
    header.write(out);
}

/// Parses a SEC_PREFIX or SRTPS_PREFIX, and returns what follows it too.
pub(super) fn parse_prefix(id: u8, bytes: &[u8]) -> Result<(CryptoHeader, &[u8]), OpenError> {
    let prefix = framing::first(bytes).ok_or(OpenError::Truncated)?;
    if prefix.id != id {
        return Err(OpenError::Structure);
    }
    match CryptoHeader::parse(prefix.body)? {
        (header, []) => Ok((header, prefix.rest)),
        _ => Err(OpenError::Length),
    }
}

/// Appends the header of a SEC_BODY if the key encrypts.
pub(super) fn write_body_header(
    header: &CryptoHeader,
    plain_len: usize,
    out: &mut Vec<u8>,
) -> Result<(), SealError> {
    if header.transform.kind.encrypts() {
        let len = u16::try_from(4 + plain_len.next_multiple_of(4)).map_err(|_| SealError::TooLong)?;
        write_header(id::SEC_BODY, len, out);
        out.extend((plain_len as u32).to_be_bytes());
    }
    Ok(())
}

/// Pads a SEC_BODY to a multiple of four.
pub(super) fn pad_body(header: &CryptoHeader, plain_len: usize, out: &mut Vec<u8>) {
    if header.transform.kind.encrypts() {
        out.resize(out.len() + plain_len.next_multiple_of(4) - plain_len, 0);
    }
}

/// The encrypted bytes in the body of a SEC_BODY.
pub(super) fn encrypted(body: &[u8]) -> Result<&[u8], OpenError> {
    let (len, rest) = body.split_first_chunk().ok_or(OpenError::Truncated)?;
    let (data, padding) =
        rest.split_at_checked(u32::from_be_bytes(*len) as usize).ok_or(OpenError::Length)?;
    match padding {
        [] | [0] | [0, 0] | [0, 0, 0] => Ok(data),
        _ => Err(OpenError::Length),
    }
}

pub(super) fn write_postfix(
    id: u8,
    mac: &super::session::Mac,
    receivers: &[ReceiverMac],
    out: &mut Vec<u8>,
) -> Result<(), SealError> {
    let len = CryptoFooter::MIN_LEN + receivers.len() * ReceiverMac::LEN;
    write_header(id, u16::try_from(len).map_err(|_| SealError::TooLong)?, out);
    write_footer(mac, receivers, out);
    Ok(())
}

/// Parses a SEC_POSTFIX that fills `bytes`, or an SRTPS_POSTFIX. Fast DDS puts statistics behind the latter,
/// which are not protected, and not looked at.
pub(super) fn parse_postfix(kind: u8, bytes: &[u8]) -> Result<CryptoFooter<'_>, OpenError> {
    let postfix = framing::first(bytes).ok_or(OpenError::Truncated)?;
    if postfix.id != kind || kind == id::SEC_POSTFIX && !postfix.rest.is_empty() {
        return Err(OpenError::Structure);
    }
    CryptoFooter::parse(postfix.body)
}
