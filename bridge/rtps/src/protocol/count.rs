//! The counts of acknowledgements and heartbeats, which identify the newer of two messages.

use std::time::{Duration, Instant};

/// After this time without a message, a lower count is accepted: the peer has restarted.
const MEMORY: Duration = Duration::from_millis(500);

/// The last received count.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct LastCount(Option<(u32, Instant)>);

impl LastCount {
    /// Returns whether a message with `count` is new, and stores the count if it is.
    pub fn accept(&mut self, count: u32, now: Instant) -> bool {
        let is_news = self.0.is_none_or(|(last, at)| {
            count.wrapping_sub(last).cast_signed() > 0 || now.saturating_duration_since(at) >= MEMORY
        });
        if is_news {
            self.0 = Some((count, now));
        }
        is_news
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_rise_unless_the_peer_was_silent() {
        let (mut last, now) = (LastCount::default(), Instant::now());
        assert!(last.accept(u32::MAX, now) && last.accept(0, now) && last.accept(5, now));
        assert!(!last.accept(5, now) && !last.accept(4, now + MEMORY / 2));
        assert!(last.accept(1, now + MEMORY) && last.accept(2, now + MEMORY));
    }
}
