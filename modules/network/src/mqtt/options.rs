//! What a connection to a broker needs to know.

use std::time::Duration;

use bytes::Bytes;

use super::packet::Packet;

/// The version of the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Version {
    /// MQTT 3.1.1.
    V3,
    /// MQTT 5.
    V5,
}

/// What a connection needs to know.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Options {
    /// The version of the protocol.
    pub version: Version,
    /// The name or address of the broker.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// The name of the client; if it is empty, the broker chooses one.
    pub client_id: String,
    /// User and password.
    pub login: Option<(String, String)>,
    /// After so long without a packet both sides ask whether the other is there; at least 5 s.
    pub keep_alive: Duration,
    /// The longest payload in bytes, of both ways.
    pub max_bytes: usize,
    /// What is received, with its quality of service.
    pub filters: Vec<(String, u8)>,
    /// The topic that says whether the robot is there, retained; empty for none.
    pub status_topic: String,
    /// What it says while the robot is there.
    pub online: String,
    /// What it says when the robot has left, or is lost (the last will).
    pub offline: String,
}

impl Options {
    pub(super) fn status(&self, payload: &str) -> Option<Packet> {
        let payload = Bytes::copy_from_slice(payload.as_bytes());
        let topic = self.status_topic.clone();
        (!topic.is_empty()).then_some(Packet { topic, payload, qos: 1, is_retained: true })
    }
}
