//! Submessages as bytes: which endpoint sent one, and where its payload is (DDSI-RTPS 2.5, section 9.4.5).

use downbeat_rtps::wire::EntityId;

use crate::cryptography::framing;

const HEADER: usize = 4;
const LITTLE_ENDIAN: u8 = 0x01;
const INLINE_QOS: u8 = 0x02;
/// In DATA: there is a payload, a sample or a key.
const DATA_OR_KEY: u8 = 0x0c;
const SENTINEL: u16 = 1;

mod id {
    pub(super) const ACK_NACK: u8 = 0x06;
    pub(super) const HEARTBEAT: u8 = 0x07;
    pub(super) const GAP: u8 = 0x08;
    pub(super) const INFO_TIMESTAMP: u8 = 0x09;
    pub(super) const INFO_SOURCE: u8 = 0x0c;
    pub(super) const INFO_DESTINATION: u8 = 0x0e;
    pub(super) const NACK_FRAGMENT: u8 = 0x12;
    pub(super) const HEARTBEAT_FRAGMENT: u8 = 0x13;
    pub(super) const DATA: u8 = 0x15;
    pub(super) const DATA_FRAGMENT: u8 = 0x16;
    pub(super) const SEC_PREFIX: u8 = 0x31;
}

/// What a submessage is to the protection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Of a writer or a reader of the sending participant.
    Of(EntityId),
    /// A timestamp or a destination of what follows.
    Info,
    /// A source of what follows.
    Source,
    /// The beginning of a protected one.
    Protected,
    /// Anything else, which the engine skips.
    Other,
}

/// A submessage with its header.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame<'a>(pub(super) &'a [u8]);

/// Splits the first submessage off; `None` if it is not whole.
pub(super) fn split(bytes: &[u8]) -> Option<(Frame<'_>, &[u8])> {
    let rest = framing::first(bytes)?.rest;
    let (frame, rest) = bytes.split_at_checked(bytes.len() - rest.len())?;
    Some((Frame(frame), rest))
}

impl<'a> Frame<'a> {
    fn id(self) -> u8 {
        self.0.first().copied().unwrap_or_default()
    }

    fn flags(self) -> u8 {
        self.0.get(1).copied().unwrap_or_default()
    }

    pub(super) fn kind(self) -> Kind {
        let entity_at = |at: usize| {
            let bytes = self.0.get(HEADER + at..).and_then(|rest| rest.first_chunk());
            bytes.map_or(Kind::Other, |bytes| Kind::Of(EntityId(*bytes)))
        };
        match self.id() {
            // Readers come first in all of them.
            id::ACK_NACK | id::NACK_FRAGMENT => entity_at(0),
            id::HEARTBEAT | id::GAP | id::HEARTBEAT_FRAGMENT => entity_at(4),
            id::DATA | id::DATA_FRAGMENT => entity_at(8),
            id::INFO_TIMESTAMP | id::INFO_DESTINATION => Kind::Info,
            id::INFO_SOURCE => Kind::Source,
            id::SEC_PREFIX => Kind::Protected,
            _ => Kind::Other,
        }
    }

    /// Whether it is a timestamp, which Fast DDS protects like the sample that follows.
    pub(super) fn is_timestamp(self) -> bool {
        self.id() == id::INFO_TIMESTAMP
    }

    fn u16_at(self, at: usize) -> Option<u16> {
        let bytes = *self.0.get(at..)?.first_chunk()?;
        Some(match self.flags() & LITTLE_ENDIAN {
            0 => u16::from_be_bytes(bytes),
            _ => u16::from_le_bytes(bytes),
        })
    }

    /// Splits DATA and DATA_FRAG in front of the payload; `None` if it has none.
    pub(super) fn split_payload(self) -> Option<(&'a [u8], &'a [u8])> {
        let has_payload = match self.id() {
            id::DATA => self.flags() & DATA_OR_KEY != 0,
            id::DATA_FRAGMENT => true,
            _ => false,
        };
        if !has_payload {
            return None;
        }
        // The offset counts from behind itself.
        let mut at = HEADER + 4 + usize::from(self.u16_at(HEADER + 2)?);
        if self.flags() & INLINE_QOS != 0 {
            loop {
                let (id, length) = (self.u16_at(at)?, self.u16_at(at + 2)?);
                at += 4;
                if id == SENTINEL {
                    break;
                }
                at += usize::from(length);
            }
        }
        self.0.split_at_checked(at)
    }

    /// Appends the submessage with another payload in place of its own, of which `front` is what precedes it.
    /// Returns `None` if it is too long.
    pub(super) fn append_with_payload(self, front: &[u8], payload: &[u8], out: &mut Vec<u8>) -> Option<()> {
        let [id, flags, _, _, rest @ ..] = front else { return None };
        let length = u16::try_from(rest.len() + payload.len()).ok()?;
        let length = if flags & LITTLE_ENDIAN == 0 { length.to_be_bytes() } else { length.to_le_bytes() };
        out.extend([*id, *flags, length[0], length[1]]);
        out.extend_from_slice(rest);
        out.extend_from_slice(payload);
        Some(())
    }
}
