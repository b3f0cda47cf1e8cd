//! Lines of text on UDP, as topics.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `lines/received` | std_msgs/String | each line of each datagram, without its end; bytes that are no UTF-8 are replaced by U+FFFD |
//! | `lines/send` (in) | std_msgs/String | sent as one datagram that ends with a line feed |
//! | `datagrams` | downbeat_interfaces/BusExchange | all datagrams, for replays |
//!
//! By default it receives from this machine only. Run the module detached.

use std::net::{SocketAddr, SocketAddrV4};
use std::time::Duration;

use downbeat_device::{Device, DeviceLink};
use downbeat_executor::{Context, Module, Publication, Received, Setup, SetupError};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::std_msgs::msg::String as Line;

use crate::mailbox::{Mailbox, Waiting};
use crate::udp::{Target, Udp};

/// How often the socket is polled.
const PERIOD: Duration = Duration::from_millis(20);

/// The module.
pub struct UdpLines {
    mailbox: Mailbox<Udp>,
    waiting: Waiting,
}

/// The ports of [`UdpLines`].
pub struct Ports {
    received: Publication<Line>,
    datagrams: Publication<BusExchange>,
}

impl Module for UdpLines {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let listen = setup.read_only_setting(
            "listen",
            "127.0.0.1:4010".to_owned(),
            "address and port on which it receives",
        )?;
        let to = setup.read_only_setting(
            "to",
            "127.0.0.1:4011".to_owned(),
            "address and port to which it sends",
        )?;
        let refusal = "it is no IPv4 address with a port, such as 127.0.0.1:4010";
        let address = |setup: &Setup<'_, Self>, setting| {
            let parsed = setup.value::<String>(setting).and_then(|text| text.parse::<SocketAddrV4>().ok());
            parsed.ok_or_else(|| setup.refuse_value(setting, refusal))
        };
        let (listen, to) = (address(setup, listen)?, address(setup, to)?);
        if let Some(udp) = self.mailbox.device() {
            udp.configure(listen, Target::Address(SocketAddr::V4(to)));
        }
        setup
            .subscribe("lines/send", |module, line: Received<'_, Line>, _| module.waiting.keep(&line.data))?;
        setup.every(PERIOD, Self::run)?;
        Ok(Ports { received: setup.publish("lines/received")?, datagrams: setup.publish(Udp::TOPIC)? })
    }
}

impl UdpLines {
    /// A module that uses this link.
    #[must_use]
    pub fn new(link: DeviceLink<Udp>) -> Self {
        Self { mailbox: Mailbox::new(link), waiting: Waiting::default() }
    }

    fn run(&mut self, ctx: &mut Context<'_, Ports>) {
        for datagram in self.mailbox.receive(ctx.ports.datagrams, ctx) {
            for line in String::from_utf8_lossy(&datagram).lines() {
                ctx.publish(ctx.ports.received, Line { data: line.to_owned() });
            }
        }
        while let Some(line) = self.waiting.next() {
            self.mailbox.send(line, ctx.ports.datagrams, ctx);
        }
    }
}
