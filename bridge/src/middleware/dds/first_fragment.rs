//! The first fragment of a large reply, written by hand.
//!
//! rustdds 0.15.1 spoils the inline quality of service of every sample that it fragments: `write_to` in
//! `messages/submessages/data_frag.rs` puts the tag of an `Option` in front of the parameter list, so that a peer drops
//! the fragment (and with debug assertions the event loop of rustdds panics). It fragments what does not fit into a packet of
//! the network, on Ethernet 1500 bytes. So a large reply leaves rustdds without its related sample identity, and
//! the reader is sent the first of its fragments before, with it: Fast DDS takes what a sample is from the fragment that comes
//! first, and the rest, repairs too, from rustdds.

use super::rtps::{
    INLINE_QOS, LITTLE_ENDIAN, end_of_parameters, message_of, parameter, sequence_number, submessage,
};
use crate::middleware::{Gid, SampleIdentity};
use bytes::BufMut;
use rustdds::{DomainParticipant, GUID};
use std::io;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// `FRAGMENT_SIZE` in `rtps/constant.rs` of rustdds, the same for all samples of a writer.
const FRAGMENT: usize = 256;
/// What of a payload its first fragment holds besides the encapsulation header.
const ENCAPSULATION: [u8; 4] = [0x00, 0x01, 0x00, 0x00];

const INFO_TS: u8 = 0x09;
const INFO_DST: u8 = 0x0e;
const DATA_FRAG: u8 = 0x16;

/// `PID_RELATED_SAMPLE_IDENTITY` of DDS-RPC, and what Fast DDS 2 says instead.
const PID_RELATED_SAMPLE_IDENTITY: [u16; 2] = [0x0083, 0x800f];

/// What rustdds leaves of a packet for the payload: 48 bytes of headers, 32 of a heartbeat, 48 of the submessage
/// (`rtps/constant.rs`, `max_unfragmented_serialized_payload` in `rtps/writer.rs`).
const OVERHEAD: usize = 48 + 32 + 48;
/// What rustdds takes for the packets of a network that it does not know.
const ETHERNET: usize = 1500;
/// Packets of a reader that is on this machine only.
const LOOPBACK: usize = 65536;

/// Sends first fragments; one for each participant.
pub(super) struct FirstFragments {
    socket: UdpSocket,
    sizes: PayloadSizes,
}

/// Which payloads rustdds sends whole, and which it fragments: by the packets of the interfaces, as it chooses by reader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PayloadSizes {
    /// Up to here none is fragmented.
    pub(super) whole: usize,
    /// From here all are.
    pub(super) fragmented: usize,
}

impl PayloadSizes {
    fn of_packets(packets: impl Iterator<Item = usize>) -> Self {
        let (smallest, largest) = packets
            .fold((ETHERNET, ETHERNET), |(smallest, largest), size| (smallest.min(size), largest.max(size)));
        Self { whole: smallest.saturating_sub(OVERHEAD), fragmented: largest.saturating_sub(OVERHEAD) + 1 }
    }

    /// By `/sys/class/net`; where there is none, those of an Ethernet.
    fn of_this_machine() -> Self {
        let interfaces = std::fs::read_dir("/sys/class/net").into_iter().flatten().flatten();
        let read =
            |interface: &Path| std::fs::read_to_string(interface.join("mtu")).ok()?.trim().parse().ok();
        let packets = interfaces.filter(|interface| interface.file_name() != "lo");
        Self::of_packets(packets.filter_map(|interface| read(&interface.path())))
    }
}

/// Where a reader listens.
pub(super) struct Addresses(Vec<SocketAddr>);

/// A sample that rustdds is about to write.
pub(super) struct LargeSample<'a> {
    pub(super) writer: Gid,
    pub(super) reader: Gid,
    pub(super) number: i64,
    pub(super) related: SampleIdentity,
    /// Without the encapsulation header.
    pub(super) body: &'a [u8],
}

impl FirstFragments {
    pub(super) fn new() -> io::Result<Self> {
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        socket.set_nonblocking(true)?;
        Ok(Self { socket, sizes: PayloadSizes::of_this_machine() })
    }

    /// What is sent whole to every reader.
    pub(super) fn sizes(&self) -> PayloadSizes {
        self.sizes
    }

    /// The same of one reader.
    pub(super) fn sizes_to(&self, addresses: &Addresses) -> PayloadSizes {
        if addresses.0.iter().all(|address| address.ip().is_loopback()) {
            return PayloadSizes { whole: LOOPBACK - OVERHEAD, fragmented: LOOPBACK - OVERHEAD + 1 };
        }
        self.sizes
    }

    /// Sends the first fragment to wherever the reader listens; false when it could not be sent.
    pub(super) fn send(&self, addresses: &Addresses, sample: &LargeSample<'_>) -> bool {
        let message = sample.first_fragment();
        let Addresses(addresses) = addresses;
        // Twice, since a lost one is not repaired; the reader drops what it has.
        let sent = addresses.iter().chain(addresses).filter(|to| self.socket.send_to(&message, to).is_ok());
        sent.count() > 0
    }
}

impl Addresses {
    pub(super) fn of(participant: &DomainParticipant, reader: Gid) -> Self {
        let reader = GUID::from_bytes(reader.0);
        let found = participant
            .discovered_readers()
            .into_iter()
            .find(|found| found.reader_proxy.remote_reader_guid == reader);
        let locators = found.map(|found| found.reader_proxy.unicast_locator_list).unwrap_or_default();
        let addresses = locators.into_iter().filter(|locator| locator.is_udp()).map(SocketAddr::from);
        Self(addresses.filter(SocketAddr::is_ipv4).collect())
    }
}

impl LargeSample<'_> {
    /// An RTPS message (RTPS 2.5, 9.4) with one fragment of 256 bytes; nothing is fragmented that is shorter.
    fn first_fragment(&self) -> Vec<u8> {
        let mut message = message_of(self.writer);
        submessage(&mut message, INFO_DST, LITTLE_ENDIAN, &self.reader.participant());
        submessage(&mut message, INFO_TS, LITTLE_ENDIAN, &timestamp());
        submessage(&mut message, DATA_FRAG, LITTLE_ENDIAN | INLINE_QOS, &self.data_frag());
        message
    }

    fn data_frag(&self) -> Vec<u8> {
        let mut body = Vec::with_capacity(FRAGMENT + 96);
        body.put_u16_le(0); // extra flags
        body.put_u16_le(28); // from here to the inline quality of service
        body.put_slice(&self.reader.0[12..]);
        body.put_slice(&self.writer.0[12..]);
        sequence_number(&mut body, self.number);
        body.put_u32_le(1); // number of the first fragment
        body.put_u16_le(1); // fragments
        body.put_u16_le(FRAGMENT as u16);
        body.put_u32_le((ENCAPSULATION.len() + self.body.len()) as u32);
        let mut related = self.related.endpoint.0.to_vec();
        sequence_number(&mut related, self.related.number);
        for id in PID_RELATED_SAMPLE_IDENTITY {
            parameter(&mut body, id, &related);
        }
        end_of_parameters(&mut body);
        body.put_slice(&ENCAPSULATION);
        body.extend(self.body.iter().take(FRAGMENT - ENCAPSULATION.len()));
        body
    }
}

/// Seconds, and fractions of 2^-32.
fn timestamp() -> [u8; 8] {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let fraction = (u64::from(now.subsec_nanos()) << 32) / 1_000_000_000;
    let mut bytes = [0; 8];
    bytes[..4].copy_from_slice(&(now.as_secs() as u32).to_le_bytes());
    bytes[4..].copy_from_slice(&(fraction as u32).to_le_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_whole_goes_into_the_smallest_packet_and_what_is_fragmented_into_none() {
        let sizes = |packets: &[usize]| PayloadSizes::of_packets(packets.iter().copied());
        assert_eq!(sizes(&[]), PayloadSizes { whole: 1372, fragmented: 1373 });
        assert_eq!(sizes(&[1400, 9000]), PayloadSizes { whole: 1272, fragmented: 8873 });
    }

    #[test]
    fn a_first_fragment_is_a_message_of_three_submessages() {
        let (writer, reader) = (Gid([1; 16]), Gid([2; 16]));
        let related = SampleIdentity { endpoint: Gid([3; 16]), number: 5 };
        let body: Vec<u8> = (0..2000_u32).map(|index| index as u8).collect();
        let message =
            LargeSample { writer, reader, number: (1 << 32) + 7, related, body: &body }.first_fragment();
        assert_eq!(message[..20], *b"RTPS\x02\x04\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01");
        assert_eq!(message[20..24], [INFO_DST, 1, 12, 0]);
        assert_eq!(message[36..40], [INFO_TS, 1, 8, 0]);
        let data_frag = &message[48..];
        assert_eq!(data_frag[..4], [DATA_FRAG, 3, (28 + 4 + 60 + 256 - 256_u32) as u8, 1]);
        assert_eq!(data_frag[4..8], [0, 0, 28, 0]);
        assert_eq!(data_frag[8..16], [2, 2, 2, 2, 1, 1, 1, 1]);
        assert_eq!(data_frag[16..24], [1, 0, 0, 0, 7, 0, 0, 0]);
        assert_eq!(data_frag[24..36], [1, 0, 0, 0, 1, 0, 0, 1, 0xd4, 7, 0, 0]);
        assert_eq!(data_frag[36..40], [0x83, 0, 24, 0]);
        assert_eq!(data_frag[40..64], [[3; 16].as_slice(), &[0, 0, 0, 0, 5, 0, 0, 0]].concat());
        assert_eq!(data_frag[64..68], [0x0f, 0x80, 24, 0]);
        assert_eq!(data_frag[92..100], [1, 0, 0, 0, 0, 1, 0, 0]);
        assert_eq!(data_frag[100..], body[..252]);
    }
}
