//! Protected messages (section 7.3.7): the header of the message, SRTPS_PREFIX, then SEC_BODY with the
//! encrypted submessages or the readable ones, then SRTPS_POSTFIX. The first of the protected submessages
//! is an INFO_SRC that repeats the header, since nothing else protects the header.

use super::framing::{self, SUBMESSAGE_HEADER_LEN, close, id, write_header};
use super::header::Transform;
use super::submessage::{
    encrypted, pad_body, parse_postfix, parse_prefix, write_body_header, write_postfix, write_prefix,
};
use super::{OpenError, Opener, SealError, Sealer};

/// Bytes of the header of an RTPS message: `RTPS`, then what INFO_SRC repeats.
const HEADER_LEN: usize = 20;
/// Bytes of an INFO_SRC without the header of the submessage: four unused bytes, then version, vendor and
/// GUID prefix as in the header of the message.
const INFO_SOURCE_LEN: usize = 20;

/// Which key opens a protected message; `None` if the message is not protected as a whole.
///
/// # Errors
/// The message is too short, or its SRTPS_PREFIX is malformed.
pub fn message_transform(datagram: &[u8]) -> Result<Option<Transform>, OpenError> {
    let rest = datagram.get(HEADER_LEN..).ok_or(OpenError::Truncated)?;
    match rest.first() {
        Some(&id::SRTPS_PREFIX) => {
            parse_prefix(id::SRTPS_PREFIX, rest).map(|(header, _)| Some(header.transform))
        }
        _ => Ok(None),
    }
}

impl Sealer {
    /// Protects a whole RTPS message in place. After an error its content is unspecified.
    ///
    /// # Errors
    /// The message is too long, or is not one.
    pub fn message(&mut self, datagram: &mut Vec<u8>) -> Result<(), SealError> {
        let [b'R', b'T', b'P', b'S', source @ ..] =
            *datagram.first_chunk::<HEADER_LEN>().ok_or(SealError::NotSubmessages)?
        else {
            return Err(SealError::NotSubmessages);
        };
        close(datagram.get_mut(HEADER_LEN..).unwrap_or_default()).ok_or(SealError::NotSubmessages)?;
        let plain_len = SUBMESSAGE_HEADER_LEN + INFO_SOURCE_LEN + datagram.len() - HEADER_LEN;
        let header = self.next(plain_len);
        let mut front = Vec::with_capacity(64);
        write_prefix(id::SRTPS_PREFIX, &header, &mut front);
        write_body_header(&header, plain_len, &mut front)?;
        let start = HEADER_LEN + front.len();
        write_header(id::INFO_SOURCE, INFO_SOURCE_LEN as u16, &mut front);
        front.extend([0; 4]);
        front.extend(source);
        datagram.splice(HEADER_LEN..HEADER_LEN, front);
        let mac = self.protect(&header, datagram.get_mut(start..).unwrap_or_default())?;
        pad_body(&header, plain_len, datagram);
        write_postfix(id::SRTPS_POSTFIX, &mac, &self.receiver_macs(&header, &mac)?, datagram)
    }
}

impl Opener {
    /// Checks a protected message and returns the message that was sealed.
    ///
    /// # Errors
    /// See [`OpenError`].
    pub fn message(&mut self, datagram: &[u8]) -> Result<Vec<u8>, OpenError> {
        let (message_header, rest) =
            datagram.split_first_chunk::<HEADER_LEN>().ok_or(OpenError::Truncated)?;
        let [b'R', b'T', b'P', b'S', source @ ..] = message_header else {
            return Err(OpenError::Structure);
        };
        let (header, rest) = parse_prefix(id::SRTPS_PREFIX, rest)?;
        let (data, postfix) = if header.transform.kind.encrypts() {
            let body = framing::first(rest).ok_or(OpenError::Truncated)?;
            if body.id != id::SEC_BODY {
                return Err(OpenError::Structure);
            }
            (encrypted(body.body)?, body.rest)
        } else {
            split_before_postfix(rest)?
        };
        let footer = parse_postfix(id::SRTPS_POSTFIX, postfix)?;
        let mut out = Vec::with_capacity(HEADER_LEN + data.len());
        out.extend_from_slice(message_header);
        self.open(&header, data, &footer, &mut out)?;
        let content = out.get_mut(HEADER_LEN..).unwrap_or_default();
        close(content).ok_or(OpenError::Content)?;
        let info_source = framing::first(content).ok_or(OpenError::Content)?;
        if info_source.id != id::INFO_SOURCE || info_source.body.get(4..) != Some(&source[..]) {
            return Err(OpenError::Source);
        }
        out.drain(HEADER_LEN..HEADER_LEN + SUBMESSAGE_HEADER_LEN + INFO_SOURCE_LEN);
        Ok(out)
    }
}

/// Splits readable submessages from the SRTPS_POSTFIX that follows them.
fn split_before_postfix(bytes: &[u8]) -> Result<(&[u8], &[u8]), OpenError> {
    let mut rest = bytes;
    while !rest.is_empty() {
        let submessage = framing::first(rest).ok_or(OpenError::Truncated)?;
        if submessage.id == id::SRTPS_POSTFIX {
            return bytes.split_at_checked(bytes.len() - rest.len()).ok_or(OpenError::Truncated);
        }
        rest = submessage.rest;
    }
    Err(OpenError::Structure)
}
