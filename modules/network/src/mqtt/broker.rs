//! The connection to a broker as a device. It runs on a thread of its own; queues on both ways are bounded.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use downbeat_device::Device;
use downbeat_executor::Time;
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use parking_lot::Mutex;

use super::connection::{self, Connection, Happening, Publisher};
use super::options::{Options, Version};
use super::packet::Packet;

/// How many messages wait on each way; older ones are dropped.
pub const MOST_WAITING: usize = 256;
/// How many bytes wait on each way.
pub const MOST_BYTES: usize = 16 << 20;
/// The pauses before a connection is opened again: the first, doubled each time, and the longest.
const PAUSES: [Duration; 2] = [Duration::from_millis(100), Duration::from_secs(10)];
/// A connection that lasted so long was a good one: the pauses begin anew.
const LASTING: Duration = Duration::from_secs(5);
/// How long the end of the robot waits for the broker to take what is left.
const FAREWELL: Duration = Duration::from_millis(500);

/// What the module wants of the broker.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// Take the next message or event, if there is one. In the exchange, `OPEN` says that the broker was
    /// reached, `CLOSE` that it was lost, or could not be reached, with the reason.
    Receive,
    /// Send this.
    Send(Packet),
}

/// The connection to a broker, opened when it is first used and again after failures.
#[derive(Default)]
pub struct Broker {
    options: Option<Options>,
    line: Option<Line>,
}

impl Broker {
    /// Sets the broker. Before that, every exchange fails.
    pub fn configure(&mut self, options: Options) {
        self.line = None;
        self.options = Some(options);
    }

    /// The connection's thread; one that has ended (it does not, unless by a bug) is replaced.
    fn line(&mut self, now: Time) -> Result<&Line, String> {
        let options = self.options.as_ref().ok_or("no broker is set")?;
        let is_over = |line: &Line| {
            line.thread.is_finished() && now.saturating_since(line.since) > Duration::from_secs(1)
        };
        if self.line.as_ref().is_some_and(is_over) {
            self.line = None;
        }
        match &mut self.line {
            Some(line) => Ok(line),
            none => Ok(none.insert(Line::open(options.clone(), now).map_err(|error| error.to_string())?)),
        }
    }

    fn attempt(&mut self, request: &Request, now: Time) -> Event {
        let line = match self.line(now) {
            Ok(line) => line,
            Err(reason) => return Event::Lost(reason),
        };
        match request {
            Request::Receive => {
                line.shared.pass_on();
                line.shared.incoming.lock().take().unwrap_or(Event::Nothing)
            }
            Request::Send(packet) => {
                let dropped = line.shared.outgoing.lock().waiting.push(packet.clone());
                line.shared.pass_on();
                if dropped == 0 { Event::Sent } else { Event::Dropped(dropped) }
            }
        }
    }
}

/// The outcome of a request.
#[derive(Debug)]
enum Event {
    Nothing,
    Sent,
    Received(Packet),
    Connected,
    Lost(String),
    Refused(String),
    Dropped(usize),
}

impl Device for Broker {
    type Request = Request;
    type Exchange = BusExchange;
    const TOPIC: &'static str = "mqtt/exchanges";

    fn exchange(&mut self, request: &Request, now: Time) -> BusExchange {
        let exchange = exchange_of(request, now);
        let failed =
            |kind, error| BusExchange { kind, outcome: BusExchange::FAILED, error, ..exchange.clone() };
        match self.attempt(request, now) {
            Event::Nothing => BusExchange { outcome: BusExchange::TIMEOUT, ..exchange },
            Event::Sent => exchange,
            Event::Received(packet) => BusExchange { reply: packet.to_bytes(), ..exchange },
            Event::Connected => BusExchange { kind: BusExchange::OPEN, ..exchange },
            Event::Lost(reason) => failed(BusExchange::CLOSE, reason),
            Event::Refused(reason) => failed(BusExchange::TRANSFER, reason),
            Event::Dropped(count) => failed(
                BusExchange::TRANSFER,
                format!("{count} messages were dropped: at most {MOST_WAITING} wait, and {MOST_BYTES} bytes"),
            ),
        }
    }

    fn answers(exchange: &BusExchange, request: &Request) -> bool {
        exchange.instruction == exchange_of(request, Time::ZERO).instruction
    }

    fn failed(request: &Request, now: Time, reason: &str) -> BusExchange {
        BusExchange { outcome: BusExchange::FAILED, error: reason.to_owned(), ..exchange_of(request, now) }
    }
}

fn exchange_of(request: &Request, now: Time) -> BusExchange {
    let instruction = match request {
        Request::Receive => Vec::new(),
        Request::Send(packet) => packet.to_bytes(),
    };
    let stamp = Stamp::from_nanos(now.as_nanos());
    BusExchange { stamp, kind: BusExchange::TRANSFER, instruction, ..BusExchange::default() }
}

/// The thread of a connection.
struct Line {
    shared: Arc<Shared>,
    thread: JoinHandle<()>,
    since: Time,
}

/// What the thread shares with the module.
struct Shared {
    options: Options,
    is_leaving: AtomicBool,
    incoming: Mutex<Incoming>,
    outgoing: Mutex<Outgoing>,
}

#[derive(Default)]
struct Incoming {
    events: VecDeque<Event>,
    messages: Queue,
    dropped: usize,
}

#[derive(Default)]
struct Outgoing {
    waiting: Queue,
    /// While connected.
    publisher: Option<Publisher>,
}

/// Packets, bounded in number and size.
#[derive(Default)]
struct Queue {
    packets: VecDeque<Packet>,
    bytes: usize,
}

impl Queue {
    /// Returns how many older packets were dropped for it.
    fn push(&mut self, packet: Packet) -> usize {
        self.bytes += packet.payload.len();
        self.packets.push_back(packet);
        let mut dropped = 0;
        while (self.packets.len() > MOST_WAITING || self.bytes > MOST_BYTES) && self.pop().is_some() {
            dropped += 1;
        }
        dropped
    }

    fn pop(&mut self) -> Option<Packet> {
        let packet = self.packets.pop_front()?;
        self.bytes -= packet.payload.len();
        Some(packet)
    }
}

impl Incoming {
    /// Events first: they are few, and messages behind a lost connection are as good as before.
    fn take(&mut self) -> Option<Event> {
        if let Some(event) = self.events.pop_front() {
            return Some(event);
        }
        match std::mem::take(&mut self.dropped) {
            0 => self.messages.pop().map(Event::Received),
            dropped => Some(Event::Dropped(dropped)),
        }
    }

    fn tell(&mut self, event: Event) {
        if self.events.len() == MOST_WAITING {
            self.events.pop_front();
        }
        self.events.push_back(event);
    }
}

impl Shared {
    /// Gives the connection what it has room for.
    fn pass_on(&self) {
        let mut outgoing = self.outgoing.lock();
        let Outgoing { waiting, publisher: Some(publisher) } = &mut *outgoing else { return };
        while waiting.packets.front().is_some_and(|packet| publisher.publish(packet)) {
            waiting.pop();
        }
    }

    /// Runs the connection until the robot leaves.
    fn serve(&self, mut publisher: Option<Publisher>, mut connection: impl Connection) {
        let (mut pause, mut connected_at, mut last_reason) = (PAUSES[0], None, String::new());
        loop {
            match connection.wait() {
                Happening::Connected => {
                    connection.greet(&self.options);
                    connected_at = Some(Instant::now());
                    last_reason.clear();
                    self.incoming.lock().tell(Event::Connected);
                    self.outgoing.lock().publisher = publisher.take();
                }
                Happening::Received(packet) if packet.payload.len() <= self.options.max_bytes => {
                    let mut incoming = self.incoming.lock();
                    incoming.dropped += incoming.messages.push(packet);
                }
                Happening::Received(_) => self.incoming.lock().dropped += 1,
                Happening::Refused(reason) => self.incoming.lock().tell(Event::Refused(reason)),
                Happening::Failed { reason, unsent } => {
                    let mut outgoing = self.outgoing.lock();
                    publisher = outgoing.publisher.take().or(publisher);
                    for packet in unsent.into_iter().rev() {
                        let has_room = outgoing.waiting.packets.len() < MOST_WAITING;
                        if has_room && packet.topic != self.options.status_topic {
                            outgoing.waiting.bytes += packet.payload.len();
                            outgoing.waiting.packets.push_front(packet);
                        }
                    }
                    drop(outgoing);
                    if self.is_leaving.load(Ordering::Acquire) {
                        return;
                    }
                    if connected_at.take().is_some_and(|at: Instant| at.elapsed() > LASTING) {
                        pause = PAUSES[0];
                    }
                    if reason != last_reason {
                        self.incoming.lock().tell(Event::Lost(reason.clone()));
                        last_reason = reason;
                    }
                    std::thread::park_timeout(pause);
                    pause = (pause * 2).min(PAUSES[1]);
                }
                Happening::Left => return,
                Happening::Other => {}
            }
            if self.is_leaving.load(Ordering::Acquire) && connected_at.is_none() {
                return;
            }
        }
    }
}

impl Line {
    fn open(options: Options, now: Time) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            options,
            is_leaving: AtomicBool::new(false),
            incoming: Mutex::default(),
            outgoing: Mutex::default(),
        });
        let of_thread = Arc::clone(&shared);
        let run = move || {
            let serve = || match of_thread.options.version {
                Version::V3 => {
                    let (publisher, connection) = connection::connect3(&of_thread.options);
                    of_thread.serve(Some(publisher), connection);
                }
                Version::V5 => {
                    let (publisher, connection) = connection::connect5(&of_thread.options);
                    of_thread.serve(Some(publisher), connection);
                }
            };
            // A packet that the protocol's library does not survive must not end more than the connection.
            if catch_unwind(AssertUnwindSafe(serve)).is_err() {
                of_thread.outgoing.lock().publisher = None;
                let reason = "the connection ended with a panic; it is opened again".to_owned();
                of_thread.incoming.lock().tell(Event::Lost(reason));
            }
        };
        let thread = std::thread::Builder::new().name("mqtt".to_owned()).spawn(run)?;
        Ok(Self { shared, thread, since: now })
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        let end = Instant::now() + FAREWELL;
        if let Some(farewell) = self.shared.options.status(&self.shared.options.offline) {
            self.shared.outgoing.lock().waiting.push(farewell);
        }
        let mut has_left = false;
        self.shared.is_leaving.store(true, Ordering::Release);
        self.thread.thread().unpark();
        while !self.thread.is_finished() && Instant::now() < end {
            self.shared.pass_on();
            let outgoing = self.shared.outgoing.lock();
            if let Some(publisher) = &outgoing.publisher
                && !has_left
                && outgoing.waiting.packets.is_empty()
            {
                has_left = publisher.leave();
            }
            drop(outgoing);
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packet(length: usize) -> Packet {
        Packet { topic: "é/b".to_owned(), payload: vec![7; length].into(), qos: 2, is_retained: true }
    }

    #[test]
    fn a_queue_drops_its_oldest_by_number_and_by_size() {
        let mut queue = Queue::default();
        assert_eq!((0..MOST_WAITING + 5).map(|_| queue.push(packet(1))).sum::<usize>(), 5);
        assert_eq!(queue.push(packet(MOST_BYTES)), MOST_WAITING);
        assert_eq!((queue.packets.len(), queue.bytes), (1, MOST_BYTES));
    }
}
