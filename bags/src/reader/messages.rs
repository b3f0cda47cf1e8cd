//! The messages of a bag in the order in which they were received.
//!
//! Segments are loaded when the time of the next message reaches their first one, so memory holds the segments that
//! overlap in time (usually one per file), not the bag.

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap, HashMap, VecDeque};
use std::fs::File;
use std::path::PathBuf;

use bytes::Bytes;

use super::Reader;
use super::error::ReaderError;
use super::records::RecordFile;
use super::segment::{Content, Segment, decode};
use crate::topic::TopicId;

/// A recorded message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagMessage {
    /// Its topic in [`Reader::topics`].
    pub topic: TopicId,
    /// When it was received, in nanoseconds since the epoch.
    pub log_time: i64,
    /// When it was sent, in nanoseconds since the epoch.
    pub publish_time: i64,
    /// The message as it was recorded: CDR bytes with their encapsulation header.
    pub data: Bytes,
}

/// Which messages to read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selection {
    topics: Option<BTreeSet<TopicId>>,
    from: i64,
}

impl Selection {
    /// All messages.
    #[must_use]
    pub fn all() -> Self {
        Self { topics: None, from: i64::MIN }
    }

    /// Only these topics.
    #[must_use]
    pub fn topics(self, topics: impl IntoIterator<Item = TopicId>) -> Self {
        Self { topics: Some(topics.into_iter().collect()), ..self }
    }

    /// Only messages received at this time, in nanoseconds since the epoch, or later.
    #[must_use]
    pub fn from(self, from: i64) -> Self {
        Self { from, ..self }
    }

    fn includes(&self, topic: TopicId, log_time: i64) -> bool {
        log_time >= self.from && self.topics.as_ref().is_none_or(|topics| topics.contains(&topic))
    }
}

impl Default for Selection {
    fn default() -> Self {
        Self::all()
    }
}

/// The messages of a bag in log time order; messages with the same time in file order. Made by [`Reader::messages`].
///
/// A part that cannot be read gives one error; the messages behind it follow.
pub struct Messages {
    files: Vec<OpenFile>,
    selection: Selection,
    /// Not yet loaded, sorted by first log time.
    segments: VecDeque<(usize, Segment)>,
    loaded: BinaryHeap<Reverse<Pending>>,
}

struct OpenFile {
    path: PathBuf,
    input: RecordFile,
    topics: HashMap<u16, TopicId>,
}

/// A loaded message; sorted by log time, then by its place in the bag.
struct Pending {
    /// Log time, file, segment, number in the segment.
    order: (u64, usize, u64, usize),
    message: BagMessage,
}

impl Messages {
    pub(super) fn open(reader: &Reader, selection: Selection) -> Result<Self, ReaderError> {
        let mut files = Vec::new();
        let mut segments = Vec::new();
        for (index, file) in reader.files.iter().enumerate() {
            let input = File::open(&file.path)
                .and_then(RecordFile::new)
                .map_err(|source| ReaderError::Read { path: file.path.clone(), source })?;
            let topics = reader.topics_of_channels[index].clone();
            files.push(OpenFile { path: file.path.clone(), input, topics });
            let wanted = file.segments.iter().filter(|segment| signed(segment.last) >= selection.from);
            segments.extend(wanted.map(|segment| (index, *segment)));
        }
        segments.sort_by_key(|(file, segment)| (segment.first, *file, segment.offset));
        Ok(Self { files, selection, segments: segments.into(), loaded: BinaryHeap::new() })
    }

    fn load(&mut self, file_index: usize, segment: &Segment) -> Result<(), ReaderError> {
        let file = &mut self.files[file_index];
        let bytes = file
            .input
            .seek(segment.offset)
            .and_then(|()| file.input.read(segment.length))
            .map_err(|source| ReaderError::Read { path: file.path.clone(), source })?;
        let mut number = 0;
        let mut found = Vec::new();
        decode(&bytes, |content| {
            let Content::Message { header, data } = content else { return };
            number += 1;
            let Some(&topic) = file.topics.get(&header.channel_id) else { return };
            let log_time = signed(header.log_time);
            if self.selection.includes(topic, log_time) {
                found.push(Pending {
                    order: (header.log_time, file_index, segment.offset, number),
                    message: BagMessage {
                        topic,
                        log_time,
                        publish_time: signed(header.publish_time),
                        data: Bytes::copy_from_slice(data),
                    },
                });
            }
        })
        .map_err(|found| ReaderError::Damaged {
            path: file.path.clone(),
            offset: segment.offset,
            found,
        })?;
        self.loaded.extend(found.into_iter().map(Reverse));
        Ok(())
    }
}

impl Iterator for Messages {
    type Item = Result<BagMessage, ReaderError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let next_time = self.loaded.peek().map(|Reverse(pending)| pending.order.0);
            let is_needed =
                |(_, segment): &(usize, Segment)| next_time.is_none_or(|time| segment.first <= time);
            if self.segments.front().is_some_and(is_needed) {
                let (file, segment) = self.segments.pop_front()?;
                if let Err(error) = self.load(file, &segment) {
                    return Some(Err(error));
                }
                continue;
            }
            return self.loaded.pop().map(|Reverse(pending)| Ok(pending.message));
        }
    }
}

impl PartialEq for Pending {
    fn eq(&self, other: &Self) -> bool {
        self.order == other.order
    }
}

impl Eq for Pending {}

impl PartialOrd for Pending {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Pending {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.order.cmp(&other.order)
    }
}

/// ROS times are signed; what lies beyond (the year 2262) is the last one.
pub(super) fn signed(time: u64) -> i64 {
    i64::try_from(time).unwrap_or(i64::MAX)
}
