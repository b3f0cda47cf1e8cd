//! The messages of a bag, sorted by receive time.
//!
//! Segments are loaded when the time of the next message reaches their first one, so only segments that
//! overlap in time are in memory (usually one per file).

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap, HashMap, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;

use bytes::Bytes;
use mcap::records::Channel;

use super::Reader;
use super::error::ReaderError;
use super::file::BagFile;
use super::message_index::MessageIndex;
use super::records::{RecordFile, are_ros_times};
use super::segment::{Content, Segment, decode};
#[cfg(feature = "sqlite")]
use super::sqlite::{SqliteFile, SqliteMessage};
use crate::repeated;
use crate::storage::Storage;
use crate::topic::TopicId;
use crate::zstd;

/// A recorded message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagMessage {
    /// Its topic in [`Reader::topics`].
    pub topic: TopicId,
    /// The receive time, in nanoseconds since the epoch.
    pub log_time: i64,
    /// The send time, in nanoseconds since the epoch.
    pub publish_time: i64,
    /// The recorded message: CDR bytes with their encapsulation header.
    pub data: Bytes,
}

/// Which messages to read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selection {
    topics: Option<BTreeSet<TopicId>>,
    from: i64,
    until: i64,
    includes_repeated: bool,
}

impl Selection {
    /// All messages, without the copies of latched messages that later files of a bag begin with.
    #[must_use]
    pub fn all() -> Self {
        Self { topics: None, from: i64::MIN, until: i64::MAX, includes_repeated: false }
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

    /// Only messages received at this time, in nanoseconds since the epoch, or earlier.
    #[must_use]
    pub fn until(self, until: i64) -> Self {
        Self { until, ..self }
    }

    /// Also these copies: [`Reader::message_count`] and metadata.yaml count them.
    #[must_use]
    pub fn with_repeated(self) -> Self {
        Self { includes_repeated: true, ..self }
    }

    /// Returns whether a segment may contain selected messages.
    fn concerns(&self, segment: &Segment, topics_of_channels: &HashMap<u16, TopicId>) -> bool {
        let is_in_time = signed(segment.last) >= self.from && signed(segment.first) <= self.until;
        let is_wanted = |channel: &u16| {
            let topic = topics_of_channels.get(channel);
            topic.is_some_and(|topic| self.topics.as_ref().is_none_or(|topics| topics.contains(topic)))
        };
        is_in_time && segment.channels.as_ref().is_none_or(|channels| channels.iter().any(is_wanted))
    }

    fn includes(&self, topic: TopicId, log_time: i64) -> bool {
        (self.from..=self.until).contains(&log_time)
            && self.topics.as_ref().is_none_or(|topics| topics.contains(&topic))
    }
}

impl Default for Selection {
    fn default() -> Self {
        Self::all()
    }
}

/// The messages of a bag sorted by log time; messages with the same time in file order. Created by
/// [`Reader::messages`].
///
/// A part that cannot be read yields one error; the messages after it follow.
pub struct Messages {
    files: Vec<OpenFile>,
    selection: Selection,
    /// Not yet loaded, sorted by first log time.
    segments: VecDeque<(usize, Segment)>,
    loaded: BinaryHeap<Reverse<Pending>>,
    room: Room,
    /// The first file known to be damaged: it may lack what later files repeat.
    first_damaged: usize,
}

/// Reusable memory for loaded messages.
#[derive(Clone, Copy)]
struct Room {
    most: u64,
    taken: u64,
}

struct OpenFile {
    path: PathBuf,
    input: Input,
    topics: Arc<HashMap<u16, TopicId>>,
    /// For the description of damage.
    channels: Arc<BTreeMap<u16, Channel>>,
    /// Whether rosbag2 compressed each message (`--compression-mode message`).
    has_packed_messages: bool,
    /// The last segment that was read; kept to reuse its memory.
    segment: Vec<u8>,
}

enum Input {
    Mcap(RecordFile),
    #[cfg(feature = "sqlite")]
    Sqlite(SqliteFile),
}

/// The memory for segments that overlap in time, in addition to [`LARGEST_GROWTH`] times the length of the
/// files: protects against small files that decompress to more than the available memory.
const MOST_OVERLAPPING: u64 = 256 * 1024 * 1024;
const LARGEST_GROWTH: u64 = 100;

/// A loaded message; sorted by log time, then by its position in the bag.
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
            files.push(OpenFile {
                path: file.path.clone(),
                input: Input::open(file)?,
                topics: Arc::clone(&reader.topics_of_channels[index]),
                channels: Arc::clone(&file.channels),
                has_packed_messages: reader.has_packed_messages(),
                segment: Vec::new(),
            });
            let topics = &reader.topics_of_channels[index];
            let wanted = file.segments.iter().filter(|segment| selection.concerns(segment, topics));
            segments.extend(wanted.map(|segment| (index, segment.clone())));
        }
        segments.sort_by_key(|(file, segment)| (segment.first, *file, segment.offset));
        let first_damaged = reader.files.iter().position(|file| !file.truncations.is_empty());
        Ok(Self {
            files,
            selection,
            segments: segments.into(),
            loaded: BinaryHeap::new(),
            room: Room::for_files_of(reader.files_length()),
            first_damaged: first_damaged.unwrap_or(usize::MAX),
        })
    }

    /// The last messages of each topic, as many as `wanted` says, sorted by time; and what could not be read.
    ///
    /// Reads backwards, only segments that may contain a missing message: a few if the file says which topics
    /// a segment has.
    pub(super) fn last(mut self, wanted: &BTreeMap<TopicId, usize>) -> (Vec<BagMessage>, Vec<ReaderError>) {
        let until = self.selection.until;
        let latest = |segment: &Segment| signed(segment.last).min(until);
        let mut segments: Vec<_> = std::mem::take(&mut self.segments).into();
        segments.sort_by_key(|(file, segment)| Reverse((latest(segment), *file, segment.offset)));
        let mut found: BTreeMap<TopicId, Vec<BagMessage>> = BTreeMap::new();
        let mut unreadable = Vec::new();
        for (file, segment) in segments {
            let is_missing = |topic: &TopicId, count: usize| {
                let found = found.get(topic).map_or(&[][..], Vec::as_slice);
                found.len() < count || found.first().is_none_or(|oldest| oldest.log_time < latest(&segment))
            };
            let missing = wanted.iter().filter(|&(topic, &count)| count > 0 && is_missing(topic, count));
            let missing: BTreeSet<_> = missing.map(|(topic, _)| *topic).collect();
            if missing.is_empty() {
                break;
            }
            self.selection.topics = Some(missing);
            if !self.selection.concerns(&segment, &self.files[file].topics) {
                continue;
            }
            if let Err(error) = self.load(file, &segment) {
                unreadable.push(error);
            }
            while let Some(Reverse(pending)) = self.loaded.pop() {
                self.room.give_back(&pending);
                found.entry(pending.message.topic).or_default().push(pending.message);
            }
            for (topic, messages) in &mut found {
                messages.sort_by_key(|message| message.log_time);
                let surplus = messages.len().saturating_sub(wanted.get(topic).copied().unwrap_or(0));
                messages.drain(..surplus);
            }
        }
        let mut last: Vec<_> = found.into_values().flatten().collect();
        last.sort_by_key(|message| message.log_time);
        (last, unreadable)
    }

    /// Loads the selected messages of a segment: those that are whole, if it is damaged.
    fn load(&mut self, file_index: usize, segment: &Segment) -> Result<(), ReaderError> {
        let loaded = self.load_from(file_index, segment);
        if loaded.is_err() {
            self.first_damaged = self.first_damaged.min(file_index);
        }
        loaded
    }

    fn load_from(&mut self, file_index: usize, segment: &Segment) -> Result<(), ReaderError> {
        // The first file that is there has no earlier one with the messages it repeats.
        let leaves_repeated_out =
            !self.selection.includes_repeated && file_index > 0 && file_index <= self.first_damaged;
        let file = &mut self.files[file_index];
        let damaged = |found| ReaderError::Damaged { path: file.path.clone(), offset: segment.offset, found };
        let mut found = Vec::new();
        let mut problem = None;
        let mut number = 0;
        // Tables have signed times, chunks unsigned ones.
        let is_table = !matches!(file.input, Input::Mcap(_));
        let mut room = self.room;
        let mut take = |channel: u16, log_time: u64, publish_time: u64, data: &[u8]| {
            number += 1;
            let Some(&topic) = file.topics.get(&channel) else {
                problem.get_or_insert_with(|| {
                    format!("a message is of channel {channel}, which has no description")
                });
                return;
            };
            // Times that are left out are reported whatever is selected of that topic.
            let is_time = are_ros_times(log_time, publish_time);
            if !self.selection.includes(topic, if is_time { signed(log_time) } else { self.selection.from }) {
                return;
            }
            // Other numbers in their place would be written to new bags.
            if !is_time {
                problem.get_or_insert_with(|| {
                    let (range, log_time, publish_time) = match is_table {
                        true => ("before 1970", log_time.cast_signed().to_string(), publish_time.cast_signed().to_string()),
                        false => ("after the year 2262", log_time.to_string(), publish_time.to_string()),
                    };
                    format!(
                        "messages with times {range}, which ROS 2 cannot represent, are left out; the first has the log \
                         time {log_time} and the publish time {publish_time}"
                    )
                });
                return;
            }
            let data = if file.has_packed_messages {
                zstd::decompress_within(data, zstd::most_from(data.len() as u64).min(room.left()))
                    .map(Bytes::from)
                    .map_err(|found| format!("a compressed message: {found}"))
            } else {
                Ok(Bytes::copy_from_slice(data))
            };
            let pending = data.and_then(|data| {
                let order = (log_time, file_index, segment.offset, number);
                let (log_time, publish_time) = (signed(log_time), signed(publish_time));
                room.take(Pending { order, message: BagMessage { topic, log_time, publish_time, data } })
            });
            match pending {
                Ok(pending) => found.push(pending),
                Err(found) => drop(problem.get_or_insert(found)),
            }
        };
        let read = |source| ReaderError::Read { path: file.path.clone(), source };
        let damage;
        match &mut file.input {
            Input::Mcap(input) => {
                let bytes = &mut file.segment;
                input
                    .seek(segment.offset)
                    .and_then(|()| input.read_into(bytes, segment.length))
                    .map_err(read)?;
                let mut failed = None;
                let index = || {
                    let index = MessageIndex::read(input, segment.offset + segment.length);
                    index.map_err(|error| failed = Some(error)).unwrap_or_default()
                };
                let decoded = decode(bytes, (segment.kind, segment.declared), index, |content| {
                    if let Content::Message { header, data } = content
                        && !(leaves_repeated_out && header.sequence == repeated::SEQUENCE)
                    {
                        take(header.channel_id, header.log_time, header.publish_time, data);
                    }
                });
                if let Some(error) = failed {
                    return Err(read(error));
                }
                // Damage that was found when the file was opened is among its truncations.
                let decoded = decoded.err().filter(|_| !segment.is_reported);
                let name = |channel| file.channels.get(&channel).map(|channel| channel.topic.as_str());
                damage = decoded.map(|damage| damage.describe(name));
            }
            #[cfg(feature = "sqlite")]
            Input::Sqlite(input) => {
                let each = |message: SqliteMessage<'_>| {
                    // The table has only one time.
                    take(message.channel, message.time, message.time, message.data);
                };
                damage = input.read(segment, each).err();
            }
        }
        self.room = room;
        self.loaded.extend(found.into_iter().map(Reverse));
        damage.or(problem).map_or(Ok(()), |found| Err(damaged(found)))
    }
}

impl Room {
    fn for_files_of(length: u64) -> Self {
        Self { most: length.saturating_mul(LARGEST_GROWTH).saturating_add(MOST_OVERLAPPING), taken: 0 }
    }

    fn left(&self) -> u64 {
        self.most.saturating_sub(self.taken)
    }

    fn take(&mut self, pending: Pending) -> Result<Pending, String> {
        if pending.size() > self.left() {
            let most = self.most;
            return Err(format!(
                "with those that overlap it in time, its messages take more than {most} bytes"
            ));
        }
        self.taken += pending.size();
        Ok(pending)
    }

    fn give_back(&mut self, pending: &Pending) {
        self.taken = self.taken.saturating_sub(pending.size());
    }
}

impl Pending {
    fn size(&self) -> u64 {
        (self.message.data.len() + size_of::<Self>()) as u64
    }
}

impl Input {
    fn open(file: &BagFile) -> Result<Self, ReaderError> {
        let failed = |source| ReaderError::Read { path: file.path.clone(), source };
        match file.storage {
            Storage::Mcap => RecordFile::open(&file.source).map(Self::Mcap).map_err(failed),
            #[cfg(feature = "sqlite")]
            Storage::Sqlite3 => SqliteFile::open(&file.source).map(Self::Sqlite).map_err(|error| {
                ReaderError::Damaged { path: file.path.clone(), offset: 0, found: error.to_string() }
            }),
            #[cfg(not(feature = "sqlite"))]
            Storage::Sqlite3 => Err(failed(std::io::ErrorKind::Unsupported.into())),
        }
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
            let Reverse(pending) = self.loaded.pop()?;
            self.room.give_back(&pending);
            return Some(Ok(pending.message));
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

/// Converts the bounds of a part of a file to ROS times, which are signed; times after the year 2262
/// saturate.
pub(super) fn signed(time: u64) -> i64 {
    i64::try_from(time).unwrap_or(i64::MAX)
}
