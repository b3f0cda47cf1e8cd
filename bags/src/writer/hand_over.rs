//! Writes the open chunk: its messages are counted as written, or dropped and counted as lost.

use std::io;
use std::time::Instant;

use super::times::Times;
use super::{METADATA_INTERVAL, Topic, WhenDiskFull, Writer, WriterError};

impl Writer {
    /// Passes the open chunk to the operating system, or drops it if the disk is full and the options say so.
    pub(super) fn hand_over(&mut self) -> Result<(), WriterError> {
        if self.open_since.is_none() {
            return Ok(());
        }
        self.changes += 1;
        match self.file.flush() {
            Ok(()) => {
                self.count_open_chunk();
                if std::mem::take(&mut self.is_disk_full) {
                    tracing::info!("{}: there is room again, recording continues", self.directory.display());
                }
                Ok(())
            }
            Err(source) if self.goes_on_after(&source) => {
                self.file.drop_chunk().map_err(|source| self.fail(source))?;
                let lost = self.lose_open_chunk();
                // Logged once rather than for each chunk: the counts show the rest.
                if !std::mem::replace(&mut self.is_disk_full, true) {
                    let path = self.file.path().display();
                    tracing::error!(
                        "cannot write to {path}: {source}; {lost} messages are lost, as are all further ones until there is room"
                    );
                }
                Ok(())
            }
            Err(source) => Err(self.fail(source)),
        }
    }

    pub(super) fn replace_metadata(&mut self, now: Instant) -> Result<(), WriterError> {
        let started = Instant::now();
        match self.metadata().replace_in(&self.directory) {
            Ok(()) => self.metadata_has_all_topics = true,
            // The old one still exists, and the next flush tries again.
            Err(source) if self.goes_on_after(&source) => {}
            Err(source) => return Err(self.fail(source)),
        }
        self.metadata_written = now;
        self.metadata_interval = METADATA_INTERVAL.max(started.elapsed() * 20);
        Ok(())
    }

    pub(super) fn goes_on_after(&self, error: &io::Error) -> bool {
        use io::ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
        self.options.disk_full == WhenDiskFull::Drop
            && matches!(error.kind(), StorageFull | QuotaExceeded | FileTooLarge)
    }

    pub(super) fn count_open_chunk(&mut self) {
        self.open_since = None;
        let times = std::mem::take(&mut self.open);
        let Some(file) = self.files.back_mut() else { return };
        file.times.merge(times);
        file.counts.resize(self.topics.len(), 0);
        for (topic, count) in self.topics.iter_mut().zip(&mut file.counts) {
            let open = std::mem::take(&mut topic.open);
            topic.written += open;
            *count += open;
        }
    }

    /// Returns the number of its messages.
    pub(super) fn lose_open_chunk(&mut self) -> u64 {
        self.open_since = None;
        self.open = Times::default();
        let lose = |topic: &mut Topic| {
            let open = std::mem::take(&mut topic.open);
            topic.lost += open;
            open
        };
        self.topics.iter_mut().map(lose).sum()
    }
}
