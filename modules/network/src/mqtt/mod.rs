//! Topics of the robot on an MQTT broker, both ways, in JSON or CBOR.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | those of the setting `send` (in) | as the setting says | sent to the broker |
//! | those of the setting `receive` | as the setting says | received from the broker |
//! | `mqtt/connected` | std_msgs/Bool | whether the broker is there, when it changes |
//! | `mqtt/exchanges` | downbeat_interfaces/BusExchange | all that was sent and received, for replays |
//!
//! A line of `send` is `TOPIC TYPE MQTT_TOPIC`, then options in any order: `json` (the default) or `cbor`;
//! `qos0` (the default), `qos1` or `qos2`; `retain`; `hz=RATE`, the most messages in a second, of which the
//! others are skipped. A line of `receive` is the same, with a filter (`+`, `#`) in place of the topic, and
//! without `retain` and `hz`:
//!
//! ```toml
//! [[module]]
//! kind = "mqtt"
//! settings.host = "broker.local"
//! settings.status_topic = "darwin/status"
//! settings.send = ["battery_state sensor_msgs/msg/BatteryState darwin/battery qos1 retain hz=0.2"]
//! settings.receive = ["cmd_vel geometry_msgs/msg/Twist darwin/cmd_vel"]
//! ```
//!
//! While the broker is away, messages wait, at most [`MOST_WAITING`](broker::MOST_WAITING); those that it did
//! not acknowledge are sent again. What others publish meanwhile is lost unless it is retained. The
//! connection is not encrypted.
//!
//! # References
//! - MQTT Version 3.1.1 and MQTT Version 5.0, OASIS.

pub mod broker;
mod connection;
mod options;
mod packet;
mod route;

pub use options::{Options, Version};
pub use packet::Packet;

use std::time::Duration;

use downbeat_device::{Device, DeviceLink};
use downbeat_edge::{Interfaces, KnownType};
use downbeat_executor::{AnyPublication, Context, Module, Publication, Setting, Setup, SetupError, Time};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::encoding::Codec;
use downbeat_msgs::std_msgs::msg::Bool;

use broker::{Broker, Request};
use route::{Route, Way, selects};

/// How often the queues are looked at.
const PERIOD: Duration = Duration::from_millis(20);
/// The most messages and events that are taken in one run.
const MOST_IN_ONE_RUN: usize = 64;

/// The module. Run it detached.
pub struct Mqtt {
    link: DeviceLink<Broker>,
    interfaces: Interfaces,
    sent: Vec<Sent>,
    received: Vec<Received>,
    max_bytes: usize,
    broker: String,
    is_connected: bool,
    refused: u64,
}

struct Sent {
    route: Route,
    codec: Codec,
    last: Option<Time>,
}

struct Received {
    route: Route,
    codec: Codec,
    message: KnownType,
    publication: AnyPublication,
}

/// The ports of [`Mqtt`].
pub struct Ports {
    connected: Publication<Bool>,
    exchanges: Publication<BusExchange>,
}

impl Module for Mqtt {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let mut options = options(setup)?;
        let about = "topics for the broker: \"TOPIC TYPE MQTT_TOPIC [json|cbor] [qos0|qos1|qos2] [retain] [hz=RATE]\"";
        let send = setup.read_only_setting("send", Vec::<String>::new(), about)?;
        let about = "topics from the broker: \"TOPIC TYPE MQTT_FILTER [json|cbor] [qos0|qos1|qos2]\"";
        let receive = setup.read_only_setting("receive", Vec::<String>::new(), about)?;
        (self.sent, self.received) = (Vec::new(), Vec::new());
        for route in routes(setup, send, Way::Out)? {
            let (message, codec) = self.message(setup, send, &route)?;
            let index = self.sent.len();
            setup.subscribe_of(message.in_core(), &route.topic, move |module, received, ctx| {
                if message.is_type_of(received.message)
                    && let Some(cdr) = message.encode(received.message)
                {
                    module.send(index, &cdr, ctx);
                }
            })?;
            self.sent.push(Sent { route, codec, last: None });
        }
        for route in routes(setup, receive, Way::In)? {
            let is_loop =
                |sent: &&Sent| sent.route.topic == route.topic && selects(&route.remote, &sent.route.remote);
            if let Some(Sent { route: sent, .. }) = self.sent.iter().find(is_loop) {
                let refusal = format!("{} would come back from {} for ever", sent.topic, sent.remote);
                return Err(setup.refuse_value(receive, refusal));
            }
            let (message, codec) = self.message(setup, receive, &route)?;
            let publication = setup.publish_of(message.in_core(), &route.topic)?;
            options.filters.push((route.remote.clone(), route.qos));
            self.received.push(Received { route, codec, message, publication });
        }
        self.max_bytes = options.max_bytes;
        self.broker = format!("{}:{}", options.host, options.port);
        if let Some(broker) = self.link.device() {
            broker.configure(options);
        }
        setup.every(PERIOD, Self::run)?;
        Ok(Ports { connected: setup.publish("mqtt/connected")?, exchanges: setup.publish(Broker::TOPIC)? })
    }
}

/// Declares the settings of the connection.
fn options(setup: &mut Setup<'_, Mqtt>) -> Result<Options, SetupError> {
    let version = setup.read_only_choice("version", "5", &["3.1.1", "5"], "of the protocol")?;
    let mut text =
        |name: &str, default: &str, about: &str| setup.read_only_setting(name, default.to_owned(), about);
    let host = text("host", "127.0.0.1", "name or address of the broker")?;
    let client_id = text("client_id", "", "name of the client; the broker chooses one if it is empty")?;
    let user = text("user", "", "user on the broker; empty for none")?;
    let password_file = text("password_file", "", "file whose first line is the password")?;
    let status_topic =
        text("status_topic", "", "topic on the broker that says whether the robot is there; empty for none")?;
    let online = text("online", "online", "what `status_topic` says while the robot is there")?;
    let about = "what `status_topic` says when the robot has left or is lost (last will)";
    let offline = text("offline", "offline", about)?;
    let port = setup.read_only_setting("port", 1883_i64, "the broker's TCP port, 1 to 65535")?;
    let keep_alive = setup.read_only_setting("keep_alive", 10_i64, "s, 5 to 3600: a silent peer is asked")?;
    let max_bytes =
        setup.read_only_setting("max_bytes", 262_144_i64, "the longest payload, 1 to 16777216 bytes")?;
    let text = |setup: &Setup<'_, Mqtt>, setting| setup.value::<String>(setting).cloned().unwrap_or_default();
    let number = |setup: &Setup<'_, Mqtt>, setting, range: std::ops::RangeInclusive<i64>| {
        let value = setup.value(setting).copied().unwrap_or_default();
        let outside = || format!("{value} is not between {} and {}", range.start(), range.end());
        if range.contains(&value) { Ok(value) } else { Err(setup.refuse_value(setting, outside())) }
    };
    let status = text(setup, status_topic);
    if status.contains(['+', '#', '\0']) || status.len() > usize::from(u16::MAX) {
        return Err(setup.refuse_value(status_topic, "it is no topic: it has wildcards, or is too long"));
    }
    let login = match (text(setup, user), text(setup, password_file)) {
        (user, _) if user.is_empty() => None,
        (user, file) if file.is_empty() => Some((user, String::new())),
        (user, file) => {
            let content = downbeat_msgs::user_file::read_text(&file);
            let content =
                content.map_err(|error| setup.refuse_value(password_file, format!("{file}: {error}")))?;
            Some((user, content.lines().next().unwrap_or_default().to_owned()))
        }
    };
    Ok(Options {
        version: if text(setup, version) == "3.1.1" { Version::V3 } else { Version::V5 },
        host: text(setup, host),
        port: number(setup, port, 1..=65535)? as u16,
        client_id: text(setup, client_id),
        login,
        keep_alive: Duration::from_secs(number(setup, keep_alive, 5..=3600)? as u64),
        max_bytes: number(setup, max_bytes, 1..=16 << 20)? as usize,
        filters: Vec::new(),
        status_topic: status,
        online: text(setup, online),
        offline: text(setup, offline),
    })
}

fn routes(
    setup: &Setup<'_, Mqtt>,
    setting: Setting<Vec<String>>,
    way: Way,
) -> Result<Vec<Route>, SetupError> {
    let lines = setup.value(setting).cloned().unwrap_or_default();
    let parsed = lines.iter().map(|line| Route::parse(line, way)).collect::<Result<Vec<_>, _>>();
    parsed.map_err(|reason| setup.refuse_value(setting, reason))
}

impl Mqtt {
    /// A module that uses this link. Types of messages are found in `interfaces`.
    #[must_use]
    pub fn new(link: DeviceLink<Broker>, interfaces: Interfaces) -> Self {
        Self {
            link,
            interfaces,
            sent: Vec::new(),
            received: Vec::new(),
            max_bytes: 0,
            broker: String::new(),
            is_connected: false,
            refused: 0,
        }
    }

    fn message(
        &self,
        setup: &mut Setup<'_, Self>,
        setting: Setting<Vec<String>>,
        route: &Route,
    ) -> Result<(KnownType, Codec), SetupError> {
        let found = self.interfaces.find_message(&route.type_name);
        let found = found.map_err(|unknown| setup.refuse_value(setting, unknown.to_string()))?;
        let message = self.interfaces.message_on(setup, &route.topic, found);
        let codec = route.encoding.codec_of_text(message.name(), message.definition());
        Ok((message, codec.map_err(|error| setup.refuse_value(setting, error.to_string()))?))
    }

    fn send(&mut self, index: usize, cdr: &[u8], ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        let Some(Sent { route, codec, last }) = self.sent.get_mut(index) else { return };
        if let (Some(last), Some(period)) = (*last, route.period)
            && now.saturating_since(last) < period
        {
            return;
        }
        let payload = match codec.encode(cdr) {
            Ok(payload) if payload.len() <= self.max_bytes => payload,
            Ok(payload) => {
                let reason = format!("{} bytes are more than `max_bytes`, {}", payload.len(), self.max_bytes);
                let topic = route.topic.clone();
                return self.refuse(&format!("{topic} was not sent: {reason}"));
            }
            Err(error) => {
                let topic = route.topic.clone();
                return self.refuse(&format!("{topic} was not sent: {error}"));
            }
        };
        *last = Some(now);
        let packet = Packet {
            topic: route.remote.clone(),
            payload: payload.into(),
            qos: route.qos,
            is_retained: route.is_retained,
        };
        let exchange = self.link.exchange(&Request::Send(packet), ctx.ports.exchanges, ctx);
        if exchange.outcome == BusExchange::FAILED {
            self.refuse(&exchange.error);
        }
    }

    fn run(&mut self, ctx: &mut Context<'_, Ports>) {
        for _ in 0..MOST_IN_ONE_RUN {
            let exchange = self.link.exchange(&Request::Receive, ctx.ports.exchanges, ctx);
            match (exchange.kind, exchange.outcome) {
                (_, BusExchange::TIMEOUT) => break,
                (BusExchange::OPEN, _) => self.connected(true, ctx),
                (BusExchange::CLOSE, _) => {
                    tracing::warn!(
                        "the MQTT broker {} is not there: {}; check host and port, and that it runs; this is tried again with \
                         growing pauses",
                        self.broker,
                        exchange.error
                    );
                    self.connected(false, ctx);
                }
                (_, BusExchange::OK) => match Packet::from_bytes(&exchange.reply) {
                    Some(packet) => self.receive(&packet, ctx),
                    None => self.refuse("what was recorded is no message"),
                },
                _ => self.refuse(&exchange.error),
            }
            // A replay has no more to say.
            if exchange.outcome == BusExchange::FAILED {
                break;
            }
        }
    }

    fn connected(&mut self, is_connected: bool, ctx: &mut Context<'_, Ports>) {
        if self.is_connected != is_connected {
            self.is_connected = is_connected;
            ctx.publish(ctx.ports.connected, Bool { data: is_connected });
            if is_connected {
                tracing::info!("connected to the MQTT broker {}", self.broker);
            }
        }
    }

    fn receive(&mut self, packet: &Packet, ctx: &mut Context<'_, Ports>) {
        let mut problems = Vec::new();
        for Received { route, codec, message, publication } in &self.received {
            if !selects(&route.remote, &packet.topic) {
                continue;
            }
            let decoded = codec.decode(&packet.payload).map_err(|error| error.to_string());
            match decoded
                .and_then(|cdr| message.decode_shared(&cdr.into()).map_err(|error| error.to_string()))
            {
                Ok(decoded) => ctx.publish_any(*publication, decoded),
                Err(error) => problems.push(format!("a message on {:?} was ignored: {error}", packet.topic)),
            }
        }
        problems.iter().for_each(|problem| self.refuse(problem));
    }

    /// Reports the 1st, 2nd, 4th, 8th problem.
    fn refuse(&mut self, problem: &str) {
        self.refused += 1;
        if self.refused.is_power_of_two() {
            tracing::warn!("MQTT: {problem} (problem {} of this module)", self.refused);
        }
    }
}
