//! Tells the others that a participant is gone.
//!
//! rustdds 0.15.1 tells them too, unless it has failed. But Fast DDS knows what is gone by the key hash among the inline QoS,
//! which rustdds does not send, and goes on counting its endpoints for the lease of 50 s. So a socket of our own says it
//! again, in the name of the participant: a DATA submessage of the writer of announcements that says "disposed and
//! unregistered" (RTPS 2.5, 8.5.3.2, 9.4.5.4 and 9.6.4.9).

use super::rtps::{
    INLINE_QOS, LITTLE_ENDIAN, end_of_parameters, message_of, multicast_port, parameter, sequence_number,
    submessage, unicast_ports,
};
use crate::middleware::{DiscoveryRange, Gid};
use bytes::BufMut;
use socket2::{Domain, Protocol, Socket, Type};
use std::io;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::sync::{Arc, Mutex, PoisonError};

/// Where announcements are multicast.
const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);
/// So many participants of a machine have ports of their own.
const PARTICIPANTS: u16 = 120;

/// Says it when it is dropped.
pub(super) struct Farewell {
    pub(super) participant: Gid,
    pub(super) domain_id: u16,
    pub(super) range: DiscoveryRange,
    pub(super) static_peers: Arc<Mutex<Vec<SocketAddr>>>,
}

impl Farewell {
    fn say(&self) -> io::Result<()> {
        let message = farewell_of(self.participant);
        let socket = socket()?;
        let ports = unicast_ports(self.domain_id, PARTICIPANTS);
        let here = ports.map(|port| SocketAddr::V4(SocketAddrV4::new(Ipv4Addr::LOCALHOST, port)));
        let peers = self.static_peers.lock().unwrap_or_else(PoisonError::into_inner).clone();
        for address in here.chain(peers) {
            // Whoever is not there needs not be told.
            let _ = socket.send_to(&message, &address.into());
        }
        if self.range == DiscoveryRange::Localhost {
            return Ok(());
        }
        let group = SocketAddrV4::new(GROUP, multicast_port(self.domain_id)).into();
        for interface in netdev::get_interfaces().iter().filter(|interface| interface.is_multicast()) {
            for network in &interface.ipv4 {
                // One that has gone meanwhile leads to nobody.
                if socket.set_multicast_if_v4(&network.addr()).is_ok() {
                    let _ = socket.send_to(&message, &group);
                }
            }
        }
        Ok(())
    }
}

impl Drop for Farewell {
    fn drop(&mut self) {
        if let Err(error) = self.say() {
            tracing::debug!(%error, "others are not told that this participant is gone: they see it for 50 s more");
        }
    }
}

fn socket() -> io::Result<Socket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

const ENTITY_PARTICIPANT: [u8; 4] = [0, 0, 1, 0xC1];
const ENTITY_READER_OF_ANNOUNCEMENTS: [u8; 4] = [0, 1, 0, 0xC7];
const ENTITY_WRITER_OF_ANNOUNCEMENTS: [u8; 4] = [0, 1, 0, 0xC2];
const DATA: u8 = 0x15;
/// The payload is a key.
const KEY: u8 = 0x08;
const OCTETS_TO_INLINE_QOS: u16 = 16;
/// Behind all that the participant has ever announced: readers of announcements pass over what is not new.
const SEQUENCE_NUMBER: i64 = 1 << 32;
const PL_CDR_LE: [u8; 4] = [0, 3, 0, 0];
const PID_PARTICIPANT_GUID: u16 = 0x0050;
const PID_KEY_HASH: u16 = 0x0070;
const PID_STATUS_INFO: u16 = 0x0071;
const DISPOSED_AND_UNREGISTERED: [u8; 4] = [0, 0, 0, 3];

fn farewell_of(participant: Gid) -> Vec<u8> {
    let guid = [&participant.participant()[..], &ENTITY_PARTICIPANT].concat();
    let mut data = Vec::new();
    data.put_u16_le(0); // extra flags
    data.put_u16_le(OCTETS_TO_INLINE_QOS);
    data.put_slice(&ENTITY_READER_OF_ANNOUNCEMENTS);
    data.put_slice(&ENTITY_WRITER_OF_ANNOUNCEMENTS);
    sequence_number(&mut data, SEQUENCE_NUMBER);
    parameter(&mut data, PID_KEY_HASH, &guid);
    parameter(&mut data, PID_STATUS_INFO, &DISPOSED_AND_UNREGISTERED);
    end_of_parameters(&mut data);
    data.put_slice(&PL_CDR_LE);
    parameter(&mut data, PID_PARTICIPANT_GUID, &guid);
    end_of_parameters(&mut data);

    let mut message = message_of(participant);
    submessage(&mut message, DATA, LITTLE_ENDIAN | INLINE_QOS | KEY, &data);
    message
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::middleware::dds::rtps::sender_of;

    #[test]
    fn the_lengths_in_the_message_are_those_of_its_parts() {
        let message = farewell_of(Gid(*b"abcdefghijkl____"));
        assert_eq!(sender_of(&message), Some(*b"abcdefghijkl"));
        let (header, data) = message[20..].split_at(4);
        assert_eq!(usize::from(u16::from_le_bytes([header[2], header[3]])), data.len());
        // Counted from behind the field itself.
        let inline_qos = &data[4 + usize::from(OCTETS_TO_INLINE_QOS)..];
        assert_eq!(inline_qos[..4], [0x70, 0, 16, 0]);
        assert_eq!(inline_qos[4..16], *b"abcdefghijkl");
    }
}
