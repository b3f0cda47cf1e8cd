//! Bags made of bags: merged, filtered, cut, repaired, or written anew in another form.

use std::path::PathBuf;

use super::merged::{MergedBags, TypeConflict};
use crate::metadata::MetadataError;
use crate::reader::{BagMessage, Reader, ReaderError, RecordedTopic, Selection};
use crate::summary::RecordingSummary;
use crate::topic::TopicInfo;
use crate::writer::{Writer, WriterError};

/// What of some bags goes into another one.
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
    /// The topics of these bags that are wanted.
    ///
    /// # Errors
    /// If they have one of them with different types.
    pub fn of(bags: &'a [Reader], is_wanted: impl Fn(&TopicInfo) -> bool) -> Result<Self, TypeConflict> {
        let bags = MergedBags::new(bags, is_wanted)?;
        Ok(Self { bags, from: i64::MIN, until: i64::MAX, keeps_latched: false })
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
        self.bags.topics().iter().map(|topic| topic.message_count).sum()
    }

    /// Writes them, and tells `progress` how many have been written, now and then.
    ///
    /// What cannot be read is left out and told.
    ///
    /// # Errors
    /// If a bag cannot be opened any more, or the new one not be written.
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
                    // Writers refuse times before 1970, which only damaged files have.
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
