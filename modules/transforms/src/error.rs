//! Why there is no transform, and why one was not taken.

use downbeat_executor::Time;
use std::time::Duration;
use thiserror::Error;

/// A frame cannot be found in another one at a time.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum LookupError {
    /// Nobody has told of a frame of that name.
    #[error("cannot look up \"{source_frame}\" in \"{target_frame}\": there is no frame \"{frame}\"{hint}")]
    UnknownFrame {
        /// The frame to express in.
        target_frame: String,
        /// The frame to be expressed.
        source_frame: String,
        /// The one that is not known.
        frame: String,
        /// The known frame whose name is most like it, or the known frames, as the end of a sentence.
        hint: String,
    },
    /// A link on the way is known, but not at that time.
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
        /// The frame whose transform to its parent is not known then.
        frame: String,
        /// The time asked for.
        requested: Time,
        /// The first time at which it is known.
        oldest: Time,
        /// The last time at which it is known.
        latest: Time,
        /// Before the first or after the last.
        direction: Direction,
        /// By how much.
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
        /// Where the way up from the target ends.
        target_root: String,
        /// Where the way up from the source ends.
        source_root: String,
    },
    /// Parents led back to a frame: transforms of different times contradict each other.
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

/// On which side of what is known a time lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Before all of it.
    Past,
    /// After all of it.
    Future,
}

impl std::fmt::Display for Direction {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Past => "past",
            Self::Future => "future",
        })
    }
}

/// A transform that a buffer does not take; the buffer is as it was.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum TransformRefused {
    /// It names no frame.
    #[error("a transform from \"{parent}\" to \"{child}\" names no {missing}")]
    NoFrame {
        /// `header.frame_id`.
        parent: String,
        /// `child_frame_id`.
        child: String,
        /// Which of the two.
        missing: &'static str,
    },
    /// It says where a frame is in itself.
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
    /// Its rotation is none.
    #[error("the rotation of \"{child}\" in \"{parent}\" is no unit quaternion: its norm is {norm}")]
    NotNormalized {
        /// `header.frame_id`.
        parent: String,
        /// `child_frame_id`.
        child: String,
        /// The norm of the quaternion.
        norm: f64,
    },
    /// It is older than what is kept.
    #[error("the transform of \"{frame}\" is {} s older than its latest one, and {} s are kept", age.as_secs_f64(), kept.as_secs_f64())]
    TooOld {
        /// `child_frame_id`.
        frame: String,
        /// How much older than the latest of that frame.
        age: Duration,
        /// How much is kept.
        kept: Duration,
    },
    /// With it the parents of a frame would lead back to that frame.
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
    #[error("frame \"{frame}\" is not taken: {limit} frames are known already")]
    TooManyFrames {
        /// The frame.
        frame: String,
        /// How many there may be.
        limit: usize,
    },
    /// A name is longer than any that a person reads.
    #[error("the name of a frame that begins with \"{beginning}\" is longer than {limit} bytes")]
    NameTooLong {
        /// Its first characters.
        beginning: String,
        /// How long it may be.
        limit: usize,
    },
}
