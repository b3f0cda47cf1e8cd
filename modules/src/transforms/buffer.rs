//! The frames that are known.

use super::error::TransformRefused;
use super::geometry::isometry;
use super::history::{History, Insertion, Sample};
use downbeat_executor::Time;
use downbeat_msgs::geometry_msgs::msg::TransformStamped;
use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

/// More frames than any robot has: names come from outside.
const MOST_FRAMES: usize = 4096;
const LONGEST_NAME: usize = 255;

/// Where frames were in their parents over the last seconds.
#[derive(Clone, Debug)]
pub struct TransformBuffer {
    kept: Duration,
    by_name: HashMap<Arc<str>, usize>,
    pub(super) names: Vec<Arc<str>>,
    pub(super) histories: Vec<History>,
}

/// What became of a transform.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// It is new.
    New,
    /// It was known already.
    Known,
    /// Another one of that frame and that time was known, and is forgotten: somebody publishes it twice.
    Replaced,
}

/// What is known of a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameInfo {
    /// Its name.
    pub name: Arc<str>,
    /// Its parent according to the latest transform; nothing for the root of a tree.
    pub parent: Option<Arc<str>>,
    /// True if it does not move in its parent.
    pub is_static: bool,
    /// The first and the last time at which it is known, if it moves.
    pub span: Option<(Time, Time)>,
}

impl TransformBuffer {
    /// How much is kept unless told otherwise (`tf2::BUFFER_CORE_DEFAULT_CACHE_TIME`).
    pub const KEPT: Duration = Duration::from_secs(10);

    /// An empty buffer that keeps 10 s.
    #[must_use]
    pub fn new() -> Self {
        Self::keeping(Self::KEPT)
    }

    /// An empty buffer that keeps of each frame what is so much older than its latest transform, up to 16384 of them.
    #[must_use]
    pub fn keeping(kept: Duration) -> Self {
        Self { kept, by_name: HashMap::new(), names: Vec::new(), histories: Vec::new() }
    }

    /// Takes a transform of `/tf`. It may come in any order; a frame that was static moves from now on.
    ///
    /// # Errors
    /// [`TransformRefused`]; nothing is changed then.
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

    /// Takes a transform of `/tf_static`: it holds at all times, until another one comes.
    ///
    /// # Errors
    /// [`TransformRefused`]; nothing is changed then.
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

    /// Forgets all, for example when time was set back.
    pub fn clear(&mut self) {
        *self = Self::keeping(self.kept);
    }

    /// The number of a frame, with or without a leading slash.
    pub(super) fn find(&self, name: &str) -> Option<usize> {
        self.by_name.get(name.strip_prefix('/').unwrap_or(name)).copied()
    }

    /// What a transform says, in numbers. The frames it names are known from then on.
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

    /// Walks up from the new parent: it must not come to the child.
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
