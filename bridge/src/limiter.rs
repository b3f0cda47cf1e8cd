//! A limit for lines that others can cause: a peer that sends nonsense must not fill the log.

use parking_lot::Mutex;
use std::fmt;
use std::time::{Duration, Instant};

/// Lets the first lines through, then one for each interval, which says how many were left out.
#[derive(Debug, Default)]
pub struct Limiter {
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    allowed: u32,
    left_out: u64,
    last: Option<Instant>,
}

/// How many lines were left out since the last one; displayed as an empty string for zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LeftOut(u64);

impl Limiter {
    /// Lines that are let through at once.
    const FIRST: u32 = 5;
    /// From one line to the next after these.
    const INTERVAL: Duration = Duration::from_secs(10);

    /// Whether a line is to be logged, to which the number of those that were not is appended.
    #[must_use]
    pub fn allow(&self) -> Option<LeftOut> {
        self.allow_at(Instant::now())
    }

    fn allow_at(&self, now: Instant) -> Option<LeftOut> {
        let mut state = self.state.lock();
        let is_due = state.last.is_none_or(|last| now.saturating_duration_since(last) >= Self::INTERVAL);
        if state.allowed >= Self::FIRST && !is_due {
            state.left_out += 1;
            return None;
        }
        state.allowed = state.allowed.saturating_add(1);
        state.last = Some(now);
        Some(LeftOut(std::mem::take(&mut state.left_out)))
    }
}

impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            0 => Ok(()),
            more => write!(f, " (and {more} more like it)"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn after_the_first_lines_one_for_each_interval_counts_the_others() {
        let limiter = Limiter::default();
        let start = Instant::now();
        let at = |millis: u64| limiter.allow_at(start + Duration::from_millis(millis));
        let allowed = (0..1000).filter_map(at).count();
        assert_eq!(allowed, 5);
        assert_eq!(
            at(11_000).map(|left_out| left_out.to_string()).as_deref(),
            Some(" (and 995 more like it)")
        );
        assert_eq!(at(12_000), None);
        assert_eq!(at(22_000), Some(LeftOut(1)));
        assert_eq!(at(40_000).map(|left_out| left_out.to_string()).as_deref(), Some(""));
    }
}
