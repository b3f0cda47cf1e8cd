//! What sockets of our own say and hear beside rustdds: parts of RTPS messages (RTPS 2.5, 9.4), and the ports of a domain
//! (9.6.2.4).

use crate::middleware::Gid;
use bytes::BufMut;

/// Flags of submessages.
pub(super) const LITTLE_ENDIAN: u8 = 0x01;
pub(super) const INLINE_QOS: u8 = 0x02;

const PID_SENTINEL: u16 = 0x0001;

/// The beginning of a message in the name of a participant, to be followed by submessages.
pub(super) fn message_of(participant: Gid) -> Vec<u8> {
    let mut message = Vec::with_capacity(512);
    message.put_slice(b"RTPS\x02\x04");
    message.put_slice(&participant.vendor());
    message.put_slice(&participant.participant());
    message
}

pub(super) fn submessage(message: &mut Vec<u8>, kind: u8, flags: u8, body: &[u8]) {
    message.put_u8(kind);
    message.put_u8(flags);
    message.put_u16_le(body.len() as u16);
    message.put_slice(body);
}

pub(super) fn sequence_number(body: &mut Vec<u8>, number: i64) {
    body.put_i32_le((number >> 32) as i32);
    body.put_u32_le(number as u32);
}

pub(super) fn parameter(body: &mut Vec<u8>, id: u16, value: &[u8]) {
    body.put_u16_le(id);
    body.put_u16_le(value.len() as u16);
    body.put_slice(value);
}

pub(super) fn end_of_parameters(body: &mut Vec<u8>) {
    parameter(body, PID_SENTINEL, &[]);
}

/// The participant in the header of an RTPS message: `RTPS`, version and vendor of two bytes each, then its prefix.
pub(super) fn sender_of(packet: &[u8]) -> Option<[u8; 12]> {
    packet.strip_prefix(b"RTPS")?.get(4..16)?.try_into().ok()
}

/// To which announcements are multicast.
pub(super) fn multicast_port(domain_id: u16) -> u16 {
    7400 + 250 * domain_id
}

/// At which the first so many participants of a host hear announcements; in the last domain there are not ports for all.
pub(super) fn unicast_ports(domain_id: u16, participants: u16) -> impl Iterator<Item = u16> {
    let base = multicast_port(domain_id);
    (0..participants).map_while(move |participant| base.checked_add(10 + 2 * participant))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sender_of_a_message_stands_in_its_header() {
        let packet = b"RTPS\x02\x03\x01\x0fabcdefghijkl and more";
        assert_eq!(sender_of(packet), Some(*b"abcdefghijkl"));
        assert_eq!(sender_of(&packet[..19]), None);
        assert_eq!(sender_of(b"SOME\x02\x03\x01\x0fabcdefghijkl"), None);
    }

    #[test]
    fn the_last_domain_has_fewer_ports() {
        let last = |domain_id: u16| unicast_ports(domain_id, 120).last();
        assert_eq!((last(0), last(231), last(232)), (Some(7648), Some(65398), Some(65534)));
    }
}
