//! Lookup of transforms between frames.

use super::buffer::{Gap, Sample, TransformBuffer};
use super::error::LookupError;
use super::geometry::transform_message;
use super::{Isometry, Stamped, Transformable};
use downbeat_executor::Time;
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::definitions::suggestion;
use downbeat_msgs::geometry_msgs::msg::TransformStamped;
use downbeat_msgs::std_msgs::msg::Header;

/// The time of a lookup.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum At {
    /// The latest time at which the whole path is known (time 0 in tf2).
    Latest,
    /// This time.
    Time(Time),
}

impl From<Time> for At {
    fn from(time: Time) -> Self {
        Self::Time(time)
    }
}

impl From<Stamp> for At {
    /// As in tf2, stamp 0 means the latest.
    fn from(stamp: Stamp) -> Self {
        if stamp == Stamp::default() { Self::Latest } else { Self::Time(Time::from_nanos(stamp.as_nanos())) }
    }
}

/// The transform between two frames.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundTransform {
    /// The frame to express in.
    pub target: String,
    /// The frame that is expressed.
    pub source: String,
    /// The requested time, or the latest at which the whole path is known. The epoch if the latest was
    /// requested and nothing moves.
    pub time: Time,
    /// Maps coordinates in the source to coordinates in the target.
    pub target_from_source: Isometry,
}

impl FoundTransform {
    /// The transform as a message.
    #[must_use]
    pub fn to_message(&self) -> TransformStamped {
        TransformStamped {
            header: Header { stamp: Stamp::from_nanos(self.time.as_nanos()), frame_id: self.target.clone() },
            child_frame_id: self.source.clone(),
            transform: transform_message(&self.target_from_source),
        }
    }
}

/// A lookup, for its errors.
#[derive(Clone, Copy)]
struct Query<'a> {
    target: &'a str,
    source: &'a str,
}

/// The path up from a frame: frames, each with the transform from the first frame.
struct Climb {
    frames: Vec<(usize, Isometry)>,
    /// The gap at which it ended, if any.
    gap: Option<(usize, Gap)>,
}

impl TransformBuffer {
    /// Looks up `source` in `target`: the transform that maps coordinates in the source to coordinates in the
    /// target.
    ///
    /// # Errors
    /// [`LookupError`]: a frame is unknown, or not known at that time.
    pub fn lookup(
        &self,
        target: &str,
        source: &str,
        at: impl Into<At>,
    ) -> Result<FoundTransform, LookupError> {
        let query = Query { target, source };
        let (to, from) = (self.frame(query, target)?, self.frame(query, source)?);
        let time = match at.into() {
            At::Time(time) => time,
            At::Latest => self.common_time(query, to, from)?.unwrap_or(Time::ZERO),
        };
        let target_from_source = self.find_at(query, to, from, time)?;
        Ok(FoundTransform { target: target.to_owned(), source: source.to_owned(), time, target_from_source })
    }

    /// Looks up `source` at `source_time` in `target` at `target_time`, for objects that are at rest in
    /// `fixed`: for example the position of a ball seen a second ago, relative to the robot that has moved
    /// since.
    ///
    /// # Errors
    /// Those of [`lookup`](Self::lookup), for both halves of the path.
    pub fn lookup_through(
        &self,
        target: &str,
        target_time: impl Into<At>,
        source: &str,
        source_time: impl Into<At>,
        fixed: &str,
    ) -> Result<FoundTransform, LookupError> {
        let fixed_from_source = self.lookup(fixed, source, source_time)?.target_from_source;
        let found = self.lookup(target, fixed, target_time)?;
        let target_from_source = found.target_from_source * fixed_from_source;
        Ok(FoundTransform { source: source.to_owned(), target_from_source, ..found })
    }

    /// The latest time at which the whole path between two frames is known; `None` if no part of it moves.
    ///
    /// # Errors
    /// [`LookupError`] if a frame is unknown, or the two are not connected.
    pub fn latest_common_time(&self, target: &str, source: &str) -> Result<Option<Time>, LookupError> {
        let query = Query { target, source };
        self.common_time(query, self.frame(query, target)?, self.frame(query, source)?)
    }

    /// Expresses a stamped value in another frame, at the time of its stamp, or the latest if that is 0.
    ///
    /// # Errors
    /// Those of [`lookup`](Self::lookup).
    pub fn transform<T: Stamped + Transformable>(&self, value: &T, target: &str) -> Result<T, LookupError> {
        let Header { stamp, frame_id } = value.header();
        let found = self.lookup(target, frame_id, *stamp)?;
        let mut transformed = value.transformed(&found.target_from_source);
        let header = Header { stamp: Stamp::from_nanos(found.time.as_nanos()), frame_id: found.target };
        *transformed.header_mut() = header;
        Ok(transformed)
    }

    fn frame(&self, query: Query<'_>, name: &str) -> Result<usize, LookupError> {
        self.find(name).ok_or_else(|| LookupError::UnknownFrame {
            target_frame: query.target.to_owned(),
            source_frame: query.source.to_owned(),
            frame: name.to_owned(),
            hint: match self.names.is_empty() {
                true => "; no frames are known yet".into(),
                false => suggestion(name, &self.names),
            },
        })
    }

    fn find_at(
        &self,
        query: Query<'_>,
        target: usize,
        source: usize,
        time: Time,
    ) -> Result<Isometry, LookupError> {
        let step = |frame: usize| self.histories[frame].at(time);
        let from_source = self.climb(query, source, |frame| frame == target, step)?;
        let met = |frame: usize| from_source.frames.iter().find(|(passed, _)| *passed == frame);
        let from_target = self.climb(query, target, |frame| met(frame).is_some(), step)?;
        let meeting = from_target.frames.last().and_then(|(frame, there_from_target)| {
            let (_, there_from_source) = met(*frame)?;
            Some(there_from_target.inverse() * *there_from_source)
        });
        // The path from the target ends in a gap only if the two have not met before.
        match (meeting, from_target.gap.or(from_source.gap)) {
            (Some(target_from_source), _) => Ok(target_from_source),
            (None, Some((frame, gap))) => Err(self.extrapolation(query, frame, gap, time)),
            (None, None) => Err(self.not_connected(query, &from_target, &from_source)),
        }
    }

    fn common_time(
        &self,
        query: Query<'_>,
        target: usize,
        source: usize,
    ) -> Result<Option<Time>, LookupError> {
        if target == source {
            return Ok(self.histories[target].span().map(|(_, latest)| latest));
        }
        let step = |frame: usize| Ok(self.histories[frame].latest().copied());
        let from_source = self.climb(query, source, |frame| frame == target, step)?;
        let position = |frame: usize| from_source.frames.iter().position(|(passed, _)| *passed == frame);
        let from_target = self.climb(query, target, |frame| position(frame).is_some(), step)?;
        let Some(meeting) = from_target.frames.last().and_then(|(frame, _)| position(*frame)) else {
            return Err(self.not_connected(query, &from_target, &from_source));
        };
        let links =
            from_source.frames[..meeting].iter().chain(&from_target.frames[..from_target.frames.len() - 1]);
        Ok(links.filter_map(|&(frame, _)| self.histories[frame].span()).map(|(_, latest)| latest).min())
    }

    /// Walks up from a frame to a root, a gap, or the frame selected by `is_end`.
    fn climb(
        &self,
        query: Query<'_>,
        start: usize,
        is_end: impl Fn(usize) -> bool,
        step: impl Fn(usize) -> Result<Option<Sample>, Gap>,
    ) -> Result<Climb, LookupError> {
        let (mut frame, mut frame_from_start) = (start, Isometry::IDENTITY);
        let mut frames = vec![(frame, frame_from_start)];
        while !is_end(frame) {
            let sample = match step(frame) {
                Ok(Some(sample)) => sample,
                Ok(None) => break,
                Err(gap) => return Ok(Climb { frames, gap: Some((frame, gap)) }),
            };
            (frame, frame_from_start) = (sample.parent, sample.parent_from_frame * frame_from_start);
            frames.push((frame, frame_from_start));
            if frames.len() > self.names.len() {
                return Err(LookupError::Loop {
                    target_frame: query.target.to_owned(),
                    source_frame: query.source.to_owned(),
                    frame: self.names[frame].to_string(),
                });
            }
        }
        Ok(Climb { frames, gap: None })
    }

    fn extrapolation(&self, query: Query<'_>, frame: usize, gap: Gap, requested: Time) -> LookupError {
        let Gap { oldest, latest, direction, by } = gap;
        LookupError::Extrapolation {
            target_frame: query.target.to_owned(),
            source_frame: query.source.to_owned(),
            frame: self.names[frame].to_string(),
            requested,
            oldest,
            latest,
            direction,
            by,
        }
    }

    fn not_connected(&self, query: Query<'_>, from_target: &Climb, from_source: &Climb) -> LookupError {
        let root = |climb: &Climb| {
            climb.frames.last().map(|(frame, _)| self.names[*frame].to_string()).unwrap_or_default()
        };
        LookupError::NotConnected {
            target_frame: query.target.to_owned(),
            source_frame: query.source.to_owned(),
            target_root: root(from_target),
            source_root: root(from_source),
        }
    }
}
