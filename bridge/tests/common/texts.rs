//! Texts of any size that show whether they are complete, and a node of ours that exchanges them with a peer.
#![allow(dead_code, clippy::unwrap_used, clippy::missing_panics_doc)]

use super::rclpy::Peer;
use super::{WATCHDOG, wait_until};
use bytes::Bytes;
use downbeat_bridge::middleware::ParticipantOptions;
use downbeat_bridge::ros::{MessageType, Node, NodeName, Participant, Publisher, Subscription};
use downbeat_msgs::cdr;
use downbeat_msgs::qos::{Durability, QosProfile, Reliability};
use downbeat_msgs::std_msgs::msg::String as Text;
use serde_json::{Value, json};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

pub const TEXT: &str = "std_msgs/msg/String";

/// The number and the size of a text; `None` if it is not as it was made.
pub type Heard = Option<(usize, usize)>;

/// A message std_msgs/msg/String of `size` bytes, without the encapsulation. `texts.py` makes the same.
pub fn text_of(number: usize, size: usize) -> Bytes {
    let letters = (b'a'..=b'z').map(char::from).cycle();
    // The length stands before the text, a zero after it.
    let data = format!("{number}:").chars().chain(letters).take(size - 5).collect();
    cdr::to_vec(&Text { data }).into()
}

pub fn number_of(cdr: &[u8]) -> Heard {
    let data = cdr::from_slice::<Text>(cdr).ok()?.data;
    let (number, size) = (data.split_once(':')?.0.parse().ok()?, data.len() + 5);
    let expected = cdr::from_slice::<Text>(&text_of(number, size)).ok()?.data;
    (data == expected).then_some((number, size))
}

/// A quality of service as the commands of peers name it.
pub fn qos_of(qos: QosProfile, depth: u32) -> Value {
    let reliability = if qos.reliability == Reliability::Reliable { "reliable" } else { "best_effort" };
    let durability =
        if qos.durability == Durability::TransientLocal { "transient_local" } else { "volatile" };
    json!({"depth": depth, "reliability": reliability, "durability": durability})
}

/// A subscription whose texts go into a channel.
pub fn hear(node: &Node, topic: &str, qos: QosProfile) -> (Subscription, Receiver<Heard>) {
    let (sender, heard) = channel();
    let handler = Box::new(move |sample: downbeat_bridge::middleware::Sample| {
        // The test may have stopped listening.
        let _ = sender.send(number_of(&sample.cdr));
    });
    (node.subscribe(topic, &MessageType::new(TEXT).unwrap(), qos, handler).unwrap(), heard)
}

/// Publishes on `/ours` and hears `/theirs`.
pub struct Talker {
    pub participant: Participant,
    pub node: Node,
    pub ours: Publisher,
    pub theirs: Subscription,
    heard: Receiver<Heard>,
}

impl Talker {
    pub fn join(options: &ParticipantOptions, qos: QosProfile) -> Self {
        let participant = Participant::join(options).unwrap();
        let node = participant.create_node(NodeName::new("/", "downbeat").unwrap()).unwrap();
        let ours = node.publish("/ours", &MessageType::new(TEXT).unwrap(), qos).unwrap();
        let (theirs, heard) = hear(&node, "/theirs", qos);
        Self { participant, node, ours, theirs, heard }
    }

    /// The counterparts at the peer, once all are matched.
    pub fn meet(&self, peer: &mut Peer, depth: u32) {
        let qos = qos_of(self.ours.qos(), depth);
        peer.ask(json!({"do": "subscribe_texts", "topic": "/ours", "qos": qos}));
        peer.ask(json!({"do": "advertise", "topic": "/theirs", "type": TEXT, "qos": qos}));
        self.wait_until_matched(peer);
    }

    pub fn wait_until_matched(&self, peer: &mut Peer) {
        wait_until("all are matched", || {
            self.ours.matched_subscriptions() == 1
                && self.theirs.matched_publishers() == 1
                && is_matched(peer, "/ours")
                && is_matched(peer, "/theirs")
        });
    }

    pub fn say(&self, number: usize, size: usize) {
        self.ours.publish(text_of(number, size)).unwrap();
    }

    /// The next text, its number and its size.
    pub fn heard(&self) -> (usize, usize) {
        self.heard_within(WATCHDOG).expect("a text within the watchdog time")
    }

    pub fn heard_within(&self, time: Duration) -> Option<(usize, usize)> {
        self.heard.recv_timeout(time).ok().map(|text| text.expect("a text as it was made"))
    }

    /// Texts of a size to the peer and as many back: all arrive whole, once and in their order.
    pub fn exchange(&self, peer: &mut Peer, size: usize, count: usize) {
        (0..count).for_each(|number| self.say(number, size));
        assert_whole(&taken(peer, "/ours", count), size, count);
        peer.ask(publish_texts(size, count));
        let heard: Vec<_> = (0..count).map(|_| self.heard()).collect();
        assert_whole(&heard, size, count);
    }
}

pub fn publish_texts(size: usize, count: usize) -> Value {
    json!({"do": "publish_texts", "topic": "/theirs", "size": size, "count": count})
}

pub fn is_matched(peer: &mut Peer, topic: &str) -> bool {
    peer.ask(json!({"do": "matched", "topic": topic})) == 1
}

/// The numbers and sizes of the next texts at a peer; fewer if they do not come.
pub fn taken(peer: &mut Peer, topic: &str, count: usize) -> Vec<(usize, usize)> {
    let (mut taken, mut last) = (Vec::new(), Instant::now());
    while taken.len() < count && last.elapsed() < WATCHDOG {
        let more = peer.ask(json!({"do": "take", "topic": topic}));
        let more: Vec<Heard> = serde_json::from_value(more).unwrap();
        if more.is_empty() {
            std::thread::sleep(Duration::from_millis(5));
        } else {
            last = Instant::now();
        }
        taken.extend(more.into_iter().map(|text| text.expect("a text as it was made")));
    }
    taken
}

#[track_caller]
pub fn assert_whole(texts: &[(usize, usize)], size: usize, count: usize) {
    let expected: Vec<_> = (0..count).map(|number| (number, size)).collect();
    assert!(texts == expected, "of {count} texts of {size} bytes came {texts:?}");
}
