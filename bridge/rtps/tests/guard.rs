//! The hooks for security, with a trivial guard.
#![allow(clippy::unwrap_used)]

mod common;

#[allow(unused_imports)] // by `common`
use common::no_guard as guard;

use std::{
    collections::VecDeque,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use bytes::Bytes;
use common::{Network, addresses, endpoint, reliable};
use downbeat_rtps::{
    protocol::{
        Admission, Channel, Config, CreateError, Demand, Denial, EndpointConfig, Event, Fault, Guard, Now,
        Participant, Report, Room, Severity, TopicProtection,
    },
    wire::{
        BuiltinEndpoints, EndpointData, EntityId, Guid, GuidPrefix, Header, ParticipantData, Submessage,
        parse,
    },
};

const SECOND: Duration = Duration::from_secs(1);
/// In front of the protected part of a datagram.
const MARK: u8 = 0x30;
/// A topic that no other participant may use.
const FORBIDDEN: &str = "rt/forbidden";
/// A topic whose discovery is protected.
const HIDDEN: &str = "rt/hidden";

/// With an encapsulation header.
const HELLO: Bytes = Bytes::from_static(b"\0\x01\0\0hello");

/// What the guard of a participant was told over the channels.
type Heard = Arc<Mutex<Vec<(Channel, GuidPrefix, Bytes)>>>;

/// Flips the bits of everything behind the header with a secret.
struct Flipping {
    secret: u8,
    /// Whether others are already admitted.
    is_ready: Arc<AtomicBool>,
    heard: Heard,
    demands: VecDeque<Demand>,
    forgotten: Heard,
}

impl Flipping {
    fn flip(&self, bytes: &[u8]) -> Vec<u8> {
        bytes.iter().map(|byte| byte ^ self.secret).collect()
    }
}

impl Guard for Flipping {
    fn complete_participant(&mut self, own: &mut ParticipantData) {
        own.builtin_endpoints.0 |= BuiltinEndpoints::OF_SECURITY;
    }

    fn complete_endpoint(&mut self, _: Now, own: &mut EndpointData) -> Result<(), Denial> {
        if own.topic == "rt/denied" { Err(Denial("never".to_owned())) } else { Ok(()) }
    }

    fn admit_participant(&mut self, _: Now, remote: &ParticipantData) -> Admission {
        let to = remote.prefix;
        let is_ready = self.is_ready.load(Ordering::Relaxed);
        let channel = if is_ready { Channel::Volatile } else { Channel::Stateless };
        self.demands.push_back(Demand::Send { channel, to, message: HELLO });
        if is_ready {
            let report = Report { remote: Some(to), text: "welcome".to_owned(), severity: Severity::Info };
            self.demands.push_back(Demand::Report(report));
        }
        if is_ready { Admission::Admit } else { Admission::Wait }
    }

    fn is_authenticated(&self, _: GuidPrefix) -> bool {
        true
    }

    fn admit_endpoint(&mut self, _: Now, local: &EndpointData, remote: &EndpointData) -> Admission {
        // It would give keys to what may not have them.
        assert_ne!(local.guid.entity.is_writer(), remote.guid.entity.is_writer());
        assert_eq!(local.type_name, remote.type_name);
        if remote.topic == FORBIDDEN { Admission::Refuse } else { Admission::Admit }
    }

    fn protection_of(&self, topic: &str) -> TopicProtection {
        TopicProtection { discovery: topic == HIDDEN, liveliness: topic == HIDDEN }
    }

    fn forget_participant(&mut self, remote: GuidPrefix) {
        self.forgotten.lock().unwrap().push((Channel::Stateless, remote, Bytes::new()));
    }

    fn forget_endpoint(&mut self, _: Guid) {}

    fn handle_message(&mut self, _: Now, channel: Channel, from: GuidPrefix, payload: &[u8]) {
        self.heard.lock().unwrap().push((channel, from, Bytes::copy_from_slice(payload)));
    }

    fn handle_timeout(&mut self, _: Now) {}

    fn next_timeout(&self) -> Option<Instant> {
        None
    }

    fn poll(&mut self) -> Option<Demand> {
        self.demands.pop_front()
    }

    fn room(&self) -> Room {
        Room { message: 1, submessage: 0 }
    }

    fn encode(&mut self, _: GuidPrefix, datagram: &mut Vec<u8>) -> bool {
        let (header, body) = datagram.split_at(Header::LEN);
        *datagram = [header, &[MARK], &self.flip(body)].concat();
        true
    }

    fn decode(&mut self, _: Now, _: GuidPrefix, datagram: &[u8], out: &mut Vec<u8>) -> bool {
        let (header, body) = datagram.split_at(Header::LEN);
        let Some((&MARK, body)) = body.split_first() else { return false };
        out.extend_from_slice(header);
        out.extend(self.flip(body));
        // With another secret it is no message.
        parse(out).is_ok_and(|(_, mut submessages)| {
            submessages.all(|submessage| submessage.is_ok_and(|it| !matches!(it, Submessage::Unknown { .. })))
        })
    }
}

/// A node with a guard, and what that was told and told to forget.
struct Guarded {
    node: usize,
    heard: Heard,
    forgotten: Heard,
}

fn guarded(network: &mut Network, secret: u8, is_ready: Arc<AtomicBool>) -> Guarded {
    let node = network.join(|_| {});
    let config = Config::new([node as u8; 10], 0, addresses(network.nodes[node].address));
    let (heard, forgotten) = (Heard::default(), Heard::default());
    let guard = Flipping {
        secret,
        is_ready,
        heard: heard.clone(),
        demands: VecDeque::new(),
        forgotten: forgotten.clone(),
    };
    network.nodes[node].participant = Participant::with_guard(config, Box::new(guard), network.now());
    network.call(node, |participant, now| participant.handle_timeout(now));
    Guarded { node, heard, forgotten }
}

fn ready() -> Arc<AtomicBool> {
    Arc::new(true.into())
}

#[test]
fn only_participants_with_the_secret_communicate_and_nothing_is_sent_unprotected() {
    let mut network = Network::new(0);
    network.watch = Box::new(|flight| {
        // Announcements of participants that are replaced by guarded ones are never sent.
        let (_, body) = flight.bytes.split_at(Header::LEN);
        assert_eq!(body[0], MARK);
    });
    let nodes = [7, 7, 200].map(|secret| guarded(&mut network, secret, ready()).node);
    for topic in ["rt/a", HIDDEN] {
        let writer = network.writer(nodes[0], topic, reliable());
        network.writer(nodes[1], topic, reliable());
        network.call(nodes[1], |participant, now| {
            let other = EndpointConfig::new(topic, "std_msgs::msg::dds_::Bool_", reliable());
            participant.create_reader(now, other).unwrap();
        });
        let readers = [1, 2].map(|index| network.reader(nodes[index], topic, reliable()));
        network.run_for(SECOND);
        network.write(nodes[0], writer, "a secret");
        network.run_for(SECOND);
        assert_eq!(network.nodes[nodes[1]].texts(readers[0]), ["a secret"]);
        assert!(network.nodes[nodes[2]].texts(readers[1]).is_empty());
    }
    let forbidden = network.writer(nodes[0], FORBIDDEN, reliable());
    network.reader(nodes[1], FORBIDDEN, reliable());
    network.run_for(SECOND);
    assert!(network.nodes[nodes[2]].participant.counters().faults(Fault::Rejected) > 0);
    assert!(network.nodes[nodes[0]].participant.matched(forbidden).is_empty());
    let denied = network
        .call(nodes[0], |participant, now| participant.create_writer(now, endpoint("rt/denied", reliable())));
    assert_eq!(denied, Err(CreateError::Denied(Denial("never".to_owned()))));
}

#[test]
fn guards_talk_over_their_channels_and_learn_of_departures() {
    let mut network = Network::new(0);
    let waiting = Arc::new(AtomicBool::new(false));
    let (a, b) = (guarded(&mut network, 7, waiting.clone()), guarded(&mut network, 7, ready()));
    network.run_for(SECOND);
    let prefix = |network: &Network, guarded: &Guarded| network.nodes[guarded.node].participant.prefix();
    let (prefix_a, prefix_b) = (prefix(&network, &a), prefix(&network, &b));
    assert!(b.heard.lock().unwrap().contains(&(Channel::Stateless, prefix_a, HELLO)));
    assert!(a.heard.lock().unwrap().is_empty(), "a has not opened the protected channel");
    waiting.store(true, Ordering::Relaxed);
    network.call(a.node, |participant, now| participant.reconsider(now, prefix_b));
    network.run_for(SECOND);
    assert!(a.heard.lock().unwrap().contains(&(Channel::Volatile, prefix_b, HELLO)));
    assert!(b.heard.lock().unwrap().contains(&(Channel::Volatile, prefix_a, HELLO)));
    let welcomed = |event: &Event| matches!(event, Event::Security(report) if report.text == "welcome");
    assert_eq!(network.nodes[a.node].count(welcomed), 1);
    // A farewell with protection is believed at once.
    network.call(a.node, |participant, now| participant.leave(now));
    network.run_for(Duration::from_millis(20));
    assert_eq!(network.nodes[b.node].participant.remote_participants().count(), 0);
    assert_eq!(b.forgotten.lock().unwrap().len(), 1);
}

#[test]
fn an_endpoint_is_announced_only_where_its_topic_says() {
    let mut network = Network::new(0);
    let announced = Arc::new(Mutex::new(Vec::new()));
    let seen = announced.clone();
    network.watch = Box::new(move |flight| {
        let plain: Vec<u8> = flight.bytes[Header::LEN + 1..].iter().map(|byte| byte ^ 7).collect();
        let message = [&flight.bytes[..Header::LEN], &plain].concat();
        let Ok((_, submessages)) = parse(&message) else { return };
        for submessage in submessages.map_while(Result::ok) {
            if let Submessage::Data(data) = submessage {
                seen.lock().unwrap().push(data.writer);
            }
        }
    });
    let nodes = [7, 7].map(|secret| guarded(&mut network, secret, ready()).node);
    network.run_for(SECOND);
    for (topic, writer) in
        [("rt/a", EntityId::SEDP_PUBLICATIONS_WRITER), (HIDDEN, EntityId::SEDP_PUBLICATIONS_SECURE_WRITER)]
    {
        announced.lock().unwrap().clear();
        network.writer(nodes[0], topic, reliable());
        network.run_for(SECOND);
        assert_eq!(*announced.lock().unwrap(), [writer], "{topic}");
    }
}

#[test]
fn a_waiting_participant_is_matched_once_it_is_admitted() {
    let mut network = Network::new(0);
    let is_ready = Arc::new(AtomicBool::new(false));
    let nodes = [is_ready.clone(), ready()].map(|is_ready| guarded(&mut network, 7, is_ready).node);
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
