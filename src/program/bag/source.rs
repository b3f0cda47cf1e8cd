//! The messages of one topic of a bag.

use crate::bags::{Reader, RecordedTopic, Selection, TopicId};
use crate::table::{Columns, DecodeError, Decoder, Survey};
use bytes::Bytes;

use super::progress::Progress;

/// A topic of a bag.
pub(super) struct Source<'a> {
    bag: &'a Reader,
    id: TopicId,
    pub(super) topic: &'a RecordedTopic,
}

/// The result of processing messages.
pub(super) struct Done {
    pub(super) messages: u64,
    /// Unreadable messages and parts of the bag.
    pub(super) unreadable: usize,
}

impl<'a> Source<'a> {
    pub(super) fn new(bag: &'a Reader, id: TopicId) -> Self {
        Self { bag, id, topic: &bag.topics()[id.index()] }
    }

    /// The columns for all of its messages.
    pub(super) fn columns(&self, decoder: &Decoder) -> anyhow::Result<Columns> {
        let mut survey = Survey::default();
        let decode = |data| decoder.decode(data);
        self.each("looking", decode, |_, message| {
            survey.see(&message);
            Ok(())
        })?;
        Ok(survey.columns())
    }

    /// Calls a function with the times and the content of each message. Unreadable messages are logged,
    /// skipped, and counted.
    pub(super) fn each<T>(
        &self,
        doing: &'static str,
        decode: impl Fn(Bytes) -> Result<T, DecodeError>,
        mut act: impl FnMut([i64; 2], T) -> anyhow::Result<()>,
    ) -> anyhow::Result<Done> {
        let mut progress = Progress::new(doing, self.topic.message_count);
        let (mut seen, mut done, mut broken, mut damaged) = (0, 0, 0_usize, 0);
        for message in self.bag.messages(Selection::all().topics([self.id]))? {
            let message = match message {
                Ok(message) => message,
                Err(error) => {
                    tracing::warn!("{error}");
                    damaged += 1;
                    continue;
                }
            };
            seen += 1;
            progress.at(seen);
            match decode(message.data) {
                Ok(content) => {
                    act([message.log_time, message.publish_time], content)?;
                    done += 1;
                }
                Err(error) if broken == 0 => {
                    broken = 1;
                    tracing::warn!("{}: message {seen}: {error}", self.topic.info.name);
                }
                Err(_) => broken += 1,
            }
        }
        if broken > 1 {
            tracing::warn!("{}: {broken} messages cannot be read", self.topic.info.name);
        }
        Ok(Done { messages: done, unreadable: broken + damaged })
    }
}
