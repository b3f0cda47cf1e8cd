//! Control of a recording: pause, split, snapshot, stop.

use std::sync::Arc;
use std::time::Duration;

use super::Shared;
use super::queue::Item;
use super::request::{ControlError, Done};
use crate::writer::FileSplit;

/// Pauses a [`Recording`](super::Recording), splits its bag, takes snapshots and stops it, from any thread.
#[derive(Clone)]
pub struct RecordingControl {
    shared: Arc<Shared>,
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

    /// Writes the messages kept for snapshots before a time, and those received until `after` it: when the
    /// first later message arrives, or recording ends. Returns false if nothing is kept for snapshots, or
    /// recording has ended.
    pub fn snapshot_around(&self, time: i64, after: Duration) -> bool {
        let after = i64::try_from(after.as_nanos()).unwrap_or(i64::MAX);
        self.shared.queue.snapshot_around(time, time.saturating_add(after))
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
