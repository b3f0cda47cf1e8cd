//! One MCAP file that is written in whole chunks.
//!
//! A chunk is collected in memory and reaches the operating system in one piece, exactly when [`ChunkedFile::flush`]
//! says. Whatever happens to the process, the file is a sequence of complete chunks and at most one torn one.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use mcap::records::{MessageHeader, MetadataIndex};

use super::chunk::Chunk;
use super::summary::Summary;
use super::{Compression, records};
use crate::metadata::qos_to_yaml;
use crate::topic::TopicInfo;

pub(super) struct ChunkedFile {
    path: PathBuf,
    file: File,
    compression: Compression,
    /// Length up to the end of the last complete chunk.
    kept: u64,
    /// Checksum of everything up to there.
    data_crc: crc32fast::Hasher,
    chunk: Chunk,
    summary: Summary,
}

impl ChunkedFile {
    pub(super) fn create(path: &Path, compression: Compression) -> io::Result<Self> {
        let mut file = Self {
            path: path.to_owned(),
            file: OpenOptions::new().write(true).create_new(true).open(path)?,
            compression,
            kept: 0,
            data_crc: crc32fast::Hasher::new(),
            chunk: Chunk::default(),
            summary: Summary::default(),
        };
        let mut start = mcap::MAGIC.to_vec();
        records::header(&mut start, "ros2", concat!("downbeat ", env!("CARGO_PKG_VERSION")))?;
        file.append(&start)?;
        Ok(file)
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes that are in the file and readable.
    pub(super) fn kept(&self) -> u64 {
        self.kept
    }

    /// Size of the messages in the open chunk, before compression.
    pub(super) fn open_bytes(&self) -> u64 {
        self.chunk.message_bytes()
    }

    /// Returns the channel of the topic.
    pub(super) fn add_topic(&mut self, topic: &TopicInfo) -> io::Result<u16> {
        let mut metadata = BTreeMap::from([
            ("offered_qos_profiles".to_owned(), qos_to_yaml(&topic.offered_qos)),
            ("topic_type_hash".to_owned(), topic.type_hash.clone()),
        ]);
        if topic.format.is_some() {
            // The schema may have another name.
            metadata.insert("topic_type".to_owned(), topic.type_name.clone());
        }
        let mut new_records = Vec::new();
        let channel = self.summary.add_topic(topic, &metadata, &mut new_records)?;
        self.chunk.add_records(&new_records);
        Ok(channel)
    }

    pub(super) fn write(
        &mut self,
        channel_id: u16,
        log_time: u64,
        publish_time: u64,
        data: &[u8],
    ) -> io::Result<()> {
        // The real recorder leaves the sequence number at 0.
        self.chunk.add_message(&MessageHeader { channel_id, sequence: 0, log_time, publish_time }, data)
    }

    /// Ends the open chunk and hands it to the operating system.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        if self.chunk.is_empty() {
            return Ok(());
        }
        let mut bytes = Vec::new();
        let index = self.chunk.emit(&mut bytes, self.kept, self.compression)?;
        self.append(&bytes)?;
        self.summary.add_chunk(index, self.chunk.counts());
        self.chunk = Chunk::default();
        Ok(())
    }

    /// Writes the record in which rosbag2 keeps its metadata, after the open chunk.
    pub(super) fn write_metadata(&mut self, text: String) -> io::Result<()> {
        self.flush()?;
        let name = "rosbag2";
        let mut bytes = Vec::new();
        records::metadata(&mut bytes, name, &BTreeMap::from([("serialized_metadata".to_owned(), text)]))?;
        let index = MetadataIndex { offset: self.kept, length: bytes.len() as u64, name: name.to_owned() };
        self.append(&bytes)?;
        self.summary.add_metadata(index);
        Ok(())
    }

    /// Writes summary and footer and waits until the medium has them: robots are switched off after a recording.
    pub(super) fn finish(&mut self) -> io::Result<()> {
        self.flush()?;
        let mut ending = Vec::new();
        records::data_end(&mut ending, self.data_crc.clone().finalize())?;
        self.summary.emit(&mut ending, self.kept)?;
        self.append(&ending)?;
        self.file.sync_all()
    }

    /// After a failed write: cuts the file back to its last complete chunk and ends it there without a summary. That
    /// takes 50 bytes, usually fewer than what was cut off, so it succeeds on a full disk; if not, readers miss only
    /// the end mark.
    pub(super) fn give_up(&mut self) -> io::Result<()> {
        self.file.set_len(self.kept)?;
        self.file.seek(SeekFrom::Start(self.kept))?;
        let mut ending = Vec::new();
        records::data_end(&mut ending, 0)?; // no checksum of the data
        Summary::emit_none(&mut ending);
        self.file.write_all(&ending)
    }

    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.file.write_all(bytes)?;
        self.kept += bytes.len() as u64;
        self.data_crc.update(bytes);
        Ok(())
    }
}
