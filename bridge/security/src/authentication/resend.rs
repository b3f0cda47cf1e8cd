//! When a message that was not answered is sent again.

use std::time::{Duration, Instant};

const FIRST: Duration = Duration::from_millis(125);
const LONGEST: Duration = Duration::from_secs(5);

/// Ever longer delays, as Fast DDS has them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Resend {
    pub(super) next: Instant,
    delay: Duration,
    pub(super) count: u32,
}

impl Resend {
    /// A message that is sent now for the first time.
    pub(super) fn new(now: Instant) -> Self {
        Self { next: now + FIRST, delay: FIRST, count: 0 }
    }

    /// A message that is sent for the first time after a delay.
    pub(super) fn after(delay: Duration, now: Instant) -> Self {
        Self { next: now + delay, delay, count: 0 }
    }

    /// Returns whether to send again.
    pub(super) fn is_due(&mut self, now: Instant) -> bool {
        if now < self.next {
            return false;
        }
        self.delay = (self.delay * 3 / 2).min(LONGEST);
        self.next = now + self.delay;
        self.count += 1;
        true
    }
}
