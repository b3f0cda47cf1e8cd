//! Errors of lookups and of inserting transforms.

use downbeat_executor::Time;
use std::time::Duration;
use thiserror::Error;

/// A lookup failed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum LookupError {
    /// There is no frame with that name.
    #[error("cannot look up \"{source_frame}\" in \"{target_frame}\": there is no frame \"{frame}\"{hint}")]
    UnknownFrame {
        /// The frame to express in.
        target_frame: String,
        /// The frame to be expressed.
        source_frame: String,
        /// The unknown frame.
        frame: String,
        /// The known frame whose name is most like it, or the known frames, as the end of a sentence.
        hint: String,
    },
    /// A transform on the path is known, but not at that time.
    #[error(
        "cannot look up \"{source_frame}\" in \"{target_frame}\" at {requested}: it would require extrapolation {}.{:09} s \
         into the {direction} of \"{frame}\", which is known from {oldest} to {latest}",
        by.as_secs(), by.subsec_nanos()
    )]
    Extrapolation {
        /// The frame to express in.
        target_frame: String,
        /// The frame to be expressed.
        source_frame: String,
        /// The frame whose transform to its parent is not known at that time.
        frame: String,
        /// The requested time.
        requested: Time,
        /// The first time at which it is known.
        oldest: Time,
        /// The last time at which it is known.
        latest: Time,
        /// Before the first or after the last.
        direction: TimeDirection,
        /// The distance to the known range.
        by: Duration,
    },
    /// The frames belong to different trees.
    #[error(
        "cannot look up \"{source_frame}\" in \"{target_frame}\": they are not connected; \"{source_frame}\" belongs to the \
         tree below \"{source_root}\", \"{target_frame}\" to the tree below \"{target_root}\""
    )]
    NotConnected {
        /// The frame to express in.
        target_frame: String,
        /// The frame to be expressed.
        source_frame: String,
        /// The root of the target's tree.
        target_root: String,
        /// The root of the source's tree.
        source_root: String,
    },
    /// The parents of a frame lead back to it: transforms of different times contradict each other.
    #[error(
        "cannot look up \"{source_frame}\" in \"{target_frame}\": the parents of \"{frame}\" lead back to it"
    )]
    Loop {
        /// The frame to express in.
        target_frame: String,
        /// The frame to be expressed.
        source_frame: String,
        /// A frame of the loop.
        frame: String,
    },
}

/// On which side of the known range a time is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeDirection {
    /// Before all of it.
    Past,
    /// After all of it.
    Future,
}

impl std::fmt::Display for TimeDirection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Past => "past",
            Self::Future => "future",
        })
    }
}

/// A transform was rejected; the buffer is unchanged.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum TransformRefused {
    /// It names no frame.
    #[error("a transform from \"{parent}\" to \"{child}\" names no {missing}")]
    NoFrame {
        /// `header.frame_id`.
        parent: String,
        /// `child_frame_id`.
        child: String,
        /// The missing name.
        missing: &'static str,
    },
    /// Parent and child are the same frame.
    #[error("frame \"{frame}\" is its own parent")]
    OwnParent {
        /// The frame.
        frame: String,
    },
    /// A number in it is not finite.
    #[error("the transform of \"{child}\" in \"{parent}\" holds a number that is not finite")]
    NotFinite {
        /// `header.frame_id`.
        parent: String,
        /// `child_frame_id`.
        child: String,
    },
    /// Its rotation is not a unit quaternion.
    #[error("the rotation of \"{child}\" in \"{parent}\" is not a unit quaternion: its norm is {norm}")]
    NotNormalized {
        /// `header.frame_id`.
        parent: String,
        /// `child_frame_id`.
        child: String,
        /// The norm of the quaternion.
        norm: f64,
    },
    /// It is older than the kept history.
    #[error("the transform of \"{frame}\" is {} s older than its latest one, but only {} s are kept", age.as_secs_f64(), kept.as_secs_f64())]
    TooOld {
        /// `child_frame_id`.
        frame: String,
        /// How much older than the latest of that frame.
        age: Duration,
        /// The kept history.
        kept: Duration,
    },
    /// It would create a loop.
    #[error("\"{parent}\" cannot be the parent of \"{child}\", which is an ancestor of it: {}", way.join(" is in "))]
    Loop {
        /// `header.frame_id`.
        parent: String,
        /// `child_frame_id`.
        child: String,
        /// From the parent up to the child.
        way: Vec<String>,
    },
    /// There are more frames than any robot has.
    #[error("frame \"{frame}\" is rejected: {limit} frames are already known")]
    TooManyFrames {
        /// The frame.
        frame: String,
        /// The maximum number.
        limit: usize,
    },
    /// A name is unreasonably long.
    #[error("the name of a frame that starts with \"{beginning}\" is longer than {limit} bytes")]
    NameTooLong {
        /// Its first characters.
        beginning: String,
        /// The maximum length.
        limit: usize,
    },
}
