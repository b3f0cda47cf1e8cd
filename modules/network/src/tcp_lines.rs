//! Lines of text on TCP, as topics.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `lines/received` | std_msgs/String | each line of each peer, without its end; bytes that are no UTF-8 are replaced by U+FFFD |
//! | `lines/send` (in) | std_msgs/String | sent to all peers, with a line feed |
//! | `lines/exchanges` | downbeat_interfaces/BusExchange | all lines, for replays |
//!
//! By default it listens, for this machine only. Lines of more than 2048 bytes are dropped. Run the module
//! detached.

use std::net::SocketAddrV4;
use std::time::Duration;

use downbeat_device::{Device, DeviceLink};
use downbeat_executor::{Context, Module, Publication, Received, Setup, SetupError};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::std_msgs::msg::String as Line;

use crate::mailbox::{Mailbox, Waiting};
use crate::tcp::{Side, Tcp};

/// How often the sockets are polled.
const PERIOD: Duration = Duration::from_millis(20);

/// The module.
pub struct TcpLines {
    mailbox: Mailbox<Tcp>,
    waiting: Waiting,
}

/// The ports of [`TcpLines`].
pub struct Ports {
    received: Publication<Line>,
    exchanges: Publication<BusExchange>,
}

impl Module for TcpLines {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let about = "whether it listens on `address` or connects to it";
        let side = setup.read_only_choice("side", "server", &["server", "client"], about)?;
        let address =
            setup.read_only_setting("address", "127.0.0.1:4012".to_owned(), "IPv4 address and port")?;
        let parsed = setup.value(address).and_then(|text| text.parse::<SocketAddrV4>().ok());
        let refusal = "it is no IPv4 address with a port, such as 127.0.0.1:4012";
        let at = parsed.ok_or_else(|| setup.refuse_value(address, refusal))?;
        let is_client = setup.value(side).is_some_and(|side| side == "client");
        if let Some(tcp) = self.mailbox.device() {
            tcp.configure(if is_client { Side::Client(at) } else { Side::Server(at) });
        }
        setup
            .subscribe("lines/send", |module, line: Received<'_, Line>, _| module.waiting.keep(&line.data))?;
        setup.every(PERIOD, Self::run)?;
        Ok(Ports { received: setup.publish("lines/received")?, exchanges: setup.publish(Tcp::TOPIC)? })
    }
}

impl TcpLines {
    /// A module that uses this link.
    #[must_use]
    pub fn new(link: DeviceLink<Tcp>) -> Self {
        Self { mailbox: Mailbox::new(link), waiting: Waiting::default() }
    }

    fn run(&mut self, ctx: &mut Context<'_, Ports>) {
        for line in self.mailbox.receive(ctx.ports.exchanges, ctx) {
            let data = String::from_utf8_lossy(&line).into_owned();
            ctx.publish(ctx.ports.received, Line { data });
        }
        while let Some(line) = self.waiting.next() {
            self.mailbox.send(line, ctx.ports.exchanges, ctx);
        }
    }
}
