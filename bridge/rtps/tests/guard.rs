//! The hooks for security, with a trivial guard.

mod common;

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use bytes::Bytes;
use common::{Network, addresses, reliable};
use downbeat_rtps::{
    protocol::{Admission, Config, Fault, Guard, Participant},
    wire::{EndpointData, Guid, GuidPrefix, Header, ParticipantData},
};

const SECOND: Duration = Duration::from_secs(1);
/// Id of a submessage that contains another one. DDS Security uses this id.
const WRAPPER: u8 = 0x30;

/// Flips bits with a secret, wraps each submessage, and appends a mark to each message.
struct Flipping {
    secret: u8,
    /// Whether others are already admitted.
    is_ready: Arc<AtomicBool>,
    /// A topic that no other participant may use.
    forbidden: &'static str,
}

impl Flipping {
    fn flip(&self, bytes: &[u8]) -> Vec<u8> {
        bytes.iter().map(|byte| byte ^ self.secret).collect()
    }
}

impl Guard for Flipping {
    fn admit_participant(&mut self, _: &ParticipantData) -> Admission {
        if self.is_ready.load(Ordering::Relaxed) { Admission::Admit } else { Admission::Wait }
    }

    fn admit_endpoint(&mut self, _: &EndpointData, remote: &EndpointData) -> Admission {
        if remote.topic == self.forbidden { Admission::Refuse } else { Admission::Admit }
    }

    fn room(&self) -> usize {
        64
    }

    fn encode_payload(&mut self, _: Guid, payload: Bytes) -> Option<Bytes> {
        Some([&payload[..4], &self.flip(&payload[4..])].concat().into())
    }

    fn decode_payload(&mut self, writer: Guid, payload: Bytes) -> Option<Bytes> {
        self.encode_payload(writer, payload)
    }

    fn encode_submessage(&mut self, _: GuidPrefix, submessage: &[u8], out: &mut Vec<u8>) -> bool {
        out.extend([WRAPPER, 1]);
        out.extend((submessage.len() as u16).to_le_bytes());
        out.extend(self.flip(submessage));
        true
    }

    fn decode_submessage(&mut self, _: GuidPrefix, submessages: &[u8], out: &mut Vec<u8>) -> bool {
        let Some((&[WRAPPER, ..], wrapped)) = submessages.split_first_chunk::<4>() else { return false };
        out.extend(self.flip(wrapped));
        true
    }

    fn encode_message(&mut self, _: GuidPrefix, message: &mut Vec<u8>) -> bool {
        message.push(self.secret);
        true
    }

    fn decode_message(&mut self, _: GuidPrefix, message: &mut Vec<u8>) -> bool {
        message.pop() == Some(self.secret)
    }
}

fn guarded(network: &mut Network, secret: u8, is_ready: Arc<AtomicBool>) -> usize {
    let node = network.join(|_| {});
    let config = Config::new([node as u8; 10], 0, addresses(network.nodes[node].address));
    let guard = Flipping { secret, is_ready, forbidden: "rt/forbidden" };
    network.nodes[node].participant = Participant::with_guard(config, Box::new(guard), network.now());
    network.call(node, |participant, now| participant.handle_timeout(now));
    node
}

#[test]
fn only_participants_with_the_secret_communicate_and_nothing_is_sent_unprotected() {
    let mut network = Network::new(0);
    network.watch = Box::new(|flight| {
        // Announcements of participants that are replaced by guarded ones are never sent.
        let (_, submessages) = flight.bytes.split_at(Header::LEN);
        assert_eq!(submessages[0], WRAPPER);
    });
    let nodes = [7, 7, 8].map(|secret| guarded(&mut network, secret, Arc::new(true.into())));
    let writer = network.writer(nodes[0], "rt/a", reliable());
    let readers = [1, 2].map(|index| network.reader(nodes[index], "rt/a", reliable()));
    let forbidden = network.writer(nodes[0], "rt/forbidden", reliable());
    network.reader(nodes[1], "rt/forbidden", reliable());
    network.run_for(SECOND);
    network.write(nodes[0], writer, "a secret");
    network.run_for(SECOND);
    assert_eq!(network.nodes[nodes[1]].texts(readers[0]), ["a secret"]);
    assert!(network.nodes[nodes[2]].texts(readers[1]).is_empty());
    assert!(network.nodes[nodes[2]].participant.counters().faults(Fault::Rejected) > 0);
    assert!(network.nodes[nodes[0]].participant.matched(forbidden).is_empty());
}

#[test]
fn a_waiting_participant_is_matched_once_it_is_admitted() {
    let mut network = Network::new(0);
    let is_ready = Arc::new(AtomicBool::new(false));
    let nodes = [is_ready.clone(), Arc::new(true.into())].map(|is_ready| guarded(&mut network, 7, is_ready));
    let writer = network.writer(nodes[0], "rt/a", reliable());
    network.reader(nodes[1], "rt/a", reliable());
    network.run_for(SECOND);
    let matches = |network: &Network| network.nodes[nodes[0]].participant.matched(writer).len();
    assert_eq!(network.nodes[nodes[0]].participant.remote_participants().count(), 1);
    assert_eq!(matches(&network), 0);
    let waiting = network.nodes[nodes[1]].participant.prefix();
    is_ready.store(true, Ordering::Relaxed);
    network.call(nodes[0], |participant, now| participant.reconsider(now, waiting));
    network.run_for(SECOND);
    assert_eq!(matches(&network), 1);
}
