//! Bags made of bags: merged, filtered, cut, repaired, or written anew in another form.

use std::collections::VecDeque;
use std::path::PathBuf;

use super::merged::{Merged, TopicMap, TypeConflict, merge_topics};
use crate::metadata::MetadataError;
use crate::reader::{BagMessage, Reader, ReaderError, RecordedTopic, Selection};
use crate::summary::RecordingSummary;
use crate::topic::{TopicId, TopicInfo};
use crate::writer::{Writer, WriterError};

/// What of some bags goes into another one.
///
/// ```no_run
/// use downbeat_bags::{Copy, Reader, WriterOptions};
///
/// let bags = [Reader::open("morning")?, Reader::open("evening")?];
/// let target = WriterOptions::new().create("day")?;
/// let copied = Copy::of(&bags)?.topics(|topic| topic.name.starts_with("/imu")).into_writer(target, |_| {})?;
/// println!("{} messages", copied.summary.message_count());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Copy<'a> {
    bags: &'a [Reader],
    topics: Vec<RecordedTopic>,
    ids: Vec<TopicMap>,
    is_wanted: Vec<bool>,
    from: i64,
    until: i64,
    keeps_latched: bool,
}

/// What was copied.
#[derive(Debug)]
pub struct Copied {
    /// What is in the new bag.
    pub summary: RecordingSummary,
    /// What could not be read, and is not in it.
    pub unreadable: Vec<ReaderError>,
    /// Messages that were published at another time than they were received, which the storage of the new bag has no place
    /// for: they have the time at which they were received alone.
    pub without_publish_time: u64,
}

/// Why a bag could not be copied.
#[derive(Debug, thiserror::Error)]
pub enum CopyError {
    /// The bags do not go together.
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
        /// What went wrong.
        found: String,
    },
    /// The metadata cannot be read back.
    #[error(transparent)]
    Metadata(#[from] MetadataError),
}

impl<'a> Copy<'a> {
    /// All of these bags.
    ///
    /// # Errors
    /// If they have a topic with different types.
    pub fn of(bags: &'a [Reader]) -> Result<Self, TypeConflict> {
        let of_each: Vec<&[RecordedTopic]> = bags.iter().map(Reader::topics).collect();
        let (topics, ids) = merge_topics(&of_each)?;
        let is_wanted = vec![true; topics.len()];
        Ok(Self { bags, topics, ids, is_wanted, from: i64::MIN, until: i64::MAX, keeps_latched: false })
    }

    /// Only topics for which that is true.
    #[must_use]
    pub fn topics(mut self, is_wanted: impl Fn(&TopicInfo) -> bool) -> Self {
        self.is_wanted = self.topics.iter().map(|topic| is_wanted(&topic.info)).collect();
        self
    }

    /// Only messages received from `from` to `until`, both included, in nanoseconds since the epoch.
    #[must_use]
    pub fn times(mut self, from: i64, until: i64) -> Self {
        (self.from, self.until) = (from, until);
        self
    }

    /// Of topics that are latched (transient local) also the last messages before the first time: what a subscriber that
    /// came then would have received. They are moved to that time.
    #[must_use]
    pub fn keep_latched(mut self) -> Self {
        self.keeps_latched = true;
        self
    }

    /// How many messages there are, those outside of the times included.
    #[must_use]
    pub fn message_count(&self) -> u64 {
        let wanted = self.topics.iter().zip(&self.is_wanted).filter(|(_, is_wanted)| **is_wanted);
        wanted.map(|(topic, _)| topic.message_count).sum()
    }

    /// Writes them, and tells `progress` how many have been written, now and then.
    ///
    /// What cannot be read is left out and told.
    ///
    /// # Errors
    /// If a bag cannot be opened any more, or the new one not be written.
    pub fn into_writer(self, mut writer: Writer, mut progress: impl FnMut(u64)) -> Result<Copied, CopyError> {
        let mut unreadable = Vec::new();
        let mut targets = Vec::new();
        for (topic, is_wanted) in self.topics.iter().zip(&self.is_wanted) {
            targets.push(is_wanted.then(|| writer.add_topic(topic.info.clone())).transpose()?);
        }
        let keeps_publish_time = writer.storage().keeps_publish_time();
        let (mut written, mut without_publish_time) = (0, 0);
        for message in self.latched(&mut unreadable)?.into_iter().map(Ok).chain(self.messages()?) {
            match message {
                Err(error) => unreadable.push(error),
                Ok(message) => {
                    let Some(target) = targets.get(message.topic.index()).copied().flatten() else {
                        continue;
                    };
                    // Writers refuse times before 1970, which only damaged files have.
                    let times = (message.log_time.max(0), message.publish_time.max(0));
                    writer.write(target, times.0, times.1, &message.data)?;
                    written += 1;
                    without_publish_time += u64::from(!keeps_publish_time && times.0 != times.1);
                    if written % 256 == 0 {
                        progress(written);
                    }
                }
            }
        }
        progress(written);
        Ok(Copied { summary: writer.finish()?, unreadable, without_publish_time })
    }

    fn selection(&self, bag: usize) -> Selection {
        let ids = self.ids.get(bag).into_iter().flatten().enumerate();
        let wanted = ids.filter_map(|(index, merged)| {
            let is_wanted = merged.is_some_and(|merged| self.is_wanted[merged.index()]);
            is_wanted.then(|| TopicId::from_index(index)).flatten()
        });
        Selection::all().topics(wanted)
    }

    fn messages(&self) -> Result<Merged, ReaderError> {
        let mut streams = Vec::new();
        for (index, bag) in self.bags.iter().enumerate() {
            let selection = self.selection(index).from(self.from).until(self.until);
            streams.push((bag.messages(selection)?, self.ids[index].clone()));
        }
        Ok(Merged::new(streams))
    }

    /// The last messages of latched topics before the first time, at that time.
    fn latched(&self, unreadable: &mut Vec<ReaderError>) -> Result<Vec<BagMessage>, ReaderError> {
        if !self.keeps_latched || self.from == i64::MIN {
            return Ok(Vec::new());
        }
        let mut streams = Vec::new();
        for (index, bag) in self.bags.iter().enumerate() {
            let latched = bag.topics().iter().enumerate().filter_map(|(position, topic)| {
                let merged = self.ids[index].get(position).copied().flatten()?;
                let is_wanted = self.is_wanted[merged.index()] && topic.info.latched_depth() > 0;
                is_wanted.then(|| TopicId::from_index(position)).flatten()
            });
            let selection = Selection::all().topics(latched).until(self.from.saturating_sub(1));
            streams.push((bag.messages(selection)?, self.ids[index].clone()));
        }
        let mut last: Vec<VecDeque<_>> = Vec::new();
        last.resize_with(self.topics.len(), Default::default);
        for message in Merged::new(streams) {
            match message {
                Err(error) => unreadable.push(error),
                Ok(message) => {
                    let (depth, kept) = (
                        self.topics[message.topic.index()].info.latched_depth(),
                        &mut last[message.topic.index()],
                    );
                    kept.push_back(message);
                    while kept.len() > depth {
                        kept.pop_front();
                    }
                }
            }
        }
        let mut kept: Vec<BagMessage> = last.into_iter().flatten().collect();
        kept.sort_by_key(|message| message.log_time);
        for message in &mut kept {
            message.log_time = self.from;
        }
        Ok(kept)
    }
}
