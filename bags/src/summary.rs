//! What a recording holds when it has ended.

use std::path::PathBuf;
use std::time::Duration;

/// What was recorded.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordingSummary {
    /// The bag directory.
    pub path: PathBuf,
    /// Size of the bag files in bytes.
    pub bytes: u64,
    /// How many files there are.
    pub files: usize,
    /// Messages in files that were deleted, since there would have been too many.
    pub deleted: u64,
    /// When the first message was received, in nanoseconds since the epoch; `None` without messages.
    pub starting_time: Option<i64>,
    /// From the first to the last message.
    pub duration: Duration,
    /// Every topic in the order in which they were added.
    pub topics: Vec<TopicCount>,
}

/// What was recorded of one topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicCount {
    /// Topic name.
    pub name: String,
    /// ROS type name.
    pub type_name: String,
    /// Messages in the bag.
    pub written: u64,
    /// Messages that were offered and are not in the bag.
    pub lost: u64,
}

impl RecordingSummary {
    /// Messages in the bag.
    #[must_use]
    pub fn message_count(&self) -> u64 {
        self.topics.iter().map(|topic| topic.written).sum()
    }

    /// Messages that were offered and are not in the bag.
    #[must_use]
    pub fn lost_count(&self) -> u64 {
        self.topics.iter().map(|topic| topic.lost).sum()
    }
}
