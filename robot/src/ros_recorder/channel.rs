//! Messages of one topic on their way into the bag.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

use bytes::Bytes;
use downbeat_bags::{RecordingSender, TopicId};
use downbeat_bridge::middleware::Sample;
use downbeat_msgs::encoding::Codec;
use parking_lot::Mutex;

/// How many bytes wait for the definition of a type before they are recorded without it: 16 MiB.
const MOST_HELD: usize = 16 * 1024 * 1024;
/// The bound for bytes that arrive until that is noticed.
const LIMIT: usize = 8 * MOST_HELD;

/// The clock for times of reception.
#[derive(Clone, Debug)]
pub(super) enum RecorderClock {
    /// The clock of the machine.
    System,
    /// The time of `/clock`, 0 until one was received.
    Simulated(Arc<AtomicI64>),
}

impl RecorderClock {
    /// Nanoseconds since the epoch; nothing where time has not begun.
    pub(super) fn now(&self) -> Option<i64> {
        match self {
            Self::System => {
                let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
                Some(i64::try_from(since_epoch.as_nanos()).unwrap_or(i64::MAX))
            }
            Self::Simulated(time) => Some(time.load(Ordering::Relaxed)).filter(|time| *time > 0),
        }
    }
}

/// Takes the samples of a topic. Until its type is known they wait.
#[derive(Clone)]
pub(super) struct Channel {
    sender: RecordingSender,
    clock: RecorderClock,
    /// Whether who brings a message waits for room in the recording's cache.
    waits: bool,
    destination: Arc<Mutex<Destination>>,
}

enum Destination {
    /// In the order in which they came.
    Waiting {
        held: Vec<Held>,
        bytes: usize,
        lost: u64,
    },
    Open {
        topic: TopicId,
        codec: Option<Codec>,
    },
}

struct Held {
    received: i64,
    sent: i64,
    cdr: Bytes,
}

impl Channel {
    pub(super) fn new(sender: RecordingSender, clock: RecorderClock, waits: bool) -> Self {
        let destination = Destination::Waiting { held: Vec::new(), bytes: 0, lost: 0 };
        Self { sender, clock, waits, destination: Arc::new(Mutex::new(destination)) }
    }

    /// Takes a message as it comes.
    pub(super) fn take(&self, sample: Sample) {
        let Some(received) = self.clock.now() else { return };
        let sent = sample.source_time_ns.unwrap_or(received);
        let held = Held { received, sent, cdr: sample.cdr };
        match &mut *self.destination.lock() {
            Destination::Waiting { lost, bytes, .. } if *bytes + held.cdr.len() > LIMIT => *lost += 1,
            Destination::Waiting { held: waiting, bytes, .. } => {
                *bytes += held.cdr.len();
                waiting.push(held);
            }
            Destination::Open { topic, codec } => self.record(*topic, codec.as_ref(), held),
        }
    }

    /// Whether so much waits that it can wait no longer.
    pub(super) fn is_full(&self) -> bool {
        let destination = self.destination.lock();
        matches!(&*destination, Destination::Waiting { bytes, .. } if *bytes > MOST_HELD)
    }

    /// Lets what waits, and all that comes, into the bag.
    pub(super) fn open(&self, topic: TopicId, codec: Option<Codec>) {
        let mut destination = self.destination.lock();
        if let Destination::Waiting { held, lost, .. } = &mut *destination {
            if *lost > 0 {
                tracing::warn!(
                    "{lost} messages are lost: they came before the definition of their type was found"
                );
            }
            for held in held.drain(..) {
                self.record(topic, codec.as_ref(), held);
            }
        }
        *destination = Destination::Open { topic, codec };
    }

    fn record(&self, topic: TopicId, codec: Option<&Codec>, held: Held) {
        let data = match codec.map(|codec| codec.encode(&held.cdr)) {
            None => held.cdr,
            Some(Ok(data)) => data.into(),
            Some(Err(error)) => return tracing::warn!("a message is not recorded: {error}"),
        };
        let recorded = if self.waits {
            self.sender.record_blocking(topic, held.received, held.sent, data)
        } else {
            self.sender.record(topic, held.received, held.sent, data)
        };
        // The recording counts lost messages, and reports them at its end.
        if let Err(error) = recorded {
            tracing::debug!("{error}");
        }
    }
}
