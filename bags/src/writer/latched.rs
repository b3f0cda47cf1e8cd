//! Repeats the last messages of latched topics at the start of each file: see [`crate::repeated`].

use std::collections::VecDeque;

use super::{Topic, Writer, WriterError};
use crate::storage::Storage;

/// The memory for messages to repeat, of all topics.
const MOST_BYTES: u64 = 64 * 1024 * 1024;

/// The last messages of a latched topic.
pub(super) struct Latched {
    /// How many a late subscriber receives.
    depth: usize,
    /// Publish times and data, the oldest first.
    last: VecDeque<(i64, Box<[u8]>)>,
    /// The number of copies in the bag.
    pub(super) repeated: u64,
    /// Whether it was logged that a message is not repeated.
    is_refused: bool,
}

impl Latched {
    pub(super) fn new(depth: usize) -> Self {
        Self { depth, last: VecDeque::new(), repeated: 0, is_refused: false }
    }
}

impl Writer {
    /// Remembers a message that was written, if its topic is latched.
    pub(super) fn keep_latched(&mut self, topic: usize, publish_time: i64, data: &[u8]) {
        // A file has room for messages too.
        let most = self.options.split.max_bytes.map_or(MOST_BYTES, |bytes| MOST_BYTES.min(bytes / 2));
        let Some(Topic { latched: Some(latched), info, .. }) = self.topics.get_mut(topic) else { return };
        let size = data.len() as u64;
        while let Some((_, oldest)) = latched.last.front() {
            let has_room = latched.last.len() < latched.depth && self.latched_bytes + size <= most;
            if has_room {
                break;
            }
            self.latched_bytes -= oldest.len() as u64;
            latched.last.pop_front();
        }
        if self.latched_bytes + size <= most {
            self.latched_bytes += size;
            latched.last.push_back((publish_time, data.into()));
        } else if !std::mem::replace(&mut latched.is_refused, true) {
            tracing::warn!(
                topic = info.name,
                "later files of the bag do not repeat a message of {size} bytes: such messages may take {most} bytes together"
            );
        }
    }

    /// Writes them at the start of a file, as received at the end of the file before.
    pub(super) fn repeat_latched(&mut self) -> Result<(), WriterError> {
        if self.storage() != Storage::Mcap {
            return Ok(());
        }
        let Some(log_time) = self.files.iter().filter_map(|file| file.times.last()).max() else {
            return Ok(());
        };
        let mut result = Ok(());
        let mut has_copies = false;
        for topic in &mut self.topics {
            let Some(latched) = &mut topic.latched else { continue };
            for (publish_time, data) in &latched.last {
                let times = (log_time.unsigned_abs(), publish_time.unsigned_abs());
                result = result.and_then(|()| self.file.repeat(topic.channel, times, data));
                topic.open += 1;
                latched.repeated += 1;
                has_copies = true;
            }
        }
        if has_copies {
            self.open.include(log_time);
            self.open_since = Some(std::time::Instant::now());
        }
        result.map_err(|source| self.fail(source))?;
        self.hand_over()
    }
}
