//! Determines when the messages of a bag are due.
//!
//! Nothing here reads a clock or waits: the caller passes readings of a steady clock and receives the next
//! step.

use std::time::Duration;

use crate::edit::TypeConflict;
use crate::reader::{BagMessage, Messages, Reader, ReaderError, Selection};
use crate::topic::TopicId;

/// The playback rate: bag time per real time. Always finite and above 0.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct Rate(f64);

impl Rate {
    /// The recorded rate.
    pub const ORIGINAL: Self = Self(1.0);

    /// Bag time per real time.
    #[must_use]
    pub fn as_f64(self) -> f64 {
        self.0
    }

    /// `2.0` is twice as fast.
    ///
    /// # Errors
    /// Returns an error if it is not finite or not above 0.
    pub fn new(rate: f64) -> Result<Self, PlayerError> {
        if rate.is_finite() && rate > 0.0 { Ok(Self(rate)) } else { Err(PlayerError::Rate { rate }) }
    }

    fn real_from_bag(self, bag: Duration) -> Duration {
        if self == Self::ORIGINAL {
            return bag;
        }
        Duration::try_from_secs_f64(bag.as_secs_f64() / self.0).unwrap_or(Duration::MAX)
    }

    fn bag_from_real(self, real: Duration) -> Duration {
        if self == Self::ORIGINAL {
            return real;
        }
        Duration::try_from_secs_f64(real.as_secs_f64() * self.0).unwrap_or(Duration::MAX)
    }
}

/// What to play and how.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaybackOptions {
    /// How fast.
    pub rate: Rate,
    /// The offset into the bag at which to start.
    pub start_offset: Duration,
    /// Names of the topics to play; `None` for all.
    pub topics: Option<Vec<String>>,
}

impl Default for PlaybackOptions {
    fn default() -> Self {
        Self { rate: Rate::ORIGINAL, start_offset: Duration::ZERO, topics: None }
    }
}

/// Why a bag cannot be played.
#[derive(Debug, thiserror::Error)]
pub enum PlayerError {
    /// The rate is invalid.
    #[error("cannot play at rate {rate}: a rate is a number above 0")]
    Rate {
        /// The requested value.
        rate: f64,
    },
    /// The bag has no such topic.
    #[error("cannot play topic {topic}: the bag has {}", known.join(", "))]
    UnknownTopic {
        /// The requested value.
        topic: String,
        /// The topics of the bag.
        known: Vec<String>,
    },
    /// The bags have a topic with different types.
    #[error(transparent)]
    Conflict(#[from] TypeConflict),
    /// The bag ends before the start.
    #[error("cannot start {offset:?} into the bag: it is {length:?} long")]
    StartOffset {
        /// The requested value.
        offset: Duration,
        /// From the first message to the last.
        length: Duration,
    },
    /// The bag cannot be read.
    #[error(transparent)]
    Read(#[from] ReaderError),
    /// The thread that reads ahead cannot be started.
    #[error("cannot start the thread that reads a bag: {0}")]
    Thread(#[source] std::io::Error),
}

/// The next action of the caller.
#[derive(Debug)]
pub enum Step {
    /// This message is due: publish it and call again.
    Due(BagMessage),
    /// Nothing is due until this much real time has passed.
    Wait(Duration),
    /// A gap before the next message was skipped; the bag's time is now that of the message. Only when
    /// [skipping gaps](Playback::skipping_gaps).
    Skipped(Gap),
    /// Nothing is due until [`Playback::resume`].
    Paused,
    /// A part of the bag cannot be read; the next call continues after it.
    Failed(ReaderError),
    /// All messages were returned, and playback starts again: only with a repeating
    /// [`Player`](crate::Player).
    Repeats,
    /// All messages were returned.
    Finished,
}

/// Computes when each message of a bag is due.
///
/// `now` is a reading of any steady clock, as the time since some origin. Playing starts at the first
/// reading. At that moment, the start of the bag plus the start offset is due.
pub struct Playback<M = Messages> {
    messages: M,
    next: Option<BagMessage>,
    rate: Rate,
    /// Bag time at which playing starts, in nanoseconds since the epoch.
    from: i64,
    /// The time of the last message, or that from which messages were to follow.
    previous: i64,
    skips_gaps: bool,
    clock: Clock,
}

/// A part of a bag without messages that is longer than [`Gap::LEAST`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// The time of the message before it, in nanoseconds since the epoch.
    pub from: i64,
    /// The time of the message after it.
    pub until: i64,
    /// The topic of that message.
    pub topic: TopicId,
}

impl Gap {
    /// A time without messages is worth telling if it is longer than this.
    pub const LEAST: Duration = Duration::from_secs(60);

    /// Its length.
    #[must_use]
    pub fn length(&self) -> Duration {
        Duration::from_nanos(self.until.abs_diff(self.from))
    }
}

#[derive(Clone, Copy)]
enum Clock {
    NotStarted,
    /// The reading at which playing would have started without pauses.
    Running(Duration),
    /// The real time played so far.
    Paused(Duration),
}

impl Playback {
    /// Prepares to play a bag.
    ///
    /// # Errors
    /// Returns an error if the bag lacks a requested topic, ends before the start offset, or cannot be read.
    pub fn open(reader: &Reader, options: &PlaybackOptions) -> Result<Self, PlayerError> {
        let start = reader.start_time().unwrap_or(0);
        let offset = i64::try_from(options.start_offset.as_nanos()).unwrap_or(i64::MAX);
        let from = start.saturating_add(offset);
        if let Some(end) = reader.end_time().filter(|&end| end < from) {
            let length = Duration::from_nanos(u64::try_from(end.saturating_sub(start)).unwrap_or(0));
            return Err(PlayerError::StartOffset { offset: options.start_offset, length });
        }
        let mut selection = Selection::all().from(from);
        if let Some(names) = &options.topics {
            let topics: Result<Vec<TopicId>, _> = names.iter().map(|name| find(reader, name)).collect();
            selection = selection.topics(topics?);
        }
        Ok(Self::new(reader.messages(selection)?, from, options.rate))
    }
}

impl<M: Iterator<Item = Result<BagMessage, ReaderError>>> Playback<M> {
    /// Plays messages sorted by log time, starting at bag time `from` (nanoseconds since the epoch).
    pub fn new(messages: M, from: i64, rate: Rate) -> Self {
        let (previous, skips_gaps, clock) = (from, false, Clock::NotStarted);
        Self { messages, next: None, rate, from, previous, skips_gaps, clock }
    }

    /// Continues at once after a [`Gap`] instead of waiting for its end.
    #[must_use]
    pub fn skipping_gaps(mut self, skips: bool) -> Self {
        self.skips_gaps = skips;
        self
    }

    /// The gap before the next message, while playback waits for its end or has just skipped it.
    #[must_use]
    pub fn gap(&self) -> Option<Gap> {
        let next = self.next.as_ref()?;
        let gap = Gap { from: self.previous, until: next.log_time, topic: next.topic };
        (gap.until > gap.from && gap.length() > Gap::LEAST).then_some(gap)
    }

    /// Returns the action at `now`.
    pub fn step(&mut self, now: Duration) -> Step {
        let started = match self.clock {
            Clock::Running(started) => started,
            Clock::Paused(_) => return Step::Paused,
            Clock::NotStarted => {
                self.clock = Clock::Running(now);
                now
            }
        };
        if self.next.is_none() {
            match self.messages.next() {
                Some(Ok(message)) => self.next = Some(message),
                Some(Err(error)) => return Step::Failed(error),
                None => return Step::Finished,
            }
        }
        let gap = self.gap();
        let Some(message) = self.next.take() else { return Step::Finished };
        if let Some(gap) = gap.filter(|_| self.skips_gaps) {
            self.next = Some(message);
            self.jump(now, gap.until);
            return Step::Skipped(gap);
        }
        let bag_time = u64::try_from(message.log_time.saturating_sub(self.from)).unwrap_or(0);
        let due = self.rate.real_from_bag(Duration::from_nanos(bag_time));
        let wait = due.saturating_sub(now.saturating_sub(started));
        if wait.is_zero() {
            self.previous = message.log_time;
            return Step::Due(message);
        }
        self.next = Some(message);
        Step::Wait(wait)
    }

    /// Stops the bag's time.
    pub fn pause(&mut self, now: Duration) {
        match self.clock {
            Clock::NotStarted => self.clock = Clock::Paused(Duration::ZERO),
            Clock::Running(started) => self.clock = Clock::Paused(now.saturating_sub(started)),
            Clock::Paused(_) => {}
        }
    }

    /// Resumes the bag's time where it was stopped.
    pub fn resume(&mut self, now: Duration) {
        if let Clock::Paused(played) = self.clock {
            self.clock = Clock::Running(now.saturating_sub(played));
        }
    }

    /// Continues at another rate.
    pub fn set_rate(&mut self, now: Duration, rate: Rate) {
        self.jump(now, self.bag_time(now));
        self.rate = rate;
    }

    /// Sets the bag's time, in nanoseconds since the epoch. The position in the messages does not change.
    pub(crate) fn jump(&mut self, now: Duration, bag_time: i64) {
        (self.from, self.previous) = (bag_time, bag_time);
        self.clock = match self.clock {
            Clock::Running(_) => Clock::Running(now),
            Clock::NotStarted => Clock::NotStarted,
            Clock::Paused(_) => Clock::Paused(Duration::ZERO),
        };
    }

    /// Continues with other messages.
    pub(crate) fn replace(&mut self, messages: M) {
        (self.messages, self.next) = (messages, None);
    }

    /// Returns the next message, due or not.
    pub(crate) fn take_next(&mut self) -> Option<Result<BagMessage, ReaderError>> {
        self.next.take().map(Ok).or_else(|| self.messages.next())
    }

    /// True between [`Playback::pause`] and [`Playback::resume`].
    #[must_use]
    pub fn is_paused(&self) -> bool {
        matches!(self.clock, Clock::Paused(_))
    }

    /// The playback rate.
    #[must_use]
    pub fn rate(&self) -> Rate {
        self.rate
    }

    /// The bag's time at `now`, in nanoseconds since the epoch: what to publish on `/clock`.
    #[must_use]
    pub fn bag_time(&self, now: Duration) -> i64 {
        let real = match self.clock {
            Clock::NotStarted => Duration::ZERO,
            Clock::Running(started) => now.saturating_sub(started),
            Clock::Paused(played) => played,
        };
        let bag = i64::try_from(self.rate.bag_from_real(real).as_nanos()).unwrap_or(i64::MAX);
        self.from.saturating_add(bag)
    }
}

fn find(reader: &Reader, name: &str) -> Result<TopicId, PlayerError> {
    reader.topic(name).ok_or_else(|| PlayerError::UnknownTopic {
        topic: name.to_owned(),
        known: reader.topics().iter().map(|topic| topic.info.name.clone()).collect(),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::time::Duration;

    use bytes::Bytes;

    use super::{Playback, Rate, Step};
    use crate::reader::{BagMessage, ReaderError};
    use crate::topic::TopicId;

    const ORIGIN: Duration = Duration::from_secs(500);

    fn messages(times: &[i64]) -> Vec<Result<BagMessage, ReaderError>> {
        let topic = TopicId::from_index(0).unwrap();
        let message =
            |time: &i64| Ok(BagMessage { topic, log_time: *time, publish_time: *time, data: Bytes::new() });
        times.iter().map(message).collect()
    }

    fn at(ms: u64) -> Duration {
        ORIGIN + Duration::from_millis(ms)
    }

    fn due(step: Step) -> i64 {
        let Step::Due(message) = step else { panic!("{step:?}") };
        message.log_time / 1_000_000
    }

    fn wait(step: Step) -> u128 {
        let Step::Wait(duration) = step else { panic!("{step:?}") };
        duration.as_millis()
    }

    const TIMES: [i64; 3] = [0, 100_000_000, 300_000_000];

    #[test]
    fn messages_are_due_at_their_distance_from_the_start() {
        let mut playback = Playback::new(messages(&TIMES).into_iter(), 0, Rate::ORIGINAL);
        assert_eq!(due(playback.step(at(0))), 0);
        assert_eq!(wait(playback.step(at(0))), 100);
        assert_eq!(wait(playback.step(at(99))), 1);
        assert_eq!(due(playback.step(at(100))), 100);
        assert_eq!(due(playback.step(at(350))), 300, "a late one is due at once");
        assert!(matches!(playback.step(at(350)), Step::Finished));
    }

    #[test]
    fn a_higher_rate_shortens_the_distances() {
        let mut playback = Playback::new(messages(&TIMES).into_iter(), 0, Rate::new(4.0).unwrap());
        assert_eq!(due(playback.step(at(0))), 0);
        assert_eq!(wait(playback.step(at(0))), 25);
        assert_eq!(due(playback.step(at(25))), 100);
        assert_eq!(wait(playback.step(at(25))), 50);
        assert_eq!(playback.bag_time(at(50)), 200_000_000);
    }

    #[test]
    fn a_gap_is_told_and_skipped_on_request() {
        let second = 1_000_000_000;
        let times = [0, second, 600 * second, 601 * second];
        let mut playback = Playback::new(messages(&times).into_iter(), 0, Rate::ORIGINAL);
        assert_eq!(due(playback.step(at(0))), 0);
        assert_eq!(wait(playback.step(at(0))), 1000);
        assert_eq!(playback.gap(), None, "a second is none");
        assert_eq!(due(playback.step(at(1000))), 1000);
        assert_eq!(wait(playback.step(at(1000))), 599_000);
        let gap = playback.gap().unwrap();
        assert_eq!((gap.from, gap.until, gap.length()), (second, 600 * second, Duration::from_secs(599)));

        for rate in [1.0, 4.0] {
            let rate = Rate::new(rate).unwrap();
            // The gap before the first message too, after a start offset.
            let from = -100 * second;
            let mut playback = Playback::new(messages(&times).into_iter(), from, rate).skipping_gaps(true);
            let mut now = at(0);
            let (mut played, mut skipped) = (Vec::new(), Vec::new());
            loop {
                match playback.step(now) {
                    Step::Due(message) => played.push((message.log_time / second, now - ORIGIN)),
                    Step::Wait(wait) => now += wait,
                    Step::Skipped(gap) => skipped.push(gap.length().as_secs()),
                    _ => break,
                }
            }
            let expected = [(0, 0.0), (1, 1.0), (600, 1.0), (601, 2.0)];
            let expected = expected.map(|(time, real)| (time, Duration::from_secs_f64(real / rate.as_f64())));
            assert_eq!(played, expected);
            assert_eq!(skipped, [100, 599]);
        }
    }

    #[test]
    fn bag_time_stands_still_while_paused() {
        let mut playback = Playback::new(messages(&TIMES).into_iter(), 0, Rate::ORIGINAL);
        assert_eq!(due(playback.step(at(0))), 0);
        playback.pause(at(40));
        assert!(matches!(playback.step(at(5000)), Step::Paused));
        assert_eq!(playback.bag_time(at(5000)), 40_000_000);
        playback.resume(at(5000));
        assert_eq!(wait(playback.step(at(5000))), 60);
    }

    #[test]
    fn invalid_rates_are_refused() {
        for rate in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(Rate::new(rate).is_err(), "{rate}");
        }
    }
}
