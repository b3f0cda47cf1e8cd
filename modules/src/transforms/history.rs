//! What is known of one frame: where it was in its parent, and when.

use super::Isometry;
use super::error::Direction;
use super::geometry::interpolate;
use downbeat_executor::Time;
use std::collections::VecDeque;
use std::time::Duration;

/// More samples than come in 10 s at 1 kHz; beyond it the oldest go earlier.
const MOST_SAMPLES: usize = 16_384;

/// Where a frame was at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    pub(super) time: Time,
    pub(super) parent: usize,
    pub(super) parent_from_frame: Isometry,
}

/// Where a frame was over time.
#[derive(Clone, Debug, Default)]
pub(super) enum History {
    /// Nobody said: the root of a tree.
    #[default]
    Nothing,
    /// Always there.
    Static(Sample),
    /// By time, without two of one time. Never empty.
    Moving(VecDeque<Sample>),
}

/// A time at which a frame is not known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Gap {
    pub(super) oldest: Time,
    pub(super) latest: Time,
    pub(super) direction: Direction,
    pub(super) by: Duration,
}

/// What became of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Insertion {
    New,
    Same,
    Replaced,
    TooOld(Duration),
}

impl History {
    /// Takes a sample of a moving frame, and forgets what is older than `kept`. A frame that was static moves from now on.
    pub(super) fn insert(&mut self, sample: Sample, kept: Duration) -> Insertion {
        let Self::Moving(samples) = self else {
            *self = Self::Moving(VecDeque::from([sample]));
            return Insertion::New;
        };
        if let Some(latest) = samples.back() {
            let age = latest.time.saturating_since(sample.time);
            if age > kept {
                return Insertion::TooOld(age);
            }
        }
        let after = samples.partition_point(|known| known.time <= sample.time);
        if let Some(known) = after.checked_sub(1).and_then(|before| samples.get_mut(before))
            && known.time == sample.time
        {
            let insertion = if *known == sample { Insertion::Same } else { Insertion::Replaced };
            *known = sample;
            return insertion;
        }
        samples.insert(after, sample);
        while samples.len() > MOST_SAMPLES || is_too_old(samples, kept) {
            samples.pop_front();
        }
        Insertion::New
    }

    /// Where the frame is at all times from now on.
    pub(super) fn fix(&mut self, sample: Sample) -> Insertion {
        let insertion = match self {
            Self::Static(known) if *known == sample => Insertion::Same,
            Self::Static(_) => Insertion::Replaced,
            Self::Nothing | Self::Moving(_) => Insertion::New,
        };
        *self = Self::Static(sample);
        insertion
    }

    /// Where the frame was, interpolated between two samples of the same parent; nothing for a root.
    pub(super) fn at(&self, time: Time) -> Result<Option<Sample>, Gap> {
        let samples = match self {
            Self::Nothing => return Ok(None),
            Self::Static(sample) => return Ok(Some(*sample)),
            Self::Moving(samples) => samples,
        };
        let (Some(first), Some(last)) = (samples.front(), samples.back()) else { return Ok(None) };
        let gap = |direction, by| Gap { oldest: first.time, latest: last.time, direction, by };
        let after = samples.partition_point(|sample| sample.time <= time);
        let Some(older) = after.checked_sub(1).and_then(|before| samples.get(before)) else {
            return Err(gap(Direction::Past, first.time.saturating_since(time)));
        };
        if older.time == time {
            return Ok(Some(*older));
        }
        let Some(newer) = samples.get(after) else {
            return Err(gap(Direction::Future, time.saturating_since(last.time)));
        };
        if older.parent != newer.parent {
            return Ok(Some(*older));
        }
        let passed = time.saturating_since(older.time).as_nanos() as f64;
        let ratio = passed / newer.time.saturating_since(older.time).as_nanos() as f64;
        let parent_from_frame = interpolate(&older.parent_from_frame, &newer.parent_from_frame, ratio);
        Ok(Some(Sample { time, parent: older.parent, parent_from_frame }))
    }

    /// The parent at a time, or at the nearest that is known.
    pub(super) fn parent_near(&self, time: Time) -> Option<usize> {
        match self {
            Self::Nothing => None,
            Self::Static(sample) => Some(sample.parent),
            Self::Moving(samples) => {
                let after = samples.partition_point(|sample| sample.time <= time);
                samples.get(after.saturating_sub(1)).map(|sample| sample.parent)
            }
        }
    }

    /// The last sample; of a static frame the only one.
    pub(super) fn latest(&self) -> Option<&Sample> {
        match self {
            Self::Nothing => None,
            Self::Static(sample) => Some(sample),
            Self::Moving(samples) => samples.back(),
        }
    }

    /// The first and the last time at which a moving frame is known.
    pub(super) fn span(&self) -> Option<(Time, Time)> {
        let Self::Moving(samples) = self else { return None };
        Some((samples.front()?.time, samples.back()?.time))
    }

    pub(super) fn is_static(&self) -> bool {
        matches!(self, Self::Static(_))
    }
}

fn is_too_old(samples: &VecDeque<Sample>, kept: Duration) -> bool {
    let ends = samples.front().zip(samples.back());
    ends.is_some_and(|(first, last)| last.time.saturating_since(first.time) > kept)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    fn sample(nanos: i64) -> Sample {
        let parent_from_frame = Isometry::from_translation(nanos as f64, 0.0, 0.0);
        Sample { time: Time::from_nanos(nanos), parent: 0, parent_from_frame }
    }

    #[test]
    fn what_is_older_than_is_kept_goes_and_does_not_come_back() {
        let mut history = History::default();
        for nanos in [0, 500_000_000, 1_000_000_000, 1_000_000_001] {
            assert_eq!(history.insert(sample(nanos), SECOND), Insertion::New);
        }
        assert_eq!(history.span(), Some((Time::from_nanos(500_000_000), Time::from_nanos(1_000_000_001))));
        let age = Duration::from_nanos(1_000_000_001);
        assert_eq!(history.insert(sample(0), SECOND), Insertion::TooOld(age));
    }

    #[test]
    fn samples_without_end_in_no_time_do_not_fill_the_memory() {
        let mut history = History::default();
        for nanos in 0..2 * MOST_SAMPLES as i64 {
            history.insert(sample(nanos), SECOND);
        }
        assert!(matches!(history, History::Moving(samples) if samples.len() == MOST_SAMPLES));
    }

    #[test]
    fn the_latest_of_two_samples_of_one_time_holds() {
        let mut history = History::default();
        assert_eq!(history.insert(sample(7), SECOND), Insertion::New);
        assert_eq!(history.insert(sample(7), SECOND), Insertion::Same);
        let other = Sample { parent: 3, ..sample(7) };
        assert_eq!(history.insert(other, SECOND), Insertion::Replaced);
        assert_eq!(history.at(Time::from_nanos(7)), Ok(Some(other)));
    }

    #[test]
    fn between_two_parents_the_older_one_holds() {
        let mut history = History::default();
        history.insert(sample(0), SECOND);
        history.insert(Sample { parent: 1, ..sample(10) }, SECOND);
        assert_eq!(history.at(Time::from_nanos(9)), Ok(Some(sample(0))));
        assert_eq!(history.parent_near(Time::from_nanos(11)), Some(1));
        assert_eq!(history.parent_near(Time::from_nanos(-1)), Some(0));
    }
}
