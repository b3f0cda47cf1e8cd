//! One MCAP file, written in complete chunks.
//!
//! A chunk is collected in memory and passed to the operating system in one piece by [`ChunkedFile::flush`].
//! If the process is killed, the file consists of complete chunks and at most one incomplete one.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use mcap::records::{MessageHeader, MetadataIndex};

use super::channels::Channels;
use super::chunk::Chunk;
use super::output::OutputFile;
use super::summary::Summary;
use super::{McapOptions, SyncPolicy, records};
use crate::repeated;
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
    pub(super) fn add_topic(&mut self, topic: &TopicDescription, metadata_version: u32) -> io::Result<u16> {
        self.channels.add(topic, metadata_version)
    }

    pub(super) fn write(
        &mut self,
        channel_id: u16,
        log_time: u64,
        publish_time: u64,
        data: &[u8],
    ) -> io::Result<()> {
        // The real recorder leaves the sequence number at 0.
        self.add(MessageHeader { channel_id, sequence: 0, log_time, publish_time }, data)
    }

    /// Writes a message of an earlier file again, with its times of receiving and sending.
    pub(super) fn repeat(&mut self, channel_id: u16, times: (u64, u64), data: &[u8]) -> io::Result<()> {
        let (log_time, publish_time) = times;
        self.add(MessageHeader { channel_id, sequence: repeated::SEQUENCE, log_time, publish_time }, data)
    }

    fn add(&mut self, header: MessageHeader, data: &[u8]) -> io::Result<()> {
        self.channels.write_records(header.channel_id, self.chunk.records());
        self.chunk.add_message(&header, data)
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
