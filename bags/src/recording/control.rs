//! Control of a recording: pause, split, snapshot, stop.

use std::sync::Arc;

use super::Shared;
use super::queue::Item;
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

    /// Whether messages are ignored.
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

    /// Whether it was stopped, or stopped because of an error.
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

    pub(super) fn tell(mut self, result: Result<T, ControlError>) {
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
