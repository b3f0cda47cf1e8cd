//! Reads arbitrary bytes as a bag file to the end: errors are permitted, but no panics and no unbounded
//! memory.

use std::path::Path;

use downbeat_bags::metadata::{Metadata, qos_from_yaml};
use downbeat_bags::{BagInfo, Reader, Selection, TopicSizes, check};

/// Runs once and returns whether the bytes could be opened.
pub fn run(bytes: &[u8]) -> bool {
    let is_bag = read(bytes);
    if let Ok(text) = std::str::from_utf8(bytes) {
        let path = Path::new("metadata.yaml");
        let metadata = Metadata::parse(text, path);
        if let Ok(metadata) = &metadata {
            let again = Metadata::parse(&metadata.to_yaml(), path);
            assert_eq!(again.map(|again| again.topics.len()).ok(), Some(metadata.topics.len()));
        }
        let _ = qos_from_yaml(text, path);
        return is_bag || metadata.is_ok();
    }
    is_bag
}

fn read(bytes: &[u8]) -> bool {
    let Ok(reader) = Reader::from_bytes("any.mcap", bytes.to_vec()) else { return false };
    // All messages, each with an existing topic.
    let sizes = TopicSizes::read(&reader, |_| {});
    let middle = reader.start_time().unwrap_or(0) / 2 + reader.end_time().unwrap_or(0) / 2;
    if let Ok(messages) = reader.messages(Selection::all().from(middle)) {
        // Sorted by time, whatever the file declares about its chunks.
        assert!(messages.flatten().all(|message| message.log_time >= middle));
    }
    if let Ok(mut info) = BagInfo::of(&reader) {
        info.sizes = sizes.ok();
        let _ = info.to_string();
    }
    let _ = check(&reader, |_| {});
    true
}
