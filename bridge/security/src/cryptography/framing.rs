//! Submessages as bytes: where each begins and ends (DDSI-RTPS 2.5, section 9.4.5.1).

/// Kinds of submessages.
pub(super) mod id {
    pub(in super::super) const SEC_BODY: u8 = 0x30;
    pub(in super::super) const SEC_PREFIX: u8 = 0x31;
    pub(in super::super) const SEC_POSTFIX: u8 = 0x32;
    pub(in super::super) const SRTPS_PREFIX: u8 = 0x33;
    pub(in super::super) const SRTPS_POSTFIX: u8 = 0x34;
    pub(in super::super) const INFO_SOURCE: u8 = 0x0c;
    const PAD: u8 = 0x01;
    const INFO_TIMESTAMP: u8 = 0x09;
    /// Of all other kinds, a length of zero means that the submessage lasts to the end of the message.
    pub(super) const MAY_BE_EMPTY: [u8; 2] = [PAD, INFO_TIMESTAMP];
}

pub(super) const SUBMESSAGE_HEADER_LEN: usize = 4;
const LITTLE_ENDIAN: u8 = 1;

/// The first submessage of some bytes.
pub(crate) struct First<'a> {
    pub(crate) id: u8,
    /// Without its header.
    pub(crate) body: &'a [u8],
    /// What follows the submessage.
    pub(crate) rest: &'a [u8],
}

/// Splits the first submessage off; `None` if it is not whole.
pub(crate) fn first(bytes: &[u8]) -> Option<First<'_>> {
    let ([id, flags, length @ ..], content) = bytes.split_first_chunk::<SUBMESSAGE_HEADER_LEN>()?;
    let length = match flags & LITTLE_ENDIAN {
        0 => u16::from_be_bytes(*length),
        _ => u16::from_le_bytes(*length),
    };
    let (body, rest) = match length {
        0 if !id::MAY_BE_EMPTY.contains(id) => (content, &[][..]),
        length => content.split_at_checked(length.into())?,
    };
    Some(First { id: *id, body, rest })
}

/// Appends the header of a submessage.
pub(super) fn write_header(id: u8, length: u16, out: &mut Vec<u8>) {
    out.extend([id, LITTLE_ENDIAN]);
    out.extend(length.to_le_bytes());
}

/// Writes the length of the last submessage where its header leaves it open, so that others can follow.
/// Returns the number of submessages; `None` if `bytes` are not whole submessages, or the last is too long.
pub(super) fn close(bytes: &mut [u8]) -> Option<usize> {
    let (mut count, mut at) = (0, 0);
    while let Some(rest) = bytes.get(at..).filter(|rest| !rest.is_empty()) {
        let len = SUBMESSAGE_HEADER_LEN + first(rest)?.body.len();
        let [_, flags, length @ ..] = bytes.get_mut(at..)?.first_chunk_mut::<SUBMESSAGE_HEADER_LEN>()?;
        let body_len = u16::try_from(len - SUBMESSAGE_HEADER_LEN).ok()?;
        *length = match *flags & LITTLE_ENDIAN {
            0 => body_len.to_be_bytes(),
            _ => body_len.to_le_bytes(),
        };
        count += 1;
        at += len;
    }
    Some(count)
}
