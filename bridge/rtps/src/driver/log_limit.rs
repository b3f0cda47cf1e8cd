//! Limits log messages about events that can happen a thousand times per second.

use std::time::{Duration, Instant};

/// At most one message in this time.
const PERIOD: Duration = Duration::from_secs(60);

/// Decides when a message may be logged.
#[derive(Debug, Default)]
pub(super) struct LogLimit {
    last: Option<Instant>,
}

impl LogLimit {
    /// Returns true at most once a minute.
    pub(super) fn allow(&mut self) -> bool {
        let now = Instant::now();
        let is_allowed = self.last.is_none_or(|last| now.duration_since(last) >= PERIOD);
        if is_allowed {
            self.last = Some(now);
        }
        is_allowed
    }
}
