//! The known frames, and where each was in its parent.

use super::Isometry;
use super::error::{TimeDirection, TransformRefused};
use super::geometry::{interpolate, isometry};
use downbeat_executor::Time;
use downbeat_msgs::geometry_msgs::msg::TransformStamped;
use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

/// More frames than any robot has: names come from outside.
const MOST_FRAMES: usize = 4096;
const LONGEST_NAME: usize = 255;

/// The transforms of frames to their parents over the last seconds.
#[derive(Clone, Debug)]
pub struct TransformBuffer {
    kept: Duration,
    by_name: HashMap<Arc<str>, usize>,
    pub(super) names: Vec<Arc<str>>,
    pub(super) histories: Vec<History>,
}

/// The result of inserting a transform.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// It is new.
    New,
    /// It was known already.
    Known,
    /// It replaced a different one of the same frame and time: two publishers may conflict.
    Replaced,
}

/// Information about a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameInfo {
    /// Its name.
    pub name: Arc<str>,
    /// Its parent according to the latest transform; `None` for the root of a tree.
    pub parent: Option<Arc<str>>,
    /// True if it does not move in its parent.
    pub is_static: bool,
    /// The first and the last known time, if it moves.
    pub span: Option<(Time, Time)>,
}

impl TransformBuffer {
    /// The default duration of history (`tf2::BUFFER_CORE_DEFAULT_CACHE_TIME`).
    pub const KEPT: Duration = Duration::from_secs(10);

    /// An empty buffer that keeps 10 s of history.
    #[must_use]
    pub fn new() -> Self {
        Self::keeping(Self::KEPT)
    }

    /// An empty buffer that keeps this much history before the latest transform of each frame, up to 16384
    /// transforms.
    #[must_use]
    pub fn keeping(kept: Duration) -> Self {
        Self { kept, by_name: HashMap::new(), names: Vec::new(), histories: Vec::new() }
    }

    /// Inserts a transform from `/tf`, in any order. A static frame becomes a moving one.
    ///
    /// # Errors
    /// [`TransformRefused`]; then nothing is changed.
    pub fn insert(&mut self, transform: &TransformStamped) -> Result<Taken, TransformRefused> {
        let (frame, sample) = self.check(transform)?;
        let kept = self.kept;
        match self.histories[frame].insert(sample, kept) {
            Insertion::New => Ok(Taken::New),
            Insertion::Same => Ok(Taken::Known),
            Insertion::Replaced => Ok(Taken::Replaced),
            Insertion::TooOld(age) => {
                Err(TransformRefused::TooOld { frame: self.names[frame].to_string(), age, kept })
            }
        }
    }

    /// Inserts a transform from `/tf_static`, which is valid at all times until it is replaced.
    ///
    /// # Errors
    /// [`TransformRefused`]; then nothing is changed.
    pub fn insert_static(&mut self, transform: &TransformStamped) -> Result<Taken, TransformRefused> {
        let (frame, sample) = self.check(transform)?;
        Ok(match self.histories[frame].fix(sample) {
            Insertion::Same => Taken::Known,
            Insertion::Replaced => Taken::Replaced,
            Insertion::New | Insertion::TooOld(_) => Taken::New,
        })
    }

    /// The frames, in the order in which they were first named.
    pub fn frames(&self) -> impl Iterator<Item = FrameInfo> {
        self.names.iter().zip(&self.histories).map(|(name, history)| FrameInfo {
            name: Arc::clone(name),
            parent: history.latest().map(|sample| Arc::clone(&self.names[sample.parent])),
            is_static: history.is_static(),
            span: history.span(),
        })
    }

    /// Removes everything, for example after time went back.
    pub fn clear(&mut self) {
        *self = Self::keeping(self.kept);
    }

    /// The number of a frame, with or without a leading slash.
    pub(super) fn find(&self, name: &str) -> Option<usize> {
        self.by_name.get(name.strip_prefix('/').unwrap_or(name)).copied()
    }

    /// Validates a transform and converts it to numbers. Adds the frames it names.
    fn check(&mut self, transform: &TransformStamped) -> Result<(usize, Sample), TransformRefused> {
        let parent = transform.header.frame_id.strip_prefix('/').unwrap_or(&transform.header.frame_id);
        let child = transform.child_frame_id.strip_prefix('/').unwrap_or(&transform.child_frame_id);
        let both = || (parent.to_owned(), child.to_owned());
        for name in [parent, child] {
            if name.len() > LONGEST_NAME {
                let beginning = name.chars().take(32).collect();
                return Err(TransformRefused::NameTooLong { beginning, limit: LONGEST_NAME });
            }
        }
        for (name, missing) in [(parent, "parent (header.frame_id)"), (child, "frame (child_frame_id)")] {
            if name.is_empty() {
                let (parent, child) = both();
                return Err(TransformRefused::NoFrame { parent, child, missing });
            }
        }
        if parent == child {
            return Err(TransformRefused::OwnParent { frame: child.to_owned() });
        }
        let parent_from_frame = isometry(&transform.transform).map_err(|norm| {
            let (parent, child) = both();
            if norm.is_nan() {
                TransformRefused::NotFinite { parent, child }
            } else {
                TransformRefused::NotNormalized { parent, child, norm }
            }
        })?;
        let time = Time::from_nanos(transform.header.stamp.as_nanos());
        self.refuse_loop(parent, child, time)?;
        let new = [parent, child].iter().filter(|name| !self.by_name.contains_key(**name)).count();
        if self.names.len() + new > MOST_FRAMES {
            return Err(TransformRefused::TooManyFrames { frame: child.to_owned(), limit: MOST_FRAMES });
        }
        let (parent, frame) = (self.number_of(parent), self.number_of(child));
        Ok((frame, Sample { time, parent, parent_from_frame }))
    }

    /// Walks up from the new parent, which must not lead to the child.
    fn refuse_loop(&self, parent: &str, child: &str, time: Time) -> Result<(), TransformRefused> {
        let (Some(first), Some(last)) = (self.find(parent), self.find(child)) else { return Ok(()) };
        let up = |frame: &usize| self.histories[*frame].parent_near(time);
        let mut way = std::iter::successors(Some(first), up).take(self.names.len() + 1);
        if !way.any(|frame| frame == last) {
            return Ok(());
        }
        let way = std::iter::successors(Some(first), up).take_while(|&frame| frame != last).chain([last]);
        let way = way.map(|frame| self.names[frame].to_string()).collect();
        Err(TransformRefused::Loop { parent: parent.to_owned(), child: child.to_owned(), way })
    }

    fn number_of(&mut self, name: &str) -> usize {
        if let Some(&number) = self.by_name.get(name) {
            return number;
        }
        let (name, number) = (Arc::<str>::from(name), self.names.len());
        self.names.push(Arc::clone(&name));
        self.histories.push(History::default());
        self.by_name.insert(name, number);
        number
    }
}

impl Default for TransformBuffer {
    fn default() -> Self {
        Self::new()
    }
}

/// More samples than arrive in 10 s at 1 kHz; if exceeded, the oldest are dropped earlier.
const MOST_SAMPLES: usize = 16_384;

/// The transform of a frame at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    pub(super) time: Time,
    pub(super) parent: usize,
    pub(super) parent_from_frame: Isometry,
}

/// The transforms of a frame over time.
#[derive(Clone, Debug, Default)]
pub(super) enum History {
    /// Unknown: the root of a tree.
    #[default]
    Nothing,
    /// The same at all times.
    Static(Sample),
    /// Sorted by time, which is unique. Never empty.
    Moving(VecDeque<Sample>),
}

/// A time outside of the known range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Gap {
    pub(super) oldest: Time,
    pub(super) latest: Time,
    pub(super) direction: TimeDirection,
    pub(super) by: Duration,
}

/// The result of inserting a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Insertion {
    New,
    Same,
    Replaced,
    TooOld(Duration),
}

impl History {
    /// Inserts a sample of a moving frame, and drops samples older than `kept`. A static frame becomes a
    /// moving one.
    fn insert(&mut self, sample: Sample, kept: Duration) -> Insertion {
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

    /// Makes the frame static.
    fn fix(&mut self, sample: Sample) -> Insertion {
        let insertion = match self {
            Self::Static(known) if *known == sample => Insertion::Same,
            Self::Static(_) => Insertion::Replaced,
            Self::Nothing | Self::Moving(_) => Insertion::New,
        };
        *self = Self::Static(sample);
        insertion
    }

    /// The transform at a time, interpolated between two samples with the same parent; `None` for a root.
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
            return Err(gap(TimeDirection::Past, first.time.saturating_since(time)));
        };
        if older.time == time {
            return Ok(Some(*older));
        }
        let Some(newer) = samples.get(after) else {
            return Err(gap(TimeDirection::Future, time.saturating_since(last.time)));
        };
        if older.parent != newer.parent {
            return Ok(Some(*older));
        }
        let passed = time.saturating_since(older.time).as_nanos() as f64;
        let ratio = passed / newer.time.saturating_since(older.time).as_nanos() as f64;
        let parent_from_frame = interpolate(&older.parent_from_frame, &newer.parent_from_frame, ratio);
        Ok(Some(Sample { time, parent: older.parent, parent_from_frame }))
    }

    /// The parent at a time, or at the nearest known time.
    fn parent_near(&self, time: Time) -> Option<usize> {
        match self {
            Self::Nothing => None,
            Self::Static(sample) => Some(sample.parent),
            Self::Moving(samples) => {
                let after = samples.partition_point(|sample| sample.time <= time);
                samples.get(after.saturating_sub(1)).map(|sample| sample.parent)
            }
        }
    }

    /// The last sample; for a static frame the only one.
    pub(super) fn latest(&self) -> Option<&Sample> {
        match self {
            Self::Nothing => None,
            Self::Static(sample) => Some(sample),
            Self::Moving(samples) => samples.back(),
        }
    }

    /// The first and the last known time of a moving frame.
    pub(super) fn span(&self) -> Option<(Time, Time)> {
        let Self::Moving(samples) = self else { return None };
        Some((samples.front()?.time, samples.back()?.time))
    }

    fn is_static(&self) -> bool {
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
    fn samples_older_than_the_history_are_dropped_and_refused() {
        let mut history = History::default();
        for nanos in [0, 500_000_000, 1_000_000_000, 1_000_000_001] {
            assert_eq!(history.insert(sample(nanos), SECOND), Insertion::New);
        }
        assert_eq!(history.span(), Some((Time::from_nanos(500_000_000), Time::from_nanos(1_000_000_001))));
        let age = Duration::from_nanos(1_000_000_001);
        assert_eq!(history.insert(sample(0), SECOND), Insertion::TooOld(age));
    }

    #[test]
    fn endless_samples_do_not_fill_the_memory() {
        let mut history = History::default();
        for nanos in 0..2 * MOST_SAMPLES as i64 {
            history.insert(sample(nanos), SECOND);
        }
        assert!(matches!(history, History::Moving(samples) if samples.len() == MOST_SAMPLES));
    }

    #[test]
    fn the_later_of_two_samples_with_the_same_time_is_used() {
        let mut history = History::default();
        assert_eq!(history.insert(sample(7), SECOND), Insertion::New);
        assert_eq!(history.insert(sample(7), SECOND), Insertion::Same);
        let other = Sample { parent: 3, ..sample(7) };
        assert_eq!(history.insert(other, SECOND), Insertion::Replaced);
        assert_eq!(history.at(Time::from_nanos(7)), Ok(Some(other)));
    }

    #[test]
    fn between_two_parents_the_older_one_is_used() {
        let mut history = History::default();
        history.insert(sample(0), SECOND);
        history.insert(Sample { parent: 1, ..sample(10) }, SECOND);
        assert_eq!(history.at(Time::from_nanos(9)), Ok(Some(sample(0))));
        assert_eq!(history.parent_near(Time::from_nanos(11)), Some(1));
        assert_eq!(history.parent_near(Time::from_nanos(-1)), Some(0));
    }
}
