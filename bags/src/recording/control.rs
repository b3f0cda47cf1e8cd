//! Control of a recording: pause, split, snapshot, stop.

use std::sync::Arc;

#[cfg(doc)]
use super::RecordingSender;
use super::queue::Item;
use super::{Shared, SnapshotLimits};
use crate::writer::FileSplit;

/// Pauses a [`Recording`](super::Recording), splits its bag, takes snapshots and stops it, from any thread.
#[derive(Clone)]
pub struct RecordingControl {
    shared: Arc<Shared>,
}

/// Why a request to a recording failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ControlError {
    /// It keeps no messages for snapshots.
    #[error("cannot take a snapshot: recording is not in snapshot mode")]
    NoSnapshots,
    /// It has ended, possibly before handling the request.
    #[error("recording has ended")]
    Ended,
}

impl RecordingControl {
    pub(super) fn new(shared: Arc<Shared>) -> Self {
        Self { shared }
    }

    /// Ignores messages from now on, without counting them as lost. Returns false if it was already paused.
    pub fn pause(&self) -> bool {
        let mut was_paused = false;
        self.shared.queue.set_paused(|paused| {
            was_paused = paused;
            true
        });
        !was_paused
    }

    /// Records messages again from now on. Returns false if it was not paused.
    pub fn resume(&self) -> bool {
        let mut was_paused = false;
        self.shared.queue.set_paused(|paused| {
            was_paused = paused;
            false
        });
        was_paused
    }

    /// Pauses or resumes. Returns whether it is now paused.
    pub fn toggle_paused(&self) -> bool {
        self.shared.queue.set_paused(|paused| !paused)
    }

    /// Returns whether messages are ignored.
    #[must_use]
    pub fn is_paused(&self) -> bool {
        self.shared.queue.lock().is_paused
    }

    /// Continues in a new file, after all messages received so far. `on_done` is called on the writing thread
    /// when that is done; it must return quickly.
    pub fn split(&self, on_done: impl FnOnce(Result<FileSplit, ControlError>) + Send + 'static) {
        // A request that is dropped reports that recording has ended.
        let _ = self.shared.queue.ask(Item::Split(Done::new(on_done)));
    }

    /// Writes the messages kept for snapshots. `on_done` is called when they are passed to the operating
    /// system, as in [`RecordingControl::split`].
    pub fn snapshot(&self, on_done: impl FnOnce(Result<(), ControlError>) + Send + 'static) {
        if !self.shared.queue.keeps_snapshots() {
            return on_done(Err(ControlError::NoSnapshots));
        }
        let _ = self.shared.queue.snapshot(Item::Flush(Done::new(on_done)));
    }

    /// Passes all messages received so far to the operating system. `on_done` is called as in
    /// [`RecordingControl::split`].
    pub fn flush(&self, on_done: impl FnOnce(Result<(), ControlError>) + Send + 'static) {
        let _ = self.shared.queue.ask(Item::Flush(Done::new(on_done)));
    }

    /// Writes the messages received so far and finishes the bag; later messages are rejected. Returns at
    /// once: [`Recording::finish`](super::Recording::finish) waits.
    pub fn stop(&self) {
        self.shared.queue.close();
    }

    /// Returns whether it was stopped, or stopped because of an error.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.shared.queue.is_closed()
    }
}

type Answer<T> = Box<dyn FnOnce(Result<T, ControlError>) + Send>;

/// Completes a request once: with its result or, if dropped before, with the error that recording has ended.
pub(super) struct Done<T> {
    answer: Option<Answer<T>>,
}

impl<T> Done<T> {
    fn new(answer: impl FnOnce(Result<T, ControlError>) + Send + 'static) -> Self {
        Self { answer: Some(Box::new(answer)) }
    }

    pub(super) fn send_result(mut self, result: Result<T, ControlError>) {
        if let Some(answer) = self.answer.take() {
            answer(result);
        }
    }
}

impl<T> Drop for Done<T> {
    fn drop(&mut self) {
        if let Some(answer) = self.answer.take() {
            answer(Err(ControlError::Ended));
        }
    }
}

/// What to do with a message if the cache is full: [`RecordingSender::record`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WhenSlow {
    /// Drop and count the message.
    #[default]
    Drop,
    /// Stop recording: the bag has no gaps, but ends early.
    Stop,
}

/// Options of a [`Recording`](super::Recording).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordingOptions {
    /// How many bytes of messages may be queued; `--max-cache-size`. A larger message is accepted if the queue is empty.
    pub cache_bytes: usize,
    /// Keeps the latest messages in memory and writes them only on
    /// [`RecordingControl::snapshot`](super::RecordingControl::snapshot); `--snapshot-mode`.
    pub snapshot: Option<SnapshotLimits>,
    /// Whether the recording begins paused; `--start-paused`.
    pub is_paused: bool,
    /// What to do with a message if the cache is full.
    pub when_slow: WhenSlow,
}

impl RecordingOptions {
    /// [`Recording::DEFAULT_QUEUE_BYTES`](super::Recording::DEFAULT_QUEUE_BYTES), everything is written at once.
    #[must_use]
    pub fn new() -> Self {
        Self {
            cache_bytes: super::Recording::DEFAULT_QUEUE_BYTES,
            snapshot: None,
            is_paused: false,
            when_slow: WhenSlow::default(),
        }
    }

    /// Sets [`Self::cache_bytes`].
    #[must_use]
    pub fn cache_bytes(self, cache_bytes: usize) -> Self {
        Self { cache_bytes, ..self }
    }

    /// Sets [`Self::snapshot`].
    #[must_use]
    pub fn snapshot(self, limits: SnapshotLimits) -> Self {
        Self { snapshot: Some(limits), ..self }
    }

    /// Returns whether messages are kept for snapshots.
    #[must_use]
    pub fn takes_snapshots(&self) -> bool {
        self.snapshot.is_some()
    }

    /// Sets [`Self::is_paused`].
    #[must_use]
    pub fn start_paused(self) -> Self {
        Self { is_paused: true, ..self }
    }

    /// Sets [`Self::when_slow`].
    #[must_use]
    pub fn when_slow(self, when_slow: WhenSlow) -> Self {
        Self { when_slow, ..self }
    }
}

impl Default for RecordingOptions {
    fn default() -> Self {
        Self::new()
    }
}
