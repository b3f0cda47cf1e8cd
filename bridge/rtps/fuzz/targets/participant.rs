//! A participant receives any conversation. It must not panic, and what it sends and stores is bounded.

use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::{Duration, Instant};

use downbeat_rtps::protocol::{
    Addresses, Config, EndpointConfig, Event, Interface, Now, Participant, WriteOptions,
};
use downbeat_rtps::qos::{Durability, History, Qos, Reliability};
use downbeat_rtps::wire::{EntityId, GuidPrefix};

/// The address from which the conversation comes.
const SPEAKER: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 7410);

/// The most datagrams that a participant sends at one moment.
const MOST_AT_ONCE: usize = 20_000;

/// Appends a datagram to a conversation.
pub fn say(conversation: &mut Vec<u8>, pause_10_ms: u8, datagram: &[u8]) {
    conversation.push(pause_10_ms);
    conversation.extend((datagram.len() as u16).to_le_bytes());
    conversation.extend_from_slice(datagram);
}

/// The participant that receives the conversations. It always has the same GUIDs.
pub struct Listener {
    participant: Participant,
    now: Now,
    datagram: Vec<u8>,
    /// Number of samples that its readers received.
    pub samples: usize,
}

/// Topics and types in the recorded conversations, with the durability of the endpoints.
const TOPICS: [(&str, &str, Durability); 5] = [
    ("rt/chatter", "std_msgs::msg::dds_::String_", Durability::TransientLocal),
    ("rt/big", "std_msgs::msg::dds_::String_", Durability::Volatile),
    ("rq/triggerRequest", "std_srvs::srv::dds_::Trigger_Request_", Durability::Volatile),
    ("DDSPerfRDataKS", "KeyedSeq", Durability::Volatile),
    ("DDSPerfCPUStats", "CPUStats", Durability::Volatile),
];

impl Listener {
    pub const PREFIX: GuidPrefix = GuidPrefix([0x01, 0x44, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10]);

    /// Also returns its writers, in the order of the topics.
    pub fn new() -> (Self, [EntityId; TOPICS.len()]) {
        let here = |port| vec![SocketAddrV4::new(Ipv4Addr::LOCALHOST, port)];
        let addresses = Addresses {
            metatraffic_unicast: here(7412),
            metatraffic_multicast: Vec::new(),
            default_unicast: here(7413),
            announce_to: here(7410),
            interfaces: vec![Interface { address: Ipv4Addr::LOCALHOST, prefix_length: 8 }],
        };
        let [_, _, unique @ ..] = Self::PREFIX.0;
        let now = Now { steady: Instant::now(), wall_ns: 1_795_000_000_000_000_000 };
        let config = Config { secret: 0, ..Config::new(unique, 0, addresses) };
        let participant = Participant::new(config, now);
        let mut listener = Self { participant, now, datagram: Vec::new(), samples: 0 };
        let writers = TOPICS.map(|(topic, type_name, durability)| {
            let history = History::KeepLast(5);
            let qos =
                Qos { reliability: Reliability::Reliable, durability, history, ..Qos::writer_default() };
            let config = EndpointConfig::new(topic, type_name, qos);
            listener.participant.create_reader(now, config.clone()).expect("a reader");
            let writer = listener.participant.create_writer(now, config).expect("a writer");
            for size in [10, 100_000] {
                let payload = vec![0; size].into();
                let _ = listener.participant.write(now, writer, payload, WriteOptions::default());
            }
            writer
        });
        listener.send();
        (listener, writers)
    }

    pub fn participant(&self) -> &Participant {
        &self.participant
    }

    /// Receives all datagrams of a conversation, as far as the bytes are valid.
    pub fn hear(&mut self, mut conversation: &[u8]) {
        while let [pause_10_ms, low, high, rest @ ..] = conversation {
            let length = usize::from(u16::from_le_bytes([*low, *high])).min(rest.len());
            let (datagram, following) = rest.split_at(length);
            self.wait(Duration::from_millis(10 * u64::from(*pause_10_ms)));
            self.participant.handle_datagram(self.now, SPEAKER, datagram);
            self.send();
            conversation = following;
        }
    }

    /// Advances the time.
    pub fn wait(&mut self, duration: Duration) {
        let end = self.now.steady + duration;
        let mut turns = 0;
        while let Some(at) = self.participant.next_timeout().filter(|at| *at <= end) {
            turns += 1;
            assert!(turns < MOST_AT_ONCE, "a participant never rests");
            self.move_to(at.max(self.now.steady));
            self.participant.handle_timeout(self.now);
            self.send();
        }
        self.move_to(end);
    }

    fn move_to(&mut self, at: Instant) {
        let elapsed = at.saturating_duration_since(self.now.steady);
        self.now = Now { steady: at, wall_ns: self.now.wall_ns + elapsed.as_nanos() as i64 };
    }

    fn send(&mut self) {
        let mut sent = 0;
        while self.participant.poll_transmit(self.now, &mut self.datagram).is_some() {
            sent += 1;
            assert!(sent < MOST_AT_ONCE, "a participant never stops sending");
        }
        while let Some(event) = self.participant.poll_event() {
            self.samples += usize::from(matches!(event, Event::Sample { .. }));
        }
    }
}

/// One run: a new participant receives a conversation, followed by ten seconds of silence.
pub fn run(conversation: &[u8]) {
    let (mut listener, _) = Listener::new();
    listener.hear(conversation);
    listener.wait(Duration::from_secs(10));
}
