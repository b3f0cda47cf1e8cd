//! The hooks for DDS Security: admission before matches, and coding of messages, submessages and payloads.

use bytes::Bytes;

use crate::wire::{EndpointData, Guid, GuidPrefix, Header, ParticipantData};

/// Decides which participants and endpoints are admitted, and protects messages.
///
/// The state machines are independent of it: they only process plain messages of admitted participants. Each
/// returned `bool` is `false` if the bytes are to be dropped.
pub trait Guard: Send {
    /// Called when a participant announces itself, and again after
    /// [`Participant::reconsider`](super::Participant::reconsider).
    fn admit_participant(&mut self, remote: &ParticipantData) -> Admission;

    /// Called before two endpoints match. After [`Admission::Wait`] it is called again in the same way as
    /// above.
    fn admit_endpoint(&mut self, local: &EndpointData, remote: &EndpointData) -> Admission;

    /// Bytes reserved in each datagram for what [`Guard::encode_submessage`] and [`Guard::encode_message`]
    /// add. A datagram that grows by more may be fragmented by IP.
    fn room(&self) -> usize;

    /// Protects a sample of a local writer. The sample is not sent if it returns `None`.
    fn encode_payload(&mut self, writer: Guid, payload: Bytes) -> Option<Bytes>;

    /// The inverse of [`Guard::encode_payload`], for any writer.
    fn decode_payload(&mut self, writer: Guid, payload: Bytes) -> Option<Bytes>;

    /// Appends `submessage`, protected or not, to `out`. `to` is [`GuidPrefix::UNKNOWN`] for all
    /// participants.
    fn encode_submessage(&mut self, to: GuidPrefix, submessage: &[u8], out: &mut Vec<u8>) -> bool;

    /// Appends the plain form of `submessages` to `out`: a whole sequence from its prefix to its postfix, or
    /// a single unprotected submessage. Returns `false` for unprotected submessages that must be protected.
    fn decode_submessage(&mut self, from: GuidPrefix, submessages: &[u8], out: &mut Vec<u8>) -> bool;

    /// Protects a whole datagram.
    fn encode_message(&mut self, to: GuidPrefix, message: &mut Vec<u8>) -> bool;

    /// The inverse of [`Guard::encode_message`].
    fn decode_message(&mut self, from: GuidPrefix, message: &mut Vec<u8>) -> bool;
}

/// A guard's decision about a new participant or endpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Admission {
    Admit,
    /// Not yet: authentication is in progress.
    Wait,
    Refuse,
}

/// Ids of the submessages that enclose a protected one (DDS Security 1.1, section 7.3.6).
const PREFIX: u8 = 0x31;
const POSTFIX: u8 = 0x32;
/// The only submessage that may have length 0 and be followed by others.
const INFO_TIMESTAMP: u8 = 0x09;
const PAD: u8 = 0x01;

/// Protects a datagram that is ready to be sent.
pub(super) fn encode(guard: &mut dyn Guard, to: GuidPrefix, datagram: &mut Vec<u8>) -> bool {
    let clear = std::mem::take(datagram);
    let Some((header, submessages)) = clear.split_at_checked(Header::LEN) else { return false };
    datagram.extend_from_slice(header);
    Raw(submessages).all(|submessage| guard.encode_submessage(to, submessage.bytes, datagram))
        && guard.encode_message(to, datagram)
}

/// The plain form of a datagram that was received.
pub(super) fn decode(guard: &mut dyn Guard, from: GuidPrefix, datagram: &[u8]) -> Option<Vec<u8>> {
    let mut message = datagram.to_vec();
    if !guard.decode_message(from, &mut message) {
        return None;
    }
    let (header, submessages) = message.split_at_checked(Header::LEN)?;
    let mut plain = header.to_vec();
    // A datagram may contain submessages for several receivers: if one is rejected the others are still
    // handled.
    for group in groups(submessages) {
        let length = plain.len();
        if !guard.decode_submessage(from, group, &mut plain) {
            plain.truncate(length);
        }
    }
    Some(plain)
}

/// Splits submessages into protected sequences and single unprotected ones.
fn groups(submessages: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut rest = submessages;
    std::iter::from_fn(move || {
        let mut length = 0;
        let mut is_inside = false;
        for submessage in Raw(rest) {
            length += submessage.bytes.len();
            is_inside = match submessage.id {
                PREFIX => true,
                POSTFIX => false,
                _ => is_inside,
            };
            if !is_inside {
                break;
            }
        }
        let (group, behind) = rest.split_at(length);
        rest = behind;
        (!group.is_empty()).then_some(group)
    })
}

/// Iterates over submessages as bytes with their headers. Ends at the first submessage that exceeds the
/// message.
struct Raw<'a>(&'a [u8]);

struct RawSubmessage<'a> {
    id: u8,
    bytes: &'a [u8],
}

impl<'a> Iterator for Raw<'a> {
    type Item = RawSubmessage<'a>;

    fn next(&mut self) -> Option<Self::Item> {
        let &[id, flags, a, b, ..] = self.0 else { return None };
        let length = if flags & 1 == 1 { u16::from_le_bytes([a, b]) } else { u16::from_be_bytes([a, b]) };
        let whole = match (length, id) {
            (0, PAD | INFO_TIMESTAMP) => 4,
            (0, _) => self.0.len(),
            (length, _) => 4 + usize::from(length),
        };
        let (bytes, rest) = self.0.split_at_checked(whole)?;
        self.0 = rest;
        Some(RawSubmessage { id, bytes })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_protected_sequence_stays_together() {
        let submessages = [
            [0x0e, 1, 4, 0, 9, 9, 9, 9].as_slice(),
            &[0x31, 1, 0, 0x00][..0],
            &[0x31, 1, 4, 0, 1, 1, 1, 1],
            &[0x30, 1, 4, 0, 2, 2, 2, 2],
            &[0x32, 1, 4, 0, 3, 3, 3, 3],
            &[0x09, 3, 0, 0],
            &[0x15, 0, 0, 0, 7, 7],
        ]
        .concat();
        let lengths: Vec<_> = groups(&submessages).map(<[u8]>::len).collect();
        assert_eq!(lengths, [8, 24, 4, 6]);
    }

    #[test]
    fn a_submessage_that_does_not_fit_ends_the_walk() {
        assert_eq!(groups(&[0x15, 1, 200, 0, 1, 2]).count(), 0);
        assert_eq!(groups(&[0x31, 1, 0]).count(), 0);
    }
}
