//! Recording on a separate thread, for producers that must not wait for a disk.

mod control;
mod options;
mod queue;
mod request;

use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Weak};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use bytes::Bytes;
use parking_lot::{Condvar, Mutex};

use crate::topic::{RecordingSummary, TopicCount, TopicDescription, TopicId};
use crate::writer::{Writer, WriterError};
pub use control::RecordingControl;
pub use options::{RecordingOptions, SnapshotLimits, WhenSlow};
use queue::{Item, Queue, QueuedTopic, Work};
pub use request::ControlError;

/// A [`Writer`] on its own thread.
///
/// Producers hold a [`RecordingSender`]. Nothing is dropped silently: if the queue is full, a message is
/// rejected with an error, counted for its topic, and reported in the [`RecordingSummary`] and in the bag
/// (`custom_data`, key `lost_messages`). Dropping a recording finishes it and logs errors.
pub struct Recording {
    sender: RecordingSender,
    thread: Option<JoinHandle<Result<RecordingSummary, RecordingFailed>>>,
}

/// Sends messages to a [`Recording`], from any thread.
#[derive(Clone)]
pub struct RecordingSender {
    shared: Arc<Shared>,
}

/// Statistics of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordingStatistics {
    /// The messages passed to the operating system, and those lost.
    pub summary: RecordingSummary,
    /// Bytes waiting to be written or for a snapshot.
    pub queued_bytes: usize,
    /// Whether messages are ignored.
    pub is_paused: bool,
    /// Whether the last chunk was dropped because the disk was full.
    pub is_disk_full: bool,
    /// Why recording stopped, if it failed.
    pub failure: Option<String>,
}

/// Why a message or a topic was rejected.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum RecordError {
    /// The disk is slower than the producers; the message is counted as lost.
    #[error(
        "a message of {topic} is not recorded ({lost} so far): the recording queue is full: messages arrive faster than they can be written"
    )]
    QueueFull {
        /// The topic.
        topic: String,
        /// The number of its messages lost so far.
        lost: u64,
    },
    /// Recording has ended, or stopped after a failed write; the message is counted as lost.
    #[error("a message is not recorded: recording has ended")]
    Stopped,
    /// The topic id does not belong to this recording.
    #[error("a message is not recorded: its topic does not belong to this recording")]
    UnknownTopic,
    /// A topic has one type.
    #[error("cannot record topic {topic} with type {second}: this bag has it with type {first}")]
    TypeConflict {
        /// The topic.
        topic: String,
        /// The type it was added with.
        first: String,
        /// The type of the second attempt.
        second: String,
    },
    /// MCAP times are unsigned.
    #[error("a message is not recorded: bags cannot represent times before 1970 ({time} ns)")]
    NegativeTime {
        /// The given time, in nanoseconds since the epoch.
        time: i64,
    },
    /// MCAP numbers channels with 16 bits.
    #[error("cannot record the topic: a bag holds at most 65534 topics")]
    TooManyTopics,
}

/// Recording stopped before it was requested.
#[derive(Debug, thiserror::Error)]
#[error("{error}")]
pub struct RecordingFailed {
    /// Why.
    #[source]
    pub error: WriterError,
    /// What was recorded and what was lost.
    pub summary: Box<RecordingSummary>,
}

struct Shared {
    queue: Queue,
    /// Updated after each batch.
    progress: Mutex<Progress>,
    /// The directory of the bag.
    path: PathBuf,
    has_ended: Mutex<bool>,
    ended: Condvar,
}

/// The recordings of this process, for [`finish_all`].
static RECORDINGS: Mutex<Vec<Weak<Shared>>> = Mutex::new(Vec::new());

/// Finishes all bags that this process records, for a process that is about to end without dropping its
/// [`Recording`]s. Further messages are rejected. Waits at most `patience`; returns the bags that are not
/// finished by then.
#[must_use = "the returned bags are not finished"]
pub fn finish_all(patience: Duration) -> Vec<PathBuf> {
    let until = Instant::now() + patience;
    let recordings: Vec<_> = RECORDINGS.lock().iter().filter_map(Weak::upgrade).collect();
    recordings.iter().for_each(|shared| shared.queue.close());
    let is_unfinished = |shared: &&Arc<Shared>| {
        let mut has_ended = shared.has_ended.lock();
        shared.ended.wait_while_until(&mut has_ended, |has_ended| !*has_ended, until);
        !*has_ended
    };
    recordings.iter().filter(is_unfinished).map(|shared| shared.path.clone()).collect()
}

struct Progress {
    summary: RecordingSummary,
    is_disk_full: bool,
    failure: Option<String>,
}

impl Recording {
    /// 64 MiB.
    pub const DEFAULT_QUEUE_BYTES: usize = 64 * 1024 * 1024;

    /// Starts the thread. At most `queue_bytes` are queued for writing.
    ///
    /// # Errors
    /// Returns an error if the thread cannot be started.
    pub fn start(writer: Writer, queue_bytes: usize) -> io::Result<Self> {
        Self::start_with(writer, &RecordingOptions::new().cache_bytes(queue_bytes))
    }

    /// Starts the thread.
    ///
    /// # Errors
    /// Returns an error if the thread cannot be started.
    pub fn start_with(writer: Writer, options: &RecordingOptions) -> io::Result<Self> {
        let topics = writer.topics().map(QueuedTopic::of);
        let shared = Arc::new(Shared {
            queue: Queue::new(options, topics.collect()),
            progress: Mutex::new(Progress::of(&writer)),
            path: writer.path().to_owned(),
            has_ended: Mutex::new(false),
            ended: Condvar::new(),
        });
        let of_thread = Arc::clone(&shared);
        let thread = std::thread::Builder::new().name("bag writer".to_owned()).spawn(move || {
            // Also if writing panics, when dropping the writer finishes the bag.
            let _end = End(&of_thread);
            run(&of_thread, writer)
        })?;
        let mut recordings = RECORDINGS.lock();
        recordings.retain(|shared| shared.strong_count() > 0);
        recordings.push(Arc::downgrade(&shared));
        drop(recordings);
        Ok(Self { sender: RecordingSender { shared }, thread: Some(thread) })
    }

    /// A handle for recording messages; can be cloned and sent to other threads.
    #[must_use]
    pub fn sender(&self) -> RecordingSender {
        self.sender.clone()
    }

    /// A handle to pause, split, take snapshots and stop; can be cloned and sent to other threads.
    #[must_use]
    pub fn control(&self) -> RecordingControl {
        RecordingControl::new(Arc::clone(&self.sender.shared))
    }

    /// The statistics of the recording.
    #[must_use]
    pub fn statistics(&self) -> RecordingStatistics {
        self.sender.statistics()
    }

    /// Writes queued messages and finishes the bag. Senders reject further messages.
    ///
    /// # Errors
    /// Returns an error if writing failed, now or earlier; the error contains the summary of what was
    /// recorded.
    pub fn finish(mut self) -> Result<RecordingSummary, RecordingFailed> {
        self.end().unwrap_or_else(|| Ok(self.statistics().summary))
    }

    fn end(&mut self) -> Option<Result<RecordingSummary, RecordingFailed>> {
        let shared = &self.sender.shared;
        shared.queue.close();
        // If the thread panicked, dropping its writer finished the bag; the counts are in the statistics.
        let outcome = self.thread.take()?.join().ok()?;
        Some(with_losses(shared, outcome))
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        if let Some(Err(failed)) = self.end() {
            tracing::error!("{failed}");
        }
    }
}

impl RecordingSender {
    /// The statistics of the recording.
    #[must_use]
    pub fn statistics(&self) -> RecordingStatistics {
        let mut statistics = {
            let progress = self.shared.progress.lock();
            let (summary, failure) = (progress.summary.clone(), progress.failure.clone());
            let is_disk_full = progress.is_disk_full;
            RecordingStatistics { summary, queued_bytes: 0, is_paused: false, is_disk_full, failure }
        };
        let state = self.shared.queue.lock();
        statistics.queued_bytes = state.held_bytes();
        statistics.is_paused = state.is_paused;
        add_losses(&mut statistics.summary, &state.topics);
        statistics
    }

    /// Adds a topic, at any time. Adding it again with the same type returns the existing id.
    ///
    /// # Errors
    /// Returns an error if the bag contains the topic with another type, or recording has ended.
    pub fn add_topic(&self, info: TopicDescription) -> Result<TopicId, RecordError> {
        self.shared.queue.add_topic(info)
    }

    /// Queues a message without ever waiting for the disk. For the arguments see [`Writer::write`].
    ///
    /// # Errors
    /// Returns an error if the queue is full or recording has ended; the message is counted as lost.
    pub fn record(
        &self,
        topic: TopicId,
        log_time: i64,
        publish_time: i64,
        data: Bytes,
    ) -> Result<(), RecordError> {
        self.shared.queue.try_add(topic, message(topic, log_time, publish_time, data)?)
    }

    /// Queues a message and waits for room in the queue if there is none.
    ///
    /// # Errors
    /// Returns an error if recording has ended; the message is counted as lost.
    pub fn record_blocking(
        &self,
        topic: TopicId,
        log_time: i64,
        publish_time: i64,
        data: Bytes,
    ) -> Result<(), RecordError> {
        self.shared.queue.add(topic, message(topic, log_time, publish_time, data)?)
    }
}

/// Rejects what the writer would reject.
fn message(topic: TopicId, log_time: i64, publish_time: i64, data: Bytes) -> Result<Item, RecordError> {
    let time = log_time.min(publish_time);
    if time < 0 {
        return Err(RecordError::NegativeTime { time });
    }
    Ok(Item::Message { topic, log_time, publish_time, data })
}

/// Marks a recording as ended when it is dropped.
struct End<'a>(&'a Shared);

impl Drop for End<'_> {
    fn drop(&mut self) {
        *self.0.has_ended.lock() = true;
        self.0.ended.notify_all();
    }
}

impl Progress {
    fn of(writer: &Writer) -> Self {
        Self { summary: writer.summary(), is_disk_full: writer.is_disk_full(), failure: None }
    }
}

/// Writes until the queue is closed or writing fails; the result does not include the losses of the queue.
fn run(shared: &Shared, mut writer: Writer) -> Result<RecordingSummary, RecordingFailed> {
    let outcome = write_all(shared, &mut writer).and_then(|()| refuse_overrun(shared, &writer));
    if let Err(error) = &outcome {
        shared.progress.lock().failure = Some(error.to_string());
    }
    note_losses(shared, &mut writer, &mut 0);
    let before = writer.summary();
    // After a failed write this returns the summary of what was recorded.
    let finished = writer.finish();
    let kept = finished.as_ref().map_or(before, Clone::clone);
    shared.progress.lock().summary = kept.clone();
    match outcome.and(finished) {
        Ok(_) => Ok(kept),
        Err(error) => Err(RecordingFailed { error, summary: Box::new(kept) }),
    }
}

/// Adds the losses of the queue so far, including those after the thread ended.
fn with_losses(
    shared: &Shared,
    mut outcome: Result<RecordingSummary, RecordingFailed>,
) -> Result<RecordingSummary, RecordingFailed> {
    let summary = match &mut outcome {
        Ok(summary) => summary,
        Err(failed) => &mut *failed.summary,
    };
    add_losses(summary, &shared.queue.lock().topics);
    outcome
}

/// Adds the losses of the queue to those of the writer. Topics that never reached the writer have no written
/// messages.
fn add_losses(summary: &mut RecordingSummary, queued: &[QueuedTopic]) {
    for (index, queued) in queued.iter().enumerate() {
        if let Some(topic) = summary.topics.get_mut(index) {
            topic.lost += queued.lost;
        } else {
            let (name, type_name) = (queued.name.clone(), queued.type_name.clone());
            summary.topics.push(TopicCount { name, type_name, written: 0, lost: queued.lost });
        }
    }
}

fn write_all(shared: &Shared, writer: &mut Writer) -> Result<(), WriterError> {
    let mut batch = Vec::new();
    let (mut written, mut noted, mut last_changes) = (0, 0, writer.changes());
    loop {
        note_losses(shared, writer, &mut noted);
        let timeout = writer.flush_if_due().inspect_err(|_| shared.queue.abandon([]))?;
        let work = shared.queue.take(&mut batch, written, timeout);
        written = Queue::cost(&batch);
        match work {
            Work::End => return Ok(()),
            Work::TimedOut => {}
            Work::Write => {
                let mut items = batch.drain(..);
                while let Some(item) = items.next() {
                    if let Err(error) = write(writer, item) {
                        shared.queue.abandon(items);
                        return Err(error);
                    }
                }
            }
        }
        if last_changes != writer.changes() {
            last_changes = writer.changes();
            *shared.progress.lock() = Progress::of(writer);
        }
    }
}

/// Fails if a recording that must stop rather than lose messages has lost one.
fn refuse_overrun(shared: &Shared, writer: &Writer) -> Result<(), WriterError> {
    if !shared.queue.lock().is_overrun {
        return Ok(());
    }
    Err(WriterError::TooSlow { path: writer.path().to_owned(), cache_bytes: shared.queue.limit() })
}

fn write(writer: &mut Writer, item: Item) -> Result<(), WriterError> {
    match item {
        Item::Topic(info) => writer.add_topic(*info).map(drop),
        Item::Message { topic, log_time, publish_time, data } => {
            writer.write(topic, log_time, publish_time, &data)
        }
        Item::Split(done) => writer.split().map(|split| done.send_result(Ok(split))),
        Item::Flush(done) => writer.flush().map(|()| done.send_result(Ok(()))),
    }
}

/// Notes the losses of the queue in the bag, if they have increased.
fn note_losses(shared: &Shared, writer: &mut Writer, noted: &mut u64) {
    let state = shared.queue.lock();
    if state.lost == *noted {
        return;
    }
    let mut has_all = true;
    for (index, topic) in state.topics.iter().enumerate().filter(|(_, topic)| topic.lost > 0) {
        let id = TopicId::from_index(index);
        // A topic may still be queued for the writer.
        has_all &= id.is_some_and(|id| writer.set_refused(id, topic.lost));
    }
    if has_all {
        *noted = state.lost;
    }
}

#[cfg(test)]
mod tests;
