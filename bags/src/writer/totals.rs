//! The totals of a bag so far: the summary of the recording, and the metadata of the bag.

use std::collections::BTreeMap;

use super::split::WrittenFile;
use super::times::Times;
use super::{Topic, Writer};
use crate::metadata::{self, FileMetadata, Metadata, TopicMetadata};
use crate::topic::{RecordingSummary, TopicCount};

/// The key of `custom_data` for the numbers of lost messages: `/camera: 12, /imu: 1`.
const LOST_MESSAGES: &str = "lost_messages";
/// The key of `custom_data` for the numbers of repeated messages: `/map: 3`.
const REPEATED_MESSAGES: &str = "repeated_messages";
/// The key of `custom_data` for the number of messages in deleted files.
const DELETED_MESSAGES: &str = "deleted_messages";

impl Writer {
    /// The messages passed to the operating system so far, without the open chunk.
    #[must_use]
    pub fn summary(&self) -> RecordingSummary {
        let times = self.times();
        RecordingSummary {
            path: self.directory.clone(),
            bytes: self.file.kept() + self.files.iter().map(|file| file.bytes).sum::<u64>(),
            files: self.files.len(),
            deleted: self.deleted,
            starting_time: times.first(),
            duration: times.duration(),
            topics: self
                .topics
                .iter()
                .map(|topic| TopicCount {
                    name: topic.info.name.clone(),
                    type_name: topic.info.type_name.clone(),
                    written: topic.written,
                    lost: topic.lost,
                })
                .collect(),
        }
    }

    /// The number of changes of [`summary`](Self::summary).
    pub(crate) fn changes(&self) -> u64 {
        self.changes
    }

    pub(super) fn metadata(&self) -> Metadata {
        let times = self.times();
        Metadata {
            version: self.options.metadata_version,
            storage_identifier: self.storage().identifier().to_owned(),
            duration: times.duration(),
            starting_time: times.first().unwrap_or(metadata::NEVER),
            message_count: self.topics.iter().map(|topic| topic.written).sum(),
            topics: self.topics.iter().map(topic_metadata).collect(),
            compression_format: String::new(),
            compression_mode: String::new(),
            relative_file_paths: self.files.iter().map(|file| file.name.clone()).collect(),
            files: self.files.iter().map(file_metadata).collect(),
            custom_data: self.custom_data(),
            oddities: Vec::new(),
            ros_distro: self.options.ros_distro.clone(),
        }
    }

    fn custom_data(&self) -> BTreeMap<String, String> {
        let mut custom_data = self.options.custom_data.clone();
        let counted = self.options.counted_data.iter().map(|(key, value)| (key.clone(), (value.0)()));
        custom_data.extend(counted);
        let lost = |topic: &Topic| {
            let lost = topic.lost + topic.refused;
            (lost > 0).then(|| format!("{}: {lost}", topic.info.name))
        };
        let losses: Vec<String> = self.topics.iter().filter_map(lost).collect();
        if !losses.is_empty() {
            custom_data.insert(LOST_MESSAGES.to_owned(), losses.join(", "));
        }
        let repeated = |topic: &Topic| {
            let repeated = topic.latched.as_ref()?.repeated;
            (repeated > 0).then(|| format!("{}: {repeated}", topic.info.name))
        };
        let copies: Vec<String> = self.topics.iter().filter_map(repeated).collect();
        if !copies.is_empty() {
            custom_data.insert(REPEATED_MESSAGES.to_owned(), copies.join(", "));
        }
        if self.deleted > 0 {
            custom_data.insert(DELETED_MESSAGES.to_owned(), self.deleted.to_string());
        }
        custom_data
    }

    fn times(&self) -> Times {
        self.files.iter().fold(Times::default(), |mut times, file| {
            times.merge(file.times);
            times
        })
    }
}

fn topic_metadata(topic: &Topic) -> TopicMetadata {
    TopicMetadata {
        name: topic.info.name.clone(),
        type_name: topic.info.type_name.clone(),
        serialization_format: topic.info.message_encoding().to_owned(),
        offered_qos: topic.info.offered_qos.clone(),
        type_hash: topic.info.type_hash.clone(),
        message_count: topic.written,
    }
}

fn file_metadata(file: &WrittenFile) -> FileMetadata {
    let first = file.times.first();
    FileMetadata {
        path: file.name.clone(),
        starting_time: first.unwrap_or(metadata::NEVER),
        duration: file.times.duration(),
        message_count: file.message_count(),
    }
}
