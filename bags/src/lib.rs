//! rosbag2 directories with MCAP or SQLite files: recording, reading, playback.
//!
//! ```
//! use bytes::Bytes;
//! use downbeat_bags::{BagInfo, Reader, Recording, Selection, TopicDescription, WriterOptions};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let folder = tempfile::tempdir()?;
//! let bag = folder.path().join("morning_run");
//!
//! // Record: the writer runs on its own thread, messages are CDR bytes.
//! let recording = Recording::start(WriterOptions::new().create(&bag)?, Recording::DEFAULT_QUEUE_BYTES)?;
//! let sender = recording.sender();
//! let chatter = sender.add_topic(TopicDescription {
//!     name: "/chatter".to_owned(),
//!     type_name: "std_msgs/msg/String".to_owned(),
//!     definition: "string data\n".to_owned(),
//!     type_hash: "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18".to_owned(),
//!     offered_qos: vec![downbeat_msgs::qos::QosProfile::DEFAULT.into()],
//!     format: None,
//! })?;
//! let hi = Bytes::from_static(b"\x00\x01\x00\x00\x03\x00\x00\x00hi\x00");
//! sender.record(chatter, 1_000_000_500, 1_000_000_000, hi.clone())?;
//! assert_eq!(recording.finish()?.message_count(), 1);
//!
//! // Read it back, and print its contents like `ros2 bag info`.
//! let reader = Reader::open(&bag)?;
//! for message in reader.messages(Selection::all())? {
//!     assert_eq!(message?.data, hi);
//! }
//! assert!(BagInfo::of(&reader)?.to_string().contains("Topic: /chatter | Type: std_msgs/msg/String | Count: 1"));
//! # Ok(())
//! # }
//! ```
//!
//! This crate depends on neither DDS nor message types: topics are described by text ([`TopicDescription`]),
//! messages are bytes. Times are nanoseconds since the epoch, as in ROS.
//!
//! The formats are those of ROS 2 Jazzy: metadata version 9 (`rosbag2_storage`), MCAP with profile `ros2`
//! (`rosbag2_storage_mcap`), and with the feature `sqlite` SQLite with schema version 4
//! (`rosbag2_storage_sqlite3`).

mod check;
mod compare;
mod diff;
mod edit;
mod info;
mod lz4;
pub mod metadata;
mod playback;
mod player;
mod read_ahead;
mod reader;
mod recording;
mod repeated;
mod sizes;
mod storage;
mod topic;
mod writer;
mod zstd;

pub use check::{Check, Problem, check, check_with};
pub use compare::{Comparer, FieldDifference, FieldRule, FieldRuleError};
pub use diff::{BagDiff, DiffOptions, MessageDiff, MessageDiffKind, TopicDiff, diff};
pub use edit::{Copied, Copy, CopyError, Merged, MergedBags, TypeConflict, reindex};
pub use info::{BagInfo, ServiceEvents};
pub use playback::{Gap, Playback, PlaybackOptions, PlayerError, Rate, Step};
pub use player::{Player, PlayerOptions};
pub use reader::{
    BagMessage, Messages, Reader, ReaderError, RecordedTopic, Selection, Truncation, TruncationCause,
};
pub use recording::{
    ControlError, RecordError, Recording, RecordingControl, RecordingFailed, RecordingOptions,
    RecordingSender, RecordingStatistics, SnapshotLimits, WhenSlow, finish_all,
};
pub use sizes::{ServiceCalls, TopicSizes};
pub use storage::Storage;
pub use topic::{MessageFormat, RecordingSummary, TopicCount, TopicDescription, TopicId};
pub use writer::{
    Compression, CompressionLevel, FileSplit, McapOptions, SplitLimits, StorageConfigError, StorageError,
    StorageOptions, StoragePreset, SyncPolicy, WhenDiskFull, WhenLow, Writer, WriterError, WriterOptions,
};
#[cfg(feature = "sqlite")]
pub use writer::{SqliteOptions, SqlitePreset};
