//! A file to which bytes are appended: how much of it is complete, and its checksum.

use std::fs::{File, OpenOptions};
use std::io::{self, IoSlice, Seek, SeekFrom, Write};
use std::path::Path;

use super::SyncPolicy;

pub(super) struct OutputFile {
    file: File,
    sync: SyncPolicy,
    /// The length of completely appended data.
    kept: u64,
    /// The checksum of that data, if enabled.
    crc: Option<crc32fast::Hasher>,
}

/// Bytes to append, and their checksum if already known.
pub(super) struct Part<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) crc: Option<u32>,
}

impl<'a> From<&'a [u8]> for Part<'a> {
    fn from(bytes: &'a [u8]) -> Self {
        Self { bytes, crc: None }
    }
}

impl OutputFile {
    pub(super) fn create(path: &Path, sync: SyncPolicy, has_crc: bool) -> io::Result<Self> {
        let file = OpenOptions::new().write(true).create_new(true).open(path)?;
        Ok(Self { file, sync, kept: 0, crc: has_crc.then(crc32fast::Hasher::new) })
    }

    pub(super) fn kept(&self) -> u64 {
        self.kept
    }

    /// The checksum of appended data; 0 means none.
    pub(super) fn crc(&self) -> u32 {
        self.crc.clone().map_or(0, crc32fast::Hasher::finalize)
    }

    /// Passes the parts to the operating system, one after another. If that fails, some may be in the file.
    pub(super) fn append(&mut self, parts: &[Part<'_>]) -> io::Result<()> {
        self.write(parts)?;
        if self.sync == SyncPolicy::Chunks {
            self.file.sync_data()?;
        }
        for Part { bytes, crc } in parts {
            let length = bytes.len() as u64;
            self.kept += length;
            match (&mut self.crc, *crc) {
                (None, _) => {}
                (Some(all), None) => all.update(bytes),
                (Some(all), Some(known)) => {
                    all.combine(&crc32fast::Hasher::new_with_initial_len(known, length));
                }
            }
        }
        Ok(())
    }

    /// Writes bytes without counting them as kept; further data is appended after them.
    pub(super) fn write_unkept(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all(bytes)
    }

    /// Truncates the file to the kept data.
    pub(super) fn rewind(&mut self) -> io::Result<()> {
        self.file.set_len(self.kept)?;
        self.file.seek(SeekFrom::Start(self.kept)).map(drop)
    }

    /// Syncs the file to disk, unless the policy is not to.
    pub(super) fn finish(&mut self) -> io::Result<()> {
        match self.sync {
            SyncPolicy::Never => Ok(()),
            SyncPolicy::Files | SyncPolicy::Chunks => self.file.sync_all(),
        }
    }

    /// Writes all parts, with one system call if possible.
    fn write(&mut self, parts: &[Part<'_>]) -> io::Result<()> {
        let slices: Vec<IoSlice<'_>> = parts.iter().map(|part| IoSlice::new(part.bytes)).collect();
        let mut written = match self.file.write_vectored(&slices) {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => 0,
            written => written?,
        };
        for Part { bytes, .. } in parts {
            let rest = &bytes[written.min(bytes.len())..];
            written -= bytes.len() - rest.len();
            self.file.write_all(rest)?;
        }
        Ok(())
    }
}
