//! From when to when the messages of a chunk, a file or a bag are.

use std::time::Duration;

/// The earliest and the latest time, in nanoseconds since the epoch.
#[derive(Clone, Copy, Default)]
pub(super) struct Times(Option<(i64, i64)>);

impl Times {
    pub(super) fn include(&mut self, time: i64) {
        self.merge(Self(Some((time, time))));
    }

    pub(super) fn merge(&mut self, other: Self) {
        self.0 = match (self.0, other.0) {
            (Some(a), Some(b)) => Some((a.0.min(b.0), a.1.max(b.1))),
            (one, None) | (None, one) => one,
        };
    }

    pub(super) fn first(self) -> Option<i64> {
        self.0.map(|(first, _)| first)
    }

    pub(super) fn last(self) -> Option<i64> {
        self.0.map(|(_, last)| last)
    }

    pub(super) fn duration(self) -> Duration {
        self.0.map_or(Duration::ZERO, |(first, last)| Duration::from_nanos(last.abs_diff(first)))
    }
}
