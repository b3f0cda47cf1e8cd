//! The summary of a finished recording.

use std::path::PathBuf;
use std::time::Duration;

/// The summary of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordingSummary {
    /// The bag directory.
    pub path: PathBuf,
    /// Size of the bag files in bytes.
    pub bytes: u64,
    /// The number of files.
    pub files: usize,
    /// The number of messages in files that were deleted to keep the maximum number of files.
    pub deleted: u64,
    /// The receive time of the first message, in nanoseconds since the epoch; `None` without messages.
    pub starting_time: Option<i64>,
    /// From the first to the last message.
    pub duration: Duration,
    /// Every topic in the order in which they were added.
    pub topics: Vec<TopicCount>,
}

/// The summary of one topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicCount {
    /// Topic name.
    pub name: String,
    /// ROS type name.
    pub type_name: String,
    /// The number of messages in the bag.
    pub written: u64,
    /// The number of messages that were not recorded.
    pub lost: u64,
}

impl RecordingSummary {
    /// The number of messages in the bag.
    #[must_use]
    pub fn message_count(&self) -> u64 {
        self.topics.iter().map(|topic| topic.written).sum()
    }

    /// The number of messages that were not recorded.
    #[must_use]
    pub fn lost_count(&self) -> u64 {
        self.topics.iter().map(|topic| topic.lost).sum()
    }
}
