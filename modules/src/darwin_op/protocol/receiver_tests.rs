#![allow(clippy::unwrap_used)]

use super::super::{Id, Status, StatusError};
use super::*;
use proptest::prelude::*;

fn status(id: u8, parameters: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    Status { id: Id::new(id).unwrap(), error: StatusError::NONE, parameters }.emit(&mut out);
    out
}

fn all(receiver: &mut Receiver) -> Vec<Vec<u8>> {
    let mut packets = Vec::new();
    while let Some(packet) = receiver.next_packet() {
        packets.push(packet.as_bytes().to_vec());
    }
    packets
}

#[test]
fn a_packet_is_found_however_it_is_fragmented() {
    let bytes = [status(1, &[0xFF, 0xFF]), status(2, &[0xFF]), status(3, &[])].concat();
    for cut in 0..=bytes.len() {
        let mut receiver = Receiver::new();
        receiver.push(&bytes[..cut]);
        let mut packets = all(&mut receiver);
        receiver.push(&bytes[cut..]);
        packets.extend(all(&mut receiver));
        assert_eq!(packets.concat(), bytes, "cut at {cut}");
        assert_eq!(receiver.dropped(), 0);
    }
}

#[test]
fn a_partial_packet_is_kept_until_its_end_arrives() {
    let bytes = status(7, &[1, 2, 3]);
    let mut receiver = Receiver::new();
    receiver.push(&bytes[..6]);
    assert_eq!(receiver.next_packet(), None);
    assert_eq!(receiver.pending(), &bytes[..6]);
    receiver.push(&bytes[6..]);
    assert_eq!(receiver.next_packet().unwrap().id().raw(), 7);
}

#[test]
fn a_bad_checksum_costs_only_its_own_packet() {
    let mut bytes = [status(1, &[1, 2]), status(2, &[3, 4])].concat();
    bytes[5] ^= 0x10;
    let mut receiver = Receiver::new();
    receiver.push(&bytes);
    assert_eq!(all(&mut receiver), [status(2, &[3, 4])]);
    assert_eq!(receiver.corrupt(), 1);
    assert_eq!(receiver.dropped(), 8);
}

#[test]
fn a_corrupt_length_does_not_swallow_what_follows_once_the_stream_has_ended() {
    let mut bytes = [status(1, &[1, 2]), status(2, &[3, 4])].concat();
    bytes[3] = 200;
    let mut receiver = Receiver::new();
    receiver.push(&bytes);
    assert_eq!(receiver.next_packet(), None);
    receiver.end();
    assert_eq!(all(&mut receiver), [status(2, &[3, 4])]);
}

#[test]
fn an_impossible_length_is_not_waited_for() {
    let mut bytes = [status(1, &[1, 2]), status(2, &[3, 4])].concat();
    bytes[3] = 200;
    let mut receiver = Receiver::with_longest(8);
    receiver.push(&bytes);
    assert_eq!(all(&mut receiver), [status(2, &[3, 4])]);
}

#[test]
fn a_header_byte_too_many_is_dropped() {
    let mut receiver = Receiver::new();
    receiver.push(&[&[0xFF][..], &status(4, &[9])].concat());
    assert_eq!(all(&mut receiver), [status(4, &[9])]);
    assert_eq!(receiver.dropped(), 1);
}

proptest! {
    #[test]
    fn any_garbage_in_any_pieces_is_handled(
        pieces in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..40), 0..12),
    ) {
        let mut receiver = Receiver::new();
        let mut found = 0;
        for piece in &pieces {
            receiver.push(piece);
            found += all(&mut receiver).concat().len() as u64;
        }
        receiver.end();
        found += all(&mut receiver).concat().len() as u64;
        // No byte is lost or counted twice.
        let pushed: usize = pieces.iter().map(Vec::len).sum();
        prop_assert_eq!(found + receiver.dropped(), pushed as u64);
        prop_assert!(receiver.pending().is_empty());
    }

    #[test]
    fn a_valid_packet_after_garbage_is_found(
        // Without FF, so that the garbage cannot start a packet.
        garbage in proptest::collection::vec(0..0xFF_u8, 0..60),
        id in 0..=253_u8,
        parameters in proptest::collection::vec(any::<u8>(), 0..60),
        cut: proptest::sample::Index,
    ) {
        let packet = status(id, &parameters);
        let bytes = [garbage, packet.clone()].concat();
        let cut = cut.index(bytes.len());
        let mut receiver = Receiver::new();
        receiver.push(&bytes[..cut]);
        prop_assert_eq!(receiver.next_packet(), None);
        receiver.push(&bytes[cut..]);
        prop_assert_eq!(all(&mut receiver), vec![packet]);
    }

    #[test]
    fn a_valid_packet_after_anything_is_found_once_the_stream_has_ended(
        garbage in proptest::collection::vec(prop_oneof![Just(0xFF_u8), any::<u8>()], 0..60),
        id in 0..=253_u8,
    ) {
        // The garbage may end in a header whose packet includes the first bytes of ours and has a matching
        // checksum, which is indistinguishable from a valid one. It is rare enough to skip.
        let packet = status(id, &[1, 2, 3]);
        let mut receiver = Receiver::new();
        receiver.push(&[garbage, packet.clone()].concat());
        receiver.end();
        let packets = all(&mut receiver);
        let swallowed = packets.iter().any(|found| found.windows(2).skip(2).any(|pair| pair == HEADER));
        prop_assert!(packets.contains(&packet) || swallowed);
    }
}
