//! A recording from outside: pause, split, snapshot, stop.

use std::sync::Arc;

use super::Shared;
use super::queue::Item;
use crate::writer::FileSplit;

/// Pauses a [`Recording`](super::Recording), splits its bag, takes snapshots and stops it, from any thread.
#[derive(Clone)]
pub struct RecordingControl {
    shared: Arc<Shared>,
}

/// Why a recording does not do what it was asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ControlError {
    /// It keeps no messages for snapshots.
    #[error("cannot take a snapshot: recording is not in snapshot mode")]
    NoSnapshots,
    /// It has ended, or ended before it came to it.
    #[error("recording has ended")]
    Ended,
}

impl RecordingControl {
    pub(super) fn new(shared: Arc<Shared>) -> Self {
        Self { shared }
    }

    /// From now on what comes in is passed over, and not counted as lost. False if it was so already.
    pub fn pause(&self) -> bool {
        let mut was_paused = false;
        self.shared.queue.set_paused(|paused| {
            was_paused = paused;
            true
        });
        !was_paused
    }

    /// From now on what comes in is recorded again. False if it was so already.
    pub fn resume(&self) -> bool {
        let mut was_paused = false;
        self.shared.queue.set_paused(|paused| {
            was_paused = paused;
            false
        });
        was_paused
    }

    /// Pauses or resumes. Returns whether it is paused now.
    pub fn toggle_paused(&self) -> bool {
        self.shared.queue.set_paused(|paused| !paused)
    }

    /// Whether what comes in is passed over.
    #[must_use]
    pub fn is_paused(&self) -> bool {
        self.shared.queue.lock().is_paused
    }

    /// Goes on in a new file, behind all that came in until now. `on_done` is called when that is done, on the thread that
    /// writes; it must hand over and return.
    pub fn split(&self, on_done: impl FnOnce(Result<FileSplit, ControlError>) + Send + 'static) {
        // Dropped unanswered, a request answers itself.
        let _ = self.shared.queue.ask(Item::Split(Done::new(on_done)));
    }

    /// Writes the messages that are kept for that. `on_done` is called when the operating system has them, as that of
    /// [`RecordingControl::split`].
    pub fn snapshot(&self, on_done: impl FnOnce(Result<(), ControlError>) + Send + 'static) {
        if !self.shared.queue.keeps_snapshots() {
            return on_done(Err(ControlError::NoSnapshots));
        }
        let _ = self.shared.queue.snapshot(Item::Flush(Done::new(on_done)));
    }

    /// Hands all that came in until now to the operating system. `on_done` is called as that of [`RecordingControl::split`].
    pub fn flush(&self, on_done: impl FnOnce(Result<(), ControlError>) + Send + 'static) {
        let _ = self.shared.queue.ask(Item::Flush(Done::new(on_done)));
    }

    /// Writes what came in until now and ends the bag; what comes in from now on is refused. Returns at once:
    /// [`Recording::finish`](super::Recording::finish) waits.
    pub fn stop(&self) {
        self.shared.queue.close();
    }

    /// Whether it was stopped, or stopped by itself.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.shared.queue.is_closed()
    }
}

type Answer<T> = Box<dyn FnOnce(Result<T, ControlError>) + Send>;

/// Answers a request once: with what came of it, or, dropped before, that recording has ended.
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
