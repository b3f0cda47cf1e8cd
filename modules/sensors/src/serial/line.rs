//! A module's side of its port: opens it, opens it again when the cable was out, and counts what goes wrong.

use std::time::Duration;

use downbeat_device::DeviceLink;
use downbeat_device::counted::Counted;
use downbeat_executor::{Context, Publication, Time};
use downbeat_msgs::diagnostic_msgs::msg::KeyValue;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;

use super::device::{PortSettings, Request, Role, SerialDevice};
use crate::diagnostics::value;

/// When a port is opened again after it was lost; the wait doubles up to the longest.
const FIRST_WAIT: Duration = Duration::from_millis(100);
const LONGEST_WAIT: Duration = Duration::from_secs(2);

/// The link of a module to its serial port.
pub(crate) struct Line<R: Role> {
    link: DeviceLink<SerialDevice<R>>,
    port: String,
    state: State,
    /// Why the port is closed.
    failure: String,
    bytes: u64,
    refused: Counted,
    lost: Counted,
}

enum State {
    Closed { not_before: Time, wait: Duration },
    Open,
}

/// What a step of a module finds.
pub(crate) enum Event {
    /// The port is closed.
    Closed,
    /// The port was opened.
    Opened,
    /// Bytes, and when the last of them came.
    Bytes(Vec<u8>, Time),
    /// Nothing has come.
    Silent,
}

impl<R: Role> Line<R> {
    pub(crate) fn new(link: DeviceLink<SerialDevice<R>>) -> Self {
        Self {
            link,
            port: String::new(),
            state: State::Closed { not_before: Time::ZERO, wait: FIRST_WAIT },
            failure: String::new(),
            bytes: 0,
            refused: Counted::default(),
            lost: Counted::default(),
        }
    }

    /// Sets which port is opened.
    pub(crate) fn configure(&mut self, settings: PortSettings) {
        self.port.clone_from(&settings.path);
        if let Some(device) = self.link.device() {
            device.configure(settings);
        }
    }

    /// Opens the port if that is due, else receives what has come. Waits for a bounded time.
    pub(crate) fn step<P>(&mut self, topic: Publication<BusExchange>, ctx: &mut Context<'_, P>) -> Event {
        let now = ctx.now();
        match self.state {
            State::Closed { not_before, .. } if now < not_before => Event::Closed,
            State::Closed { wait, .. } => {
                let exchange = self.link.exchange(&Request::Open, topic, ctx);
                if exchange.outcome == BusExchange::OK {
                    tracing::info!("{}: opened {}", ctx.module_name(), self.port);
                    self.failure.clear();
                    self.state = State::Open;
                    return Event::Opened;
                }
                if self.refused.is_worth_a_line() {
                    tracing::warn!("{}: {}; trying again", ctx.module_name(), exchange.error);
                }
                self.failure = exchange.error;
                self.state = State::Closed { not_before: now + wait, wait: (wait * 2).min(LONGEST_WAIT) };
                Event::Closed
            }
            State::Open => {
                let exchange = self.link.exchange(&Request::Receive, topic, ctx);
                match exchange.outcome {
                    BusExchange::OK => {
                        self.bytes += exchange.reply.len() as u64;
                        let sent = Time::from_nanos(exchange.stamp.as_nanos());
                        let arrived = sent + Duration::from_micros(exchange.duration_us.into());
                        Event::Bytes(exchange.reply, arrived)
                    }
                    BusExchange::TIMEOUT => Event::Silent,
                    _ => {
                        self.lose(exchange.error, topic, ctx);
                        Event::Closed
                    }
                }
            }
        }
    }

    /// Sends bytes. Returns whether that worked; if not, the port is closed.
    pub(crate) fn send<P>(
        &mut self,
        bytes: Vec<u8>,
        topic: Publication<BusExchange>,
        ctx: &mut Context<'_, P>,
    ) -> bool {
        let exchange = self.link.exchange(&Request::Send(bytes), topic, ctx);
        let is_sent = exchange.outcome == BusExchange::OK;
        if !is_sent {
            self.lose(exchange.error, topic, ctx);
        }
        is_sent
    }

    /// Closes a port that does not work, to open it again.
    fn lose<P>(&mut self, error: String, topic: Publication<BusExchange>, ctx: &mut Context<'_, P>) {
        if self.lost.is_worth_a_line() {
            tracing::warn!("{}: {} is lost: {error}", ctx.module_name(), self.port);
        }
        self.link.exchange(&Request::Close, topic, ctx);
        self.failure = error;
        self.state = State::Closed { not_before: ctx.now() + FIRST_WAIT, wait: FIRST_WAIT };
    }

    /// Closes the port because the module stops.
    pub(crate) fn close<P>(&mut self, topic: Publication<BusExchange>, ctx: &mut Context<'_, P>) {
        if self.is_open() {
            self.link.exchange(&Request::Close, topic, ctx);
        }
        self.state = State::Closed { not_before: Time::ZERO, wait: FIRST_WAIT };
    }

    pub(crate) fn is_open(&self) -> bool {
        matches!(self.state, State::Open)
    }

    /// Why the port is closed, for diagnostics.
    pub(crate) fn failure(&self) -> &str {
        if self.failure.is_empty() { "the port is not open yet" } else { &self.failure }
    }

    /// Values for diagnostics.
    pub(crate) fn values(&self) -> Vec<KeyValue> {
        vec![
            value("port", &self.port),
            value("bytes received", self.bytes),
            value("ports lost", self.lost.count()),
            value("ports that could not be opened", self.refused.count()),
        ]
    }
}
