//! Options of a recording.

use std::time::Duration;

#[cfg(doc)]
use super::RecordingSender;

/// Options of a [`Recording`](super::Recording).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordingOptions {
    /// How many bytes of messages may be queued; `--max-cache-size`. A larger message is accepted if the
    /// queue is empty.
    pub cache_bytes: usize,
    /// Keeps the latest messages in memory and writes them only on
    /// [`RecordingControl::snapshot`](super::RecordingControl::snapshot); `--snapshot-mode`.
    pub snapshot: Option<SnapshotLimits>,
    /// Whether a snapshot begins with the last earlier messages of latched (transient local) topics.
    pub repeats_latched: bool,
    /// Whether the recording begins paused; `--start-paused`.
    pub is_paused: bool,
    /// What to do with a message if the cache is full.
    pub when_slow: WhenSlow,
}

/// The limits of a snapshot: the latest messages within both.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SnapshotLimits {
    /// Memory for messages, in bytes.
    pub max_bytes: usize,
    /// From the oldest to the latest message, by receive time.
    pub max_duration: Option<Duration>,
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

impl RecordingOptions {
    /// [`Recording::DEFAULT_QUEUE_BYTES`](super::Recording::DEFAULT_QUEUE_BYTES), everything is written at
    /// once.
    #[must_use]
    pub fn new() -> Self {
        Self {
            cache_bytes: super::Recording::DEFAULT_QUEUE_BYTES,
            snapshot: None,
            repeats_latched: false,
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

    /// Sets [`Self::repeats_latched`].
    #[must_use]
    pub fn repeat_latched(self) -> Self {
        Self { repeats_latched: true, ..self }
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
