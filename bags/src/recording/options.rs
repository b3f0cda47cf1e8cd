//! Options of a recording.

#[cfg(doc)]
use super::RecordingSender;
use super::SnapshotLimits;

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
    pub(super) cache_bytes: usize,
    pub(super) snapshot: Option<SnapshotLimits>,
    pub(super) is_paused: bool,
    pub(super) when_slow: WhenSlow,
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

    /// How many bytes of messages may be queued; `--max-cache-size`. A larger message is accepted if the
    /// queue is empty.
    #[must_use]
    pub fn cache_bytes(self, cache_bytes: usize) -> Self {
        Self { cache_bytes, ..self }
    }

    /// Keeps the latest messages in memory and writes them only on
    /// [`RecordingControl::snapshot`](super::RecordingControl::snapshot); `--snapshot-mode`.
    #[must_use]
    pub fn snapshot(self, limits: SnapshotLimits) -> Self {
        Self { snapshot: Some(limits), ..self }
    }

    /// Whether messages are kept for snapshots.
    #[must_use]
    pub fn takes_snapshots(&self) -> bool {
        self.snapshot.is_some()
    }

    /// Starts paused; `--start-paused`.
    #[must_use]
    pub fn start_paused(self) -> Self {
        Self { is_paused: true, ..self }
    }

    /// What to do with a message if the cache is full.
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
