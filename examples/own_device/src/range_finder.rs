//! The range finder: its connection and the module that polls it.

use std::io;
use std::net::UdpSocket;
use std::time::Duration;

use downbeat::device::{Device, DeviceLink};
use downbeat::executor::{Context, Module, Publication, Setup, SetupError, Time};
use downbeat::msgs::sensor_msgs::msg::Range;
use downbeat_msgs::Message;
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::std_msgs::msg::Header;

/// How long the range finder may take to answer.
const TIMEOUT: Duration = Duration::from_millis(200);

/// A request to the range finder with its outcome.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "own_device/msg/Exchange")]
pub(crate) struct Exchange {
    request: String,
    /// Empty if there was no answer.
    answer: String,
    /// Why there was no answer, or empty.
    error: String,
}

/// The connection to the range finder: a serial port behind a device server that speaks UDP.
#[derive(Default)]
pub(crate) struct Line {
    /// Host and port.
    address: String,
    socket: Option<UdpSocket>,
}

impl Line {
    /// Sends a request and waits for the answer that begins with its number.
    fn ask(&mut self, request: &str) -> io::Result<String> {
        let socket = match self.socket.take() {
            Some(socket) => socket,
            None => {
                let socket = UdpSocket::bind("0.0.0.0:0")?;
                socket.connect(&self.address)?;
                socket.set_read_timeout(Some(TIMEOUT))?;
                socket
            }
        };
        socket.send(request.as_bytes())?;
        let number = request.split(' ').next().unwrap_or_default();
        let mut buffer = [0; 64];
        loop {
            let length = socket.recv(&mut buffer)?;
            let answer = String::from_utf8_lossy(&buffer[..length]);
            // Other numbers belong to late answers to earlier requests.
            if answer.split(' ').next() == Some(number) {
                self.socket = Some(socket);
                return Ok(answer.into_owned());
            }
        }
    }
}

impl Device for Line {
    type Request = String;
    type Exchange = Exchange;
    const TOPIC: &'static str = "exchanges";

    fn exchange(&mut self, request: &String, _: Time) -> Exchange {
        let (answer, error) = match self.ask(request) {
            Ok(answer) => (answer, String::new()),
            Err(error) => (String::new(), error.to_string()),
        };
        Exchange { request: request.clone(), answer, error }
    }

    fn answers(exchange: &Exchange, request: &String) -> bool {
        exchange.request == *request
    }

    fn failed(request: &String, _: Time, reason: &str) -> Exchange {
        Exchange { request: request.clone(), answer: String::new(), error: reason.to_owned() }
    }
}

/// Asks the range finder 20 times per second and publishes the distance.
pub(crate) struct RangeFinder {
    link: DeviceLink<Line>,
    requests: u32,
}

pub(crate) struct Ports {
    exchanges: Publication<Exchange>,
    range: Publication<Range>,
}

impl Module for RangeFinder {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let address = setup.read_only_setting(
            "address",
            "127.0.0.1:4001".to_owned(),
            "host and port of the range finder",
        )?;
        if let (Some(line), Some(address)) = (self.link.device(), setup.value(address)) {
            line.address.clone_from(address);
        }
        setup.every(Duration::from_millis(50), Self::measure)?;
        Ok(Ports { exchanges: setup.publish(Line::TOPIC)?, range: setup.publish("range")? })
    }
}

impl RangeFinder {
    pub(crate) fn new(link: DeviceLink<Line>) -> Self {
        Self { link, requests: 0 }
    }

    fn measure(&mut self, ctx: &mut Context<'_, Ports>) {
        self.requests += 1;
        let request = format!("{} range?", self.requests);
        let exchange = self.link.exchange(&request, ctx.ports.exchanges, ctx);
        if !exchange.error.is_empty() {
            tracing::warn!("no answer to \"{request}\": {}", exchange.error);
        }
        let metres = exchange.answer.split(' ').nth(1).and_then(|metres| metres.parse().ok());
        if let Some(range) = metres {
            let stamp = Stamp::from_nanos(ctx.now().as_nanos());
            let header = Header { stamp, frame_id: "range_finder".into() };
            ctx.publish(ctx.ports.range, Range { header, max_range: 4.0, range, ..Range::default() });
        }
    }
}
