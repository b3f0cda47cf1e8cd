//! Keeps what may happen a thousand times a second out of the log.

use std::time::{Duration, Instant};

/// One line a minute.
const PERIOD: Duration = Duration::from_secs(60);

/// Says when a line may be logged.
#[derive(Debug, Default)]
pub(super) struct LogLimit {
    last: Option<Instant>,
}

impl LogLimit {
    /// True at most once a minute.
    pub(super) fn allow(&mut self) -> bool {
        let now = Instant::now();
        let is_allowed = self.last.is_none_or(|last| now.duration_since(last) >= PERIOD);
        if is_allowed {
            self.last = Some(now);
        }
        is_allowed
    }
}
