//! Creates bags from bags: merged, filtered, cut, repaired, or converted.

use std::path::PathBuf;

use super::merged::{MergedBags, TypeConflict};
use crate::metadata::MetadataError;
use crate::reader::{BagMessage, Reader, ReaderError, RecordedTopic, Selection};
use crate::summary::RecordingSummary;
use crate::topic::TopicInfo;
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
    /// The number of messages whose publish time was dropped, because the storage of the new bag only has the
    /// receive time.
    pub without_publish_time: u64,
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
    /// If they contain a topic with different types.
    pub fn of(bags: &'a [Reader], is_wanted: impl Fn(&TopicInfo) -> bool) -> Result<Self, TypeConflict> {
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
    /// If a bag can no longer be opened, or the new one cannot be written.
    pub fn into_writer(self, mut writer: Writer, mut progress: impl FnMut(u64)) -> Result<Copied, CopyError> {
        let mut unreadable = Vec::new();
        let add = |topic: &RecordedTopic| writer.add_topic(topic.info.clone());
        let targets = self.bags.topics().iter().map(add).collect::<Result<Vec<_>, _>>()?;
        let keeps_publish_time = writer.storage().keeps_publish_time();
        let (mut written, mut without_publish_time) = (0, 0);
        let latched = self.latched(&mut unreadable)?.into_iter().map(Ok);
        let messages = self.bags.messages(&Selection::all().from(self.from).until(self.until), |_| true)?;
        for message in latched.chain(messages) {
            match message {
                Err(error) => unreadable.push(error),
                Ok(message) => {
                    // Writers reject times before 1970, which occur only in damaged files.
                    let times = (message.log_time.max(0), message.publish_time.max(0));
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
        Ok(Copied { summary: writer.finish()?, unreadable, without_publish_time })
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
