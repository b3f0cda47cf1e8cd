//! Stops a recording, or deletes its oldest files, before it fills the disk.

use std::io;
use std::path::Path;
use std::time::Instant;

use super::{Writer, WriterError};

/// What to do if less than [`WriterOptions::keep_free`](super::WriterOptions::keep_free) is free.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WhenLow {
    /// Finish the bag and stop recording.
    #[default]
    Stop,
    /// Delete the oldest files of the bag, and stop only if there is none but the current one.
    DropOldest,
}

impl Writer {
    /// Checks the free space after a chunk was passed to the operating system.
    pub(super) fn guard_free_space(&mut self, now: Instant) -> Result<(), WriterError> {
        let keep = self.options.keep_free;
        if keep == 0 {
            return Ok(());
        }
        let free = free_bytes(&self.directory).map_err(|source| self.fail(source))?;
        // Some file systems release the space of a deleted file later: asking again would delete too much.
        let mut expected = free;
        while expected < keep && self.options.when_low == WhenLow::DropOldest && self.files.len() > 1 {
            let Some(oldest) = self.files.front() else { break };
            tracing::info!(
                "{}: deleted the oldest file, {}: {expected} bytes were free, of {keep} to keep free",
                self.directory.display(),
                oldest.name
            );
            expected = expected.saturating_add(oldest.bytes);
            self.delete_oldest(self.files.len() - 1, now)?;
        }
        if expected >= keep {
            return Ok(());
        }
        self.close()?;
        let kept = self.topics.iter().map(|topic| topic.written).sum();
        Err(WriterError::LowSpace { path: self.directory.clone(), free, keep, kept })
    }
}

/// The bytes that this process may still write to the disk of `directory`.
#[cfg(unix)]
pub(super) fn free_bytes(directory: &Path) -> io::Result<u64> {
    let disk = rustix::fs::statvfs(directory)?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

/// Not implemented on other systems.
#[cfg(not(unix))]
pub(super) fn free_bytes(_: &Path) -> io::Result<u64> {
    Err(io::Error::new(io::ErrorKind::Unsupported, "the free space is not known on this system"))
}
