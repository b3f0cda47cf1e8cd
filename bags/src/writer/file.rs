//! One MCAP file, written in complete chunks.
//!
//! A chunk is collected in memory and passed to the operating system in one piece by [`ChunkedFile::flush`].
//! If the process is killed, the file consists of complete chunks and at most one incomplete one.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, IoSlice, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use mcap::records::{MessageHeader, MetadataIndex};

use super::channels::Channels;
use super::chunk::Chunk;
use super::summary::Summary;
use super::{McapOptions, SyncPolicy, records};
use crate::topic::TopicDescription;

pub(super) struct ChunkedFile {
    path: PathBuf,
    output: OutputFile,
    options: McapOptions,
    channels: Channels,
    chunk: Chunk,
    summary: Summary,
    /// The bytes around a chunk's content; kept to reuse the memory.
    frame: Vec<u8>,
}

impl ChunkedFile {
    pub(super) fn create(path: &Path, options: McapOptions, sync: SyncPolicy) -> io::Result<Self> {
        let mut file = Self {
            path: path.to_owned(),
            output: OutputFile::create(path, sync, options.has_data_crc)?,
            options,
            channels: Channels::default(),
            chunk: Chunk::default(),
            summary: Summary::default(),
            frame: Vec::new(),
        };
        let mut start = mcap::MAGIC.to_vec();
        records::header(&mut start, "ros2", concat!("downbeat ", env!("CARGO_PKG_VERSION")))?;
        file.output.append(&[start.as_slice().into()])?;
        Ok(file)
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The readable bytes in the file.
    pub(super) fn kept(&self) -> u64 {
        self.output.kept()
    }

    /// Size of the open chunk, before compression.
    pub(super) fn open_bytes(&self) -> u64 {
        self.chunk.bytes()
    }

    /// Returns the channel of the topic.
    pub(super) fn add_topic(&mut self, topic: &TopicDescription) -> io::Result<u16> {
        self.channels.add(topic)
    }

    pub(super) fn write(
        &mut self,
        channel_id: u16,
        log_time: u64,
        publish_time: u64,
        data: &[u8],
    ) -> io::Result<()> {
        self.channels.write_records(channel_id, self.chunk.records());
        // The real recorder leaves the sequence number at 0.
        self.chunk.add_message(&MessageHeader { channel_id, sequence: 0, log_time, publish_time }, data)
    }

    /// Ends the open chunk and passes it to the operating system. If that fails, the chunk is still open, and
    /// the file may contain a part of it after its end.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        if self.chunk.is_empty() {
            return Ok(());
        }
        self.frame.clear();
        let index = if self.options.is_chunked {
            let emitted = self.chunk.emit(&mut self.frame, self.output.kept(), &self.options)?;
            let (head, tail) = self.frame.split_at(emitted.content_at);
            self.output.append(&[head.into(), emitted.content(), tail.into()])?;
            Some(emitted.index)
        } else {
            self.output.append(&[self.chunk.content().into()])?;
            None
        };
        self.summary.add(&self.chunk, index);
        self.channels.keep();
        self.chunk.clear();
        Ok(())
    }

    /// After a failed flush: truncates the file to its end, and drops the open chunk.
    pub(super) fn drop_chunk(&mut self) -> io::Result<()> {
        self.channels.forget();
        self.chunk.clear();
        self.output.rewind()
    }

    /// Writes rosbag2's metadata record, after the open chunk.
    pub(super) fn write_metadata(&mut self, text: String) -> io::Result<()> {
        self.flush()?;
        let name = "rosbag2";
        let mut bytes = Vec::new();
        records::metadata(&mut bytes, name, &BTreeMap::from([("serialized_metadata".to_owned(), text)]))?;
        let index =
            MetadataIndex { offset: self.output.kept(), length: bytes.len() as u64, name: name.to_owned() };
        self.output.append(&[bytes.as_slice().into()])?;
        self.summary.add_metadata(index);
        Ok(())
    }

    /// Writes summary and footer, and syncs the file to disk unless the policy is not to.
    pub(super) fn finish(&mut self) -> io::Result<()> {
        self.flush()?;
        let mut ending = Vec::new();
        records::data_end(&mut ending, self.output.crc())?;
        self.summary.emit(&mut ending, self.output.kept(), &self.channels, &self.options)?;
        self.output.append(&[ending.as_slice().into()])?;
        self.output.finish()
    }

    /// After a failed write: truncates the file to its last complete chunk and finishes it without a summary.
    /// That takes 50 bytes, usually fewer than were removed, so it succeeds on a full disk; if not, only the
    /// end mark is missing.
    pub(super) fn give_up(&mut self) -> io::Result<()> {
        self.output.rewind()?;
        let mut ending = Vec::new();
        records::data_end(&mut ending, 0)?; // no checksum of the data
        Summary::emit_none(&mut ending);
        self.output.write_unkept(&ending)
    }
}

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
    fn append(&mut self, parts: &[Part<'_>]) -> io::Result<()> {
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
    fn write_unkept(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all(bytes)
    }

    /// Truncates the file to the kept data.
    fn rewind(&mut self) -> io::Result<()> {
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
