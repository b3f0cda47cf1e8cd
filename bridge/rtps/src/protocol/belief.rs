//! Which sequence numbers a reader believes.
//!
//! Anybody can send a datagram in the name of a writer, and one HEARTBEAT, GAP or sample with an absurd
//! number would make the reader wait for numbers that the writer never reaches. Four rules limit that:
//!
//! - A number beyond what a writer can have reached since it was last heard is a claim. It has no effect
//!   until a second message continues it, and the writer is asked for a heartbeat meanwhile.
//! - A sample that was given up but arrives is a reason to ask the writer for a heartbeat.
//! - Samples of a best-effort writer below one that was delivered are late, unless they form a series that
//!   was also written over some time ([`Belief::doubt_order`]): a reader that was suspended receives together
//!   what had been sent before.
//! - Heartbeats that end before the next expected sample are doubted first. If the writer, asked again,
//!   insists ([`Belief::doubt`]), the reader goes back.

use crate::wire::Timestamp;
use std::time::{Duration, Instant};

/// How many numbers a writer may skip without any time passing.
const SLACK: i64 = 4096;
/// More samples per millisecond than any writer produces.
const RATE_PER_MS: u128 = 1000;
/// A contradiction must last this long: samples and heartbeats overtake each other in the network, and a
/// reader that was suspended receives together what had been sent before.
const DOUBT: Duration = Duration::from_millis(250);
/// Messages farther apart do not continue a contradiction: the reader asks again and again, and at first more
/// often.
const LULL: Duration = Duration::from_secs(1);
/// The number of samples of a best-effort writer that contradict another one.
const STALE_SAMPLES: u32 = 3;

/// The numbers that a writer is believed to have reached.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Belief {
    /// The highest number that was believed, and when the writer was last heard.
    reached: Option<(i64, Instant)>,
    /// The number of an unbelievable message.
    claim: Option<i64>,
    /// When the first and the last of consecutive contradicting messages came, and their number.
    doubted: Option<(Instant, Instant, u32)>,
    /// The last of these samples.
    stale: i64,
    /// When the first of these samples was written, by the clock of its host, if it says so.
    stale_since: Option<Timestamp>,
}

impl Belief {
    /// Returns whether `number` is beyond what the writer can have reached. Anything is possible for a writer
    /// that was never heard.
    pub fn is_far(&self, number: i64, now: Instant) -> bool {
        let Some((reached, at)) = self.reached else { return false };
        let ahead = number.saturating_sub(reached).saturating_sub(SLACK);
        // The time is needed seldom.
        ahead > 0
            && u128::from(ahead.unsigned_abs()) > now.saturating_duration_since(at).as_millis() * RATE_PER_MS
    }

    /// Returns whether a message that says that the writer has reached `number` is believed.
    pub fn believes(&mut self, number: i64, now: Instant) -> bool {
        if self.is_far(number, now) {
            let continues = |claim: i64| (claim..=claim.saturating_add(SLACK)).contains(&number);
            if !self.claim.is_some_and(continues) {
                self.claim = Some(number);
                return false;
            }
        }
        let reached = self.reached.map_or(number, |(reached, _)| reached.max(number));
        (self.reached, self.claim) = (Some((reached, now)), None);
        true
    }

    /// Records a message that does not contradict the expected numbers.
    pub fn trust(&mut self) {
        self.doubted = None;
    }

    /// Records a heartbeat that ends before numbers that were already given up or delivered. Returns whether
    /// the writer insists, so that it is right.
    pub fn doubt(&mut self, now: Instant) -> bool {
        let continued = self.doubted.filter(|(_, last, _)| now.saturating_duration_since(*last) <= LULL);
        let (since, _, count) = continued.unwrap_or((now, now, 0));
        self.doubted = Some((since, now, count.saturating_add(1)));
        count > 0 && now.saturating_duration_since(since) >= DOUBT
    }

    /// Records a sample of a best-effort writer that is older than one that was delivered. Returns whether it
    /// is one of a series, so that the number of the other one was wrong.
    pub fn doubt_order(&mut self, number: i64, written: Option<Timestamp>, now: Instant) -> bool {
        if number == self.stale && self.doubted.is_some() {
            // Another fragment of the same sample.
            return false;
        }
        let previous = self.doubted.filter(|_| self.stale < number);
        if previous.is_none() {
            self.stale_since = written;
        }
        let (since, _, count) = previous.unwrap_or((now, now, 0));
        (self.doubted, self.stale) = (Some((since, now, count.saturating_add(1))), number);
        let was_written_over_time = self.stale_since.zip(written).is_none_or(|(first, last)| {
            last.to_nanos().saturating_sub(first.to_nanos()) >= DOUBT.as_nanos() as i64
        });
        count + 1 >= STALE_SAMPLES && now.saturating_duration_since(since) >= DOUBT && was_written_over_time
    }

    /// Forgets all numbers above `number`, which turned out to be wrong.
    pub fn go_back(&mut self, number: i64, now: Instant) {
        *self = Self { reached: Some((number, now)), ..Self::default() };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn a_jump_is_believed_after_enough_time_or_if_it_is_continued() {
        let (mut belief, start) = (Belief::default(), Instant::now());
        assert!(belief.believes(1 << 40, start));
        assert!(belief.believes((1 << 40) + SLACK, start));
        assert!(!belief.believes(1 << 50, start + MS));
        assert!(!belief.believes(1 << 61, start + MS));
        assert!(belief.believes((1 << 61) + 1, start + MS));
        belief.go_back(5, start + 2 * MS);
        assert!(!belief.believes(100_000, start + 3 * MS));
        assert!(belief.believes(150_000, start + 203 * MS));
    }

    #[test]
    fn one_late_message_does_not_cast_doubt() {
        let (mut belief, start) = (Belief::default(), Instant::now());
        assert!(!belief.doubt(start) && !belief.doubt(start + MS));
        belief.trust();
        assert!(!belief.doubt(start + 100 * MS) && !belief.doubt(start + 101 * MS));
        assert!(belief.doubt(start + 351 * MS));
        assert!(!belief.doubt(start + 1_352 * MS) && !belief.doubt(start + 2_353 * MS));
    }

    #[test]
    fn reordered_samples_do_not_cast_doubt() {
        let (mut belief, start) = (Belief::default(), Instant::now());
        for number in [9, 8, 7, 6] {
            assert!(!belief.doubt_order(number, None, start + 100 * MS));
        }
        for (number, ms) in [(7, 105), (8, 110), (9, 115), (10, 300)] {
            assert!(!belief.doubt_order(number, None, start + ms * MS));
        }
        assert!(belief.doubt_order(11, None, start + 350 * MS));
    }

    #[test]
    fn samples_that_were_written_together_and_come_late_do_not_cast_doubt() {
        let (mut belief, start) = (Belief::default(), Instant::now());
        let written = |ms: i64| Some(Timestamp::from_nanos(1_700_000_000_000_000_000 + ms * 1_000_000));
        for (number, ms) in [(12, 10), (13, 5_000), (14, 35_000)] {
            assert!(!belief.doubt_order(number, written(number), start + ms * MS));
        }
        assert!(belief.doubt_order(15, written(35_005), start + 35_005 * MS));
    }
}
