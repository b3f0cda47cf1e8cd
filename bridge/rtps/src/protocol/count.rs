//! The counts of acknowledgements and heartbeats, which identify the newer of two messages.

use std::time::{Duration, Instant};

/// After this time without a message, a lower count is accepted: the peer has restarted.
const MEMORY: Duration = Duration::from_millis(500);

/// Farther from the last count, a count says nothing about the order of two messages.
const WINDOW: u32 = 4096;

/// The last received count.
///
/// Anybody can send a message in the name of a peer. A count far from the last one is therefore accepted once
/// without being stored, so that it does not make the following messages of the peer look old. It is stored
/// when a second message continues it.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct LastCount {
    last: Option<(u32, Instant)>,
    /// A count far from the last one.
    claimed: Option<u32>,
}

impl LastCount {
    /// Returns whether a message with `count` is new, and stores the count if it is.
    pub fn accept(&mut self, count: u32, now: Instant) -> bool {
        let Some((last, at)) = self.last else {
            self.last = Some((count, now));
            return true;
        };
        let (ahead, behind) = (count.wrapping_sub(last), last.wrapping_sub(count));
        let is_forgotten = now.saturating_duration_since(at) >= MEMORY;
        if ahead > WINDOW && behind > WINDOW {
            let is_continued =
                self.claimed.is_some_and(|claimed| (1..=WINDOW).contains(&count.wrapping_sub(claimed)));
            if is_continued {
                (self.last, self.claimed) = (Some((count, now)), None);
            } else {
                self.claimed = Some(count);
            }
            return true;
        }
        let is_news = (1..=WINDOW).contains(&ahead) || is_forgotten;
        if is_news {
            (self.last, self.claimed) = (Some((count, now)), None);
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

    #[test]
    fn a_count_far_ahead_does_not_make_the_next_ones_old() {
        let (mut last, now) = (LastCount::default(), Instant::now());
        assert!(last.accept(7, now));
        for forged in [i32::MAX as u32, 1 << 30, i32::MAX as u32] {
            assert!(last.accept(forged, now));
        }
        assert!(last.accept(8, now) && !last.accept(8, now) && !last.accept(7, now));
    }

    #[test]
    fn a_peer_may_continue_from_another_count() {
        let (mut last, now) = (LastCount::default(), Instant::now());
        assert!(last.accept(1_000_000, now) && last.accept(1, now) && last.accept(2, now));
        assert!(last.accept(3, now) && !last.accept(2, now));
    }
}
