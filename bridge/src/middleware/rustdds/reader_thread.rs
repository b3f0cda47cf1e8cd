//! The one thread that serves all readers of a participant, and listens to discovery.
//!
//! Readers are owned by the thread: rustdds registers a reader for polling through `&mut`. Handles send
//! commands.

use super::SharedMatches;
use super::matches::gid;
use super::payload::{ReceiveAny, ReceivedCdr};
use crate::limiter::Limiter;
use crate::middleware::{EventHandler, Gid, Sample, SampleHandler, SampleIdentity};
use crossbeam::channel::{Receiver, Sender, bounded, unbounded};
use rustdds::mio1::{Events, Interest, Poll, Registry, Token, Waker};
use rustdds::{DomainParticipantStatusListener, StatusEvented, Timestamp};
use std::collections::HashMap;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

pub(super) type DdsDataReader = rustdds::no_key::SimpleDataReader<ReceivedCdr, ReceiveAny>;

const WAKE: Token = Token(0);
const DISCOVERY: Token = Token(1);
const FIRST_READER: usize = 2;

/// After so many samples of one reader the others get their turn.
const SAMPLES_PER_TURN: usize = 256;

/// A running thread; dropping it stops and joins the thread.
pub(super) struct ReaderThread {
    link: Link,
    next_token: AtomicUsize,
    thread: Option<JoinHandle<()>>,
}

impl ReaderThread {
    pub(super) fn start(
        discovery: DomainParticipantStatusListener,
        matches: SharedMatches,
    ) -> io::Result<Self> {
        let poll = Poll::new()?;
        let waker = Arc::new(Waker::new(poll.registry(), WAKE)?);
        let (sender, commands) = unbounded();
        let mut served = Served { poll, commands, discovery, matches, readers: HashMap::new() };
        served.discovery.as_status_source_mio1().register(
            served.poll.registry(),
            DISCOVERY,
            Interest::READABLE,
        )?;
        let thread =
            std::thread::Builder::new().name("downbeat-dds".to_owned()).spawn(move || served.run())?;
        let link = Link { commands: sender, waker, thread: thread.thread().id() };
        Ok(Self { link, next_token: AtomicUsize::new(FIRST_READER), thread: Some(thread) })
    }

    /// Has `reader` served until the returned slot is dropped.
    pub(super) fn add(&self, reader: DdsDataReader, topic_name: String, on_sample: SampleHandler) -> Slot {
        let token = Token(self.next_token.fetch_add(1, Ordering::Relaxed));
        self.link.send(Command::Add(
            token,
            Box::new(ServedReader { reader, topic_name, on_sample, unread: Limiter::default() }),
        ));
        Slot { token, link: self.link.clone() }
    }

    /// A way to the thread for an endpoint.
    pub(super) fn link(&self) -> Link {
        self.link.clone()
    }
}

impl Drop for ReaderThread {
    fn drop(&mut self) {
        self.link.send(Command::Stop);
        if let Some(thread) = self.thread.take()
            && std::thread::current().id() != self.link.thread
        {
            // The thread catches panics, so joining does not fail.
            let _ = thread.join();
        }
    }
}

/// The place of one reader in the thread. Once dropped, the handler of the reader does not run any more.
pub(super) struct Slot {
    token: Token,
    link: Link,
}

impl Drop for Slot {
    fn drop(&mut self) {
        let (done, wait) = bounded(0);
        self.link.send(Command::Remove(self.token, done));
        if std::thread::current().id() != self.link.thread {
            // Ends when the thread has dropped its sender, whether it removed the reader or has stopped.
            let _ = wait.recv();
        }
    }
}

/// A way to the thread.
#[derive(Clone)]
pub(super) struct Link {
    commands: Sender<Command>,
    waker: Arc<Waker>,
    thread: std::thread::ThreadId,
}

impl Link {
    /// Registers a handler for events of a local endpoint, which runs on the thread.
    pub(super) fn listen(&self, local: Gid, handler: EventHandler) {
        self.send(Command::Listen(local, handler));
    }

    fn send(&self, command: Command) {
        // Fails only when the thread has stopped, and then there is nothing left to command.
        if self.commands.send(command).is_ok() {
            let _ = self.waker.wake();
        }
    }
}

enum Command {
    Add(Token, Box<ServedReader>),
    /// The sender is dropped with the reader.
    Remove(Token, Sender<()>),
    Listen(Gid, EventHandler),
    Stop,
}

struct ServedReader {
    reader: DdsDataReader,
    topic_name: String,
    unread: Limiter,
    on_sample: SampleHandler,
}

/// What the thread owns.
struct Served {
    poll: Poll,
    commands: Receiver<Command>,
    discovery: DomainParticipantStatusListener,
    matches: SharedMatches,
    readers: HashMap<Token, Box<ServedReader>>,
}

impl Served {
    fn run(mut self) {
        let mut events = Events::with_capacity(128);
        let mut ready = Vec::new();
        self.hear_discovery();
        loop {
            // Readers that used up their turn are still ready, and polling would not report them again.
            let timeout = if ready.is_empty() { None } else { Some(Duration::ZERO) };
            match self.poll.poll(&mut events, timeout) {
                Ok(()) => {}
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => {
                    tracing::error!(%error, "polling the DDS readers failed: nothing is received any more");
                    return;
                }
            }
            for event in &events {
                match event.token() {
                    WAKE => {}
                    DISCOVERY => self.hear_discovery(),
                    token if !ready.contains(&token) => ready.push(token),
                    _ => {}
                }
            }
            if !self.obey(&mut ready) {
                return;
            }
            ready.retain(|token| self.serve(*token));
        }
    }

    /// Carries out what has been commanded; false means stop.
    fn obey(&mut self, ready: &mut Vec<Token>) -> bool {
        while let Ok(command) = self.commands.try_recv() {
            match command {
                Command::Add(token, mut reader) => {
                    match register(&mut reader.reader, self.poll.registry(), token) {
                        Ok(()) => {
                            self.readers.insert(token, reader);
                            // Samples may have come before the registration.
                            ready.push(token);
                        }
                        Err(error) => tracing::error!(
                            topic = reader.topic_name,
                            %error,
                            "polling a DDS reader failed: nothing is received from this topic"
                        ),
                    }
                }
                Command::Remove(token, _done) => self.remove(token),
                Command::Listen(local, handler) => {
                    let news = self.matches.lock().listen(local, handler);
                    if catch_unwind(AssertUnwindSafe(|| news.deliver())).is_err() {
                        tracing::error!("a handler of QoS events panicked");
                    }
                }
                Command::Stop => return false,
            }
        }
        true
    }

    /// Gives what a reader holds to its handler; true when it may hold more.
    fn serve(&mut self, token: Token) -> bool {
        let Some(reader) = self.readers.get_mut(&token) else { return false };
        match catch_unwind(AssertUnwindSafe(|| reader.take_a_turn())) {
            Ok(Turn::MayHoldMore) => true,
            Ok(Turn::Empty) => false,
            Ok(Turn::EnginePanicked) => {
                let topic = reader.topic_name.clone();
                tracing::error!(topic, "the DDS engine panicked while it was read");
                self.remove(token);
                false
            }
            Err(_) => {
                tracing::error!(
                    topic = reader.topic_name,
                    "what takes the samples panicked: this topic is not received any more"
                );
                self.remove(token);
                false
            }
        }
    }

    fn remove(&mut self, token: Token) {
        if let Some(mut reader) = self.readers.remove(&token) {
            let leave = || {
                let _ = rustdds::mio1::event::Source::deregister(&mut reader.reader, self.poll.registry());
                drop(reader);
            };
            // A panic of the engine here leaves nothing more to do for this reader.
            let _ = catch_unwind(AssertUnwindSafe(leave));
        }
    }

    fn hear_discovery(&mut self) {
        let hear = || {
            while let Some(event) = self.discovery.try_recv_status() {
                // Not under the lock: the handlers ask who is matched.
                let news = self.matches.lock().apply(event);
                news.deliver();
            }
        };
        if catch_unwind(AssertUnwindSafe(hear)).is_err() {
            tracing::error!(
                "the DDS engine panicked during discovery: numbers of matched peers may be wrong"
            );
        }
    }
}

impl ServedReader {
    fn take_a_turn(&mut self) -> Turn {
        self.reader.drain_read_notifications();
        for _ in 0..SAMPLES_PER_TURN {
            let Ok(taken) = catch_unwind(AssertUnwindSafe(|| self.reader.try_take_one())) else {
                return Turn::EnginePanicked;
            };
            match taken {
                Ok(None) => return Turn::Empty,
                Ok(Some(change)) => {
                    let sample = Sample {
                        source_time_ns: change.source_timestamp().and_then(unix_time_ns),
                        writer: gid(change.writer_guid()),
                        sequence_number: change.sequence_number.into(),
                        related: change.related_sample_identity().map(|identity| SampleIdentity {
                            endpoint: gid(identity.writer_guid),
                            number: identity.sequence_number.into(),
                        }),
                        cdr: change.into_value().0,
                    };
                    (self.on_sample)(sample);
                }
                Err(error) => {
                    if let Some(left_out) = self.unread.allow() {
                        tracing::warn!(topic = self.topic_name, %error, "a sample could not be read{left_out}");
                    }
                }
            }
        }
        Turn::MayHoldMore
    }
}

/// How a turn of a reader ended.
enum Turn {
    Empty,
    MayHoldMore,
    EnginePanicked,
}

fn register(reader: &mut DdsDataReader, registry: &Registry, token: Token) -> io::Result<()> {
    registry.register(reader, token, Interest::READABLE)
}

/// RTPS counts seconds and their fractions of 2^-32; nanoseconds are rounded to the nearest, so that a time
/// written in nanoseconds is read as the same.
fn unix_time_ns(timestamp: Timestamp) -> Option<i64> {
    if timestamp == Timestamp::INVALID || timestamp == Timestamp::INFINITE {
        return None;
    }
    let ticks = timestamp.to_ticks();
    let (seconds, fraction) = (ticks >> 32, ticks & 0xffff_ffff);
    let nanoseconds = (fraction * 1_000_000_000 + (1 << 31)) >> 32;
    i64::try_from(seconds * 1_000_000_000 + nanoseconds).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rtps_time_becomes_the_nearest_nanosecond() {
        let half_a_second = Timestamp::from_ticks((1 << 32) + (1 << 31));
        assert_eq!(unix_time_ns(half_a_second), Some(1_500_000_000));
        // 1 ns is 4.29 ticks; a peer sends 4.
        assert_eq!(unix_time_ns(Timestamp::from_ticks(4)), Some(1));
        assert_eq!(unix_time_ns(Timestamp::INVALID), None);
    }
}
