//! The two versions of the protocol behind one trait.

use rumqttc::v5::mqttbytes::v5 as packets5;
use rumqttc::{self as v3, v5};

use super::options::Options;
use super::packet::Packet;

/// How many packets wait between the module and the connection.
const CAPACITY: usize = 10;
/// How many packets may wait for acknowledgement.
const MOST_UNACKNOWLEDGED: u16 = 64;
/// Room for the headers of a packet beside its payload.
const HEADERS: usize = 70_000;

/// What happened on a connection.
pub(super) enum Happening {
    Connected,
    Received(Packet),
    /// The broker refuses a subscription.
    Refused(String),
    /// The connection failed, or was lost. These were not acknowledged.
    Failed {
        reason: String,
        unsent: Vec<Packet>,
    },
    /// The broker was told that the robot leaves.
    Left,
    Other,
}

/// A connection that opens when it is waited for, and again after each failure.
pub(super) trait Connection {
    fn wait(&mut self) -> Happening;
    /// Subscribes and says that the robot is there, before all else that waits.
    fn greet(&mut self, options: &Options);
}

/// Passes packets to a connection, from any thread.
pub(super) enum Publisher {
    V3(v3::Client),
    V5(v5::Client),
}

impl Publisher {
    /// Returns false while there is no room.
    pub(super) fn publish(&self, packet: &Packet) -> bool {
        let Packet { topic, payload, qos, is_retained } = packet;
        match self {
            Self::V3(client) => client.try_publish(topic, qos3(*qos), *is_retained, payload.clone()).is_ok(),
            Self::V5(client) => client.try_publish(topic, qos5(*qos), *is_retained, payload.clone()).is_ok(),
        }
    }

    /// Returns false while there is no room.
    pub(super) fn leave(&self) -> bool {
        match self {
            Self::V3(client) => client.try_disconnect().is_ok(),
            Self::V5(client) => client.try_disconnect().is_ok(),
        }
    }
}

pub(super) fn connect3(options: &Options) -> (Publisher, v3::Connection) {
    let mut of_client = v3::MqttOptions::new(&options.client_id, &options.host, options.port);
    of_client.set_keep_alive(options.keep_alive).set_inflight(MOST_UNACKNOWLEDGED);
    of_client.set_max_packet_size(options.max_bytes + HEADERS, options.max_bytes + HEADERS);
    if let Some((user, password)) = &options.login {
        of_client.set_credentials(user, password);
    }
    if let Some(will) = options.status(&options.offline) {
        of_client.set_last_will(v3::LastWill::new(will.topic, will.payload, v3::QoS::AtLeastOnce, true));
    }
    let (client, connection) = v3::Client::new(of_client, CAPACITY);
    (Publisher::V3(client), connection)
}

pub(super) fn connect5(options: &Options) -> (Publisher, v5::Connection) {
    let mut of_client = v5::MqttOptions::new(&options.client_id, &options.host, options.port);
    of_client.set_keep_alive(options.keep_alive).set_outgoing_inflight_upper_limit(MOST_UNACKNOWLEDGED);
    of_client.set_max_packet_size(u32::try_from(options.max_bytes + HEADERS).ok());
    if let Some((user, password)) = &options.login {
        of_client.set_credentials(user, password);
    }
    if let Some(will) = options.status(&options.offline) {
        let qos = v5::mqttbytes::QoS::AtLeastOnce;
        of_client.set_last_will(packets5::LastWill::new(will.topic, will.payload, qos, true, None));
    }
    let (client, connection) = v5::Client::new(of_client, CAPACITY);
    (Publisher::V5(client), connection)
}

impl Connection for v3::Connection {
    fn wait(&mut self) -> Happening {
        use v3::{Event, Incoming, MqttState, Outgoing, Request, StateError, SubscribeReasonCode};
        let error = match self.recv() {
            Ok(Ok(Event::Incoming(Incoming::ConnAck(_)))) => return Happening::Connected,
            Ok(Ok(Event::Incoming(Incoming::Publish(publish)))) => {
                return Happening::Received(Packet {
                    topic: publish.topic,
                    payload: publish.payload,
                    qos: publish.qos as u8,
                    is_retained: publish.retain,
                });
            }
            Ok(Ok(Event::Incoming(Incoming::SubAck(answer)))) => {
                let is_refused = answer.return_codes.contains(&SubscribeReasonCode::Failure);
                return if is_refused { refused(&"no reason is given") } else { Happening::Other };
            }
            Ok(Ok(Event::Outgoing(Outgoing::Disconnect))) | Err(_) => return Happening::Left,
            Ok(Ok(_)) => return Happening::Other,
            Ok(Err(error)) => error,
        };
        let is_too_large = matches!(
            error,
            v3::ConnectionError::MqttState(StateError::Deserialization(
                v3::Error::OutgoingPacketTooLarge { .. }
            ))
        );
        let requests = std::mem::take(&mut self.eventloop.pending);
        // Packets of a broken connection must not meet those of the next one.
        self.eventloop.state = MqttState::new(MOST_UNACKNOWLEDGED, false);
        let unsent = requests.into_iter().filter_map(|request| match request {
            Request::Publish(publish) if !is_too_large => Some(Packet {
                topic: publish.topic,
                payload: publish.payload,
                qos: publish.qos as u8,
                is_retained: publish.retain,
            }),
            _ => None,
        });
        Happening::Failed { reason: error.to_string(), unsent: unsent.collect() }
    }

    fn greet(&mut self, options: &Options) {
        let filters = options.filters.iter();
        let filters: Vec<_> =
            filters.map(|(filter, qos)| v3::SubscribeFilter::new(filter.clone(), qos3(*qos))).collect();
        let pending = &mut self.eventloop.pending;
        if !filters.is_empty() {
            pending.push_back(v3::Request::Subscribe(v3::Subscribe::new_many(filters)));
        }
        if let Some(Packet { topic, payload, qos, is_retained }) = options.status(&options.online) {
            let publish = v3::Publish::from_bytes(topic, qos3(qos), payload);
            pending.push_back(v3::Request::Publish(v3::Publish { retain: is_retained, ..publish }));
        }
    }
}

impl Connection for v5::Connection {
    fn wait(&mut self) -> Happening {
        use packets5::SubscribeReasonCode;
        use v3::Outgoing;
        use v5::{Event, Incoming, MqttState, Request, StateError};
        let error = match self.recv() {
            Ok(Ok(Event::Incoming(Incoming::ConnAck(_)))) => return Happening::Connected,
            Ok(Ok(Event::Incoming(Incoming::Publish(publish)))) => {
                return Happening::Received(Packet {
                    topic: String::from_utf8_lossy(&publish.topic).into_owned(),
                    payload: publish.payload,
                    qos: publish.qos as u8,
                    is_retained: publish.retain,
                });
            }
            Ok(Ok(Event::Incoming(Incoming::SubAck(answer)))) => {
                let is_granted =
                    |code: &&SubscribeReasonCode| matches!(code, SubscribeReasonCode::Success(_));
                return match answer.return_codes.iter().find(|code| !is_granted(code)) {
                    Some(code) => refused(code),
                    None => Happening::Other,
                };
            }
            Ok(Ok(Event::Outgoing(Outgoing::Disconnect))) | Err(_) => return Happening::Left,
            Ok(Ok(_)) => return Happening::Other,
            Ok(Err(error)) => error,
        };
        let is_too_large = matches!(
            error,
            v5::ConnectionError::MqttState(StateError::Deserialization(
                v5::mqttbytes::Error::OutgoingPacketTooLarge { .. }
            ))
        );
        let requests = std::mem::take(&mut self.eventloop.pending);
        self.eventloop.state = MqttState::new(MOST_UNACKNOWLEDGED, false);
        let unsent = requests.into_iter().filter_map(|request| match request {
            Request::Publish(publish) if !is_too_large => Some(Packet {
                topic: String::from_utf8_lossy(&publish.topic).into_owned(),
                payload: publish.payload,
                qos: publish.qos as u8,
                is_retained: publish.retain,
            }),
            _ => None,
        });
        Happening::Failed { reason: error.to_string(), unsent: unsent.collect() }
    }

    fn greet(&mut self, options: &Options) {
        let filters = options.filters.iter();
        let filters: Vec<_> =
            filters.map(|(filter, qos)| packets5::Filter::new(filter.clone(), qos5(*qos))).collect();
        let pending = &mut self.eventloop.pending;
        if !filters.is_empty() {
            pending.push_back(v5::Request::Subscribe(packets5::Subscribe::new_many(filters, None)));
        }
        if let Some(Packet { topic, payload, qos, is_retained }) = options.status(&options.online) {
            let publish = packets5::Publish::new(topic, qos5(qos), payload, None);
            pending.push_back(v5::Request::Publish(packets5::Publish { retain: is_retained, ..publish }));
        }
    }
}

fn refused(reason: &dyn std::fmt::Debug) -> Happening {
    Happening::Refused(format!("the broker refuses a subscription: {reason:?}"))
}

fn qos3(qos: u8) -> v3::QoS {
    v3::qos(qos).unwrap_or(v3::QoS::AtMostOnce)
}

fn qos5(qos: u8) -> v5::mqttbytes::QoS {
    v5::mqttbytes::qos(qos).unwrap_or_default()
}
