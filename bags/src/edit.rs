//! Creates bags from bags.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::path::{Path, PathBuf};

use downbeat_msgs::dynamic::Definitions;

use crate::check::{Decoding, Problem};
use crate::metadata::{
    self, FORMAT_VERSION, FileMetadata, HUMBLE_VERSION, Metadata, MetadataError, RecordedQos, TopicMetadata,
};
use crate::reader::{BagMessage, Messages, Reader, ReaderError, RecordedTopic, Selection};
use crate::topic::{RecordingSummary, TopicDescription, TopicId};
use crate::writer::{Writer, WriterError};

/// The part of some bags that is copied into another one.
///
/// ```no_run
/// use downbeat_bags::{Copy, Reader, WriterOptions};
///
/// let bags = [Reader::open("morning")?, Reader::open("evening")?];
/// let target = WriterOptions::new().create("day")?;
/// let copied = Copy::of(&bags, |topic| topic.name.starts_with("/imu"))?.into_writer(target, |_| {})?;
/// println!("{} messages", copied.summary.message_count());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Copy<'a> {
    bags: MergedBags<'a>,
    from: i64,
    until: i64,
    keeps_latched: bool,
}

/// The result of copying.
#[derive(Debug)]
pub struct Copied {
    /// The contents of the new bag.
    pub summary: RecordingSummary,
    /// The parts that could not be read and are missing in the new bag.
    pub unreadable: Vec<ReaderError>,
    /// The topics with messages that do not match the definition of their type, or whose definition is
    /// damaged and not known from elsewhere. They are copied nevertheless.
    pub undecodable: Vec<Problem>,
    /// The number of messages whose publish time was dropped, because the storage of the new bag only has the
    /// receive time.
    pub without_publish_time: u64,
    /// The topics whose definition was damaged or incomplete and is complete in the new bag, with what was
    /// taken from where.
    pub completed: Vec<String>,
}

/// Why a bag could not be copied.
#[derive(Debug, thiserror::Error)]
pub enum CopyError {
    /// The bags are incompatible.
    #[error(transparent)]
    Conflict(#[from] TypeConflict),
    /// A bag cannot be read at all.
    #[error(transparent)]
    Read(#[from] ReaderError),
    /// The new bag cannot be written.
    #[error(transparent)]
    Write(#[from] WriterError),
    /// A file of the new bag cannot be written.
    #[error("cannot write {}: {found}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The problem.
        found: String,
    },
    /// The metadata cannot be read back.
    #[error(transparent)]
    Metadata(#[from] MetadataError),
}

impl<'a> Copy<'a> {
    /// Selects topics of these bags.
    ///
    /// # Errors
    /// Returns an error if they contain a topic with different types.
    pub fn of(
        bags: &'a [Reader],
        is_wanted: impl Fn(&TopicDescription) -> bool,
    ) -> Result<Self, TypeConflict> {
        let bags = MergedBags::new(bags, is_wanted)?;
        Ok(Self { bags, from: i64::MIN, until: i64::MAX, keeps_latched: false })
    }

    /// Only copies messages received from `from` to `until`, inclusive, in nanoseconds since the epoch.
    #[must_use]
    pub fn times(mut self, from: i64, until: i64) -> Self {
        (self.from, self.until) = (from, until);
        self
    }

    /// Also copies the last messages of latched (transient local) topics before the first time, which a
    /// subscriber joining then would have received. They are moved to that time.
    #[must_use]
    pub fn keep_latched(mut self) -> Self {
        self.keeps_latched = true;
        self
    }

    /// The number of messages, including those outside of the time range.
    #[must_use]
    pub fn message_count(&self) -> u64 {
        self.bags.topics().iter().map(|topic| topic.message_count).sum()
    }

    /// Writes the messages, and calls `progress` from time to time with the number of messages written.
    ///
    /// Unreadable parts are left out and reported.
    ///
    /// # Errors
    /// Returns an error if a bag can no longer be opened, or the new one cannot be written.
    pub fn into_writer(self, mut writer: Writer, mut progress: impl FnMut(u64)) -> Result<Copied, CopyError> {
        let mut unreadable = Vec::new();
        let known = Definitions::new().with_carried();
        let mut completed = Vec::new();
        let add = |topic: &RecordedTopic| {
            let info = topic.info.completed(&known).map(|(info, taken)| {
                completed.push(format!("{}: {taken}", info.name));
                info
            });
            writer.add_topic(info.unwrap_or_else(|| topic.info.clone()))
        };
        let targets = self.bags.topics().iter().map(add).collect::<Result<Vec<_>, _>>()?;
        let (mut decoding, mut undecodable) = (Decoding::new(&known), Vec::new());
        for topic in self.bags.topics() {
            decoding.add(topic, &mut undecodable, &mut Vec::new());
        }
        // A bag without definitions is copied as what it is.
        undecodable.retain(|problem| matches!(problem, Problem::Definition { .. }));
        let keeps_publish_time = writer.storage().keeps_publish_time();
        let (mut written, mut without_publish_time) = (0, 0);
        let latched = self.latched(&mut unreadable)?.into_iter().map(Ok);
        let messages = self.bags.messages(&Selection::all().from(self.from).until(self.until), |_| true)?;
        for message in latched.chain(messages) {
            match message {
                Err(error) => unreadable.push(error),
                Ok(message) => {
                    decoding.decodes(&message);
                    let times = (message.log_time, message.publish_time);
                    writer.write(targets[message.topic.index()], times.0, times.1, &message.data)?;
                    written += 1;
                    without_publish_time += u64::from(!keeps_publish_time && times.0 != times.1);
                    if written % 256 == 0 {
                        progress(written);
                    }
                }
            }
        }
        progress(written);
        undecodable.extend(decoding.problems(self.bags.topics()));
        Ok(Copied { summary: writer.finish()?, unreadable, undecodable, without_publish_time, completed })
    }

    /// The last messages of latched topics before the first time, at that time.
    fn latched(&self, unreadable: &mut Vec<ReaderError>) -> Result<Vec<BagMessage>, ReaderError> {
        if !self.keeps_latched || self.from == i64::MIN {
            return Ok(Vec::new());
        }
        let before = Selection::all().until(self.from.saturating_sub(1));
        let messages = self.bags.messages(&before, |topic| topic.info.latched_depth() > 0)?;
        let readable = messages.filter_map(|message| message.map_err(|error| unreadable.push(error)).ok());
        let mut kept = self.bags.last_latched(readable);
        for message in &mut kept {
            message.log_time = self.from;
        }
        Ok(kept)
    }
}

/// The messages of several bags sorted by time, or by bag if times are equal. Created by
/// [`MergedBags::messages`].
pub struct Merged {
    streams: Vec<Stream>,
    /// Returned before further messages.
    errors: VecDeque<ReaderError>,
}

/// Maps the position of each topic in one bag to its id in the merged bags.
type TopicMap = Vec<Option<TopicId>>;

struct Stream {
    messages: Messages,
    next: Option<BagMessage>,
    /// From the bag's topics to the merged topics.
    topics: TopicMap,
}

/// Two bags contain different topics with the same name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("topic {topic} is of type {first} in one bag and {second} in another; leave it out")]
pub struct TypeConflict {
    /// The topic.
    pub topic: String,
    /// Its type and serialisation in one bag.
    pub first: String,
    /// Its type and serialisation in the other bag.
    pub second: String,
}

/// Several bags as one: a selection of their topics, each name once.
pub struct MergedBags<'a> {
    bags: &'a [Reader],
    topics: Vec<RecordedTopic>,
    /// The positions of topics by their names.
    by_name: HashMap<String, usize>,
    maps: Vec<TopicMap>,
}

impl<'a> MergedBags<'a> {
    /// Merges the selected topics; other topics cannot conflict.
    ///
    /// # Errors
    /// Returns an error if a topic has several types or serialisations.
    pub fn new(
        bags: &'a [Reader],
        is_wanted: impl Fn(&TopicDescription) -> bool,
    ) -> Result<Self, TypeConflict> {
        let mut merged = Self { bags, topics: Vec::new(), by_name: HashMap::new(), maps: Vec::new() };
        for bag in bags {
            let topics = bag.topics().iter();
            let map = topics.map(|topic| is_wanted(&topic.info).then(|| merged.add(topic)).transpose());
            let map = map.collect::<Result<Vec<_>, _>>()?;
            merged.maps.push(map.into_iter().map(Option::flatten).collect());
        }
        Ok(merged)
    }

    /// The topics, with the counts of all bags; messages refer to them by position.
    #[must_use]
    pub fn topics(&self) -> &[RecordedTopic] {
        &self.topics
    }

    /// The messages of all bags sorted by time, for topics for which `is_meant` returns true.
    ///
    /// # Errors
    /// Returns an error if a bag can no longer be opened.
    pub fn messages(
        &self,
        selection: &Selection,
        is_meant: impl Fn(&RecordedTopic) -> bool,
    ) -> Result<Merged, ReaderError> {
        let stream = |(bag, map): (&Reader, &TopicMap)| -> Result<Stream, ReaderError> {
            let meant = map.iter().enumerate().filter_map(|(index, merged)| {
                is_meant(&self.topics[(*merged)?.index()]).then(|| TopicId::from_index(index)).flatten()
            });
            let messages = bag.messages(selection.clone().topics(meant))?;
            Ok(Stream { messages, next: None, topics: map.clone() })
        };
        let streams = self.bags.iter().zip(&self.maps).map(stream).collect::<Result<_, _>>()?;
        Ok(Merged { streams, errors: VecDeque::new() })
    }

    /// The last messages of topics at a time, in nanoseconds since the epoch: of each topic as many as
    /// `wanted` says, by its position in [`MergedBags::topics`]. See [`Reader::last_messages`].
    ///
    /// # Errors
    /// Returns an error if a bag can no longer be opened.
    pub fn last_messages(
        &self,
        until: i64,
        wanted: &BTreeMap<TopicId, usize>,
    ) -> Result<(Vec<BagMessage>, Vec<ReaderError>), ReaderError> {
        let (mut last, mut unreadable) = (Vec::new(), Vec::new());
        for (bag, map) in self.bags.iter().zip(&self.maps) {
            let here = map
                .iter()
                .enumerate()
                .filter_map(|(index, merged)| Some((TopicId::from_index(index)?, *wanted.get(&(*merged)?)?)));
            let (messages, missing) = bag.last_messages(until, &here.collect())?;
            unreadable.extend(missing);
            last.extend(messages.into_iter().filter_map(|message| {
                Some(BagMessage { topic: map.get(message.topic.index()).copied()??, ..message })
            }));
        }
        last.sort_by_key(|message| message.log_time);
        // The last of all bags.
        let mut counts = BTreeMap::new();
        let mut is_last = |message: &BagMessage| {
            let count = counts.entry(message.topic).or_insert(0);
            *count += 1;
            wanted.get(&message.topic).is_some_and(|most| *count <= *most)
        };
        let mut last: Vec<_> = last.into_iter().rev().filter(|message| is_last(message)).collect();
        last.reverse();
        Ok((last, unreadable))
    }

    /// Returns the messages of latched (transient local) topics that a subscriber would receive after
    /// `messages`, sorted by time like these.
    pub(crate) fn last_latched(&self, messages: impl Iterator<Item = BagMessage>) -> Vec<BagMessage> {
        let mut last: Vec<VecDeque<BagMessage>> = vec![VecDeque::new(); self.topics.len()];
        for message in messages {
            let topic = message.topic.index();
            last[topic].push_back(message);
            if last[topic].len() > self.topics[topic].info.latched_depth() {
                last[topic].pop_front();
            }
        }
        let mut kept: Vec<BagMessage> = last.into_iter().flatten().collect();
        kept.sort_by_key(|message| message.log_time);
        kept
    }

    fn add(&mut self, topic: &RecordedTopic) -> Result<Option<TopicId>, TypeConflict> {
        let index = *self.by_name.entry(topic.info.name.clone()).or_insert_with(|| {
            self.topics.push(RecordedTopic { message_count: 0, ..topic.clone() });
            self.topics.len() - 1
        });
        let merged = &mut self.topics[index];
        let kind =
            |topic: &RecordedTopic| format!("{} as {}", topic.info.type_name, topic.serialization_format);
        if kind(merged) != kind(topic) {
            let (first, second) = (kind(merged), kind(topic));
            return Err(TypeConflict { topic: topic.info.name.clone(), first, second });
        }
        merged.message_count = merged.message_count.saturating_add(topic.message_count);
        for qos in &topic.info.offered_qos {
            if !merged.info.offered_qos.contains(qos) {
                merged.info.offered_qos.push(*qos);
            }
        }
        if merged.info.definition.is_empty() {
            merged.info.definition.clone_from(&topic.info.definition);
        }
        Ok(TopicId::from_index(index))
    }
}

impl Iterator for Merged {
    type Item = Result<BagMessage, ReaderError>;

    fn next(&mut self) -> Option<Self::Item> {
        for stream in &mut self.streams {
            while stream.next.is_none() {
                match stream.messages.next() {
                    None => break,
                    Some(Err(error)) => self.errors.push_back(error),
                    Some(Ok(message)) => {
                        let topic = stream.topics.get(message.topic.index()).copied().flatten();
                        stream.next = topic.map(|topic| BagMessage { topic, ..message });
                    }
                }
            }
        }
        if let Some(error) = self.errors.pop_front() {
            return Some(Err(error));
        }
        let time = |stream: &&mut Stream| stream.next.as_ref().map_or(i64::MAX, |message| message.log_time);
        let waiting = self.streams.iter_mut().filter(|stream| stream.next.is_some());
        waiting.min_by_key(time)?.next.take().map(Ok)
    }
}

/// Recreates the metadata.yaml of a bag directory from its files, like `ros2 bag reindex`. An existing one is
/// only used for what the files do not contain: `custom_data` is kept if it is readable, and the version of
/// Humble.
///
/// # Errors
/// Returns an error if there are no files, or they cannot be read, or metadata.yaml cannot be written.
pub fn reindex(directory: &Path) -> Result<Metadata, CopyError> {
    let reader = Reader::open_files_of(directory)?;
    let recorded = Metadata::read(&directory.join(metadata::FILE_NAME)).ok();
    let recorded = recorded.as_ref().or(reader.metadata());
    let is_packed = reader.files().any(|path| path.extension().is_some_and(|ending| ending == "zstd"));
    let mode = match recorded.map(|recorded| recorded.compression_mode.as_str()) {
        Some(mode) if mode.eq_ignore_ascii_case("message") => mode.to_owned(),
        _ if is_packed => "FILE".to_owned(),
        _ => String::new(),
    };
    let files: Vec<FileMetadata> = reader.file_metadata().collect();
    let known = recorded.map(|recorded| recorded.topics.as_slice()).unwrap_or_default().iter();
    let known: HashMap<_, _> = known.rev().map(|topic| (topic.name.as_str(), topic)).collect();
    let metadata = Metadata {
        version: recorded
            .map(|recorded| recorded.version)
            .filter(|v| *v == HUMBLE_VERSION)
            .unwrap_or(FORMAT_VERSION),
        storage_identifier: reader.storage_identifier().to_owned(),
        duration: reader.duration(),
        starting_time: reader.start_time().unwrap_or(metadata::NEVER),
        message_count: reader.message_count(),
        topics: reader
            .topics()
            .iter()
            .map(|topic| TopicMetadata {
                name: topic.info.name.clone(),
                type_name: topic.info.type_name.clone(),
                serialization_format: topic.serialization_format.clone(),
                offered_qos: offered_qos(topic, &known),
                type_hash: topic.info.type_hash.clone(),
                message_count: topic.message_count,
            })
            .collect(),
        compression_format: if mode.is_empty() { String::new() } else { "zstd".to_owned() },
        compression_mode: mode,
        relative_file_paths: files.iter().map(|file| file.path.clone()).collect(),
        files,
        oddities: Vec::new(),
        custom_data: recorded.map(|recorded| recorded.custom_data.clone()).unwrap_or_default(),
        ros_distro: recorded.map(|recorded| recorded.ros_distro.clone()).unwrap_or_default(),
    };
    let path = directory.join(metadata::FILE_NAME);
    metadata
        .replace_in(directory)
        .map_err(|error| CopyError::File { path: path.clone(), found: error.to_string() })?;
    Ok(Metadata::read(&path)?)
}

/// The profiles in the old metadata, which can contain more than one in the file, or else those in the file.
fn offered_qos(topic: &RecordedTopic, recorded: &HashMap<&str, &TopicMetadata>) -> Vec<RecordedQos> {
    let recorded = recorded.get(&*topic.info.name).filter(|recorded| !recorded.offered_qos.is_empty());
    recorded.map_or(&topic.info.offered_qos, |recorded| &recorded.offered_qos).clone()
}
