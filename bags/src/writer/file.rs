//! One MCAP file that is written in whole chunks.
//!
//! The `mcap` writer is told to collect a chunk in memory and never to close one by itself, so a chunk reaches the
//! operating system in one piece and exactly when [`ChunkedFile::flush`] says. Whatever happens to the process, the
//! file is a sequence of complete chunks and at most one torn one.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use mcap::records::{self, op};
use mcap::{McapError, WriteOptions};

use super::Compression;
use crate::metadata::qos_to_yaml;
use crate::topic::TopicInfo;

/// Bytes of a message record besides its data: opcode, length, and the message header.
const MESSAGE_OVERHEAD: u64 = 1 + 8 + 22;

pub(super) struct ChunkedFile {
    path: PathBuf,
    /// Empty once the file is finished or given up.
    mcap: Option<mcap::Writer<BufWriter<File>>>,
    /// The same open file, to ask for its length and to cut it back.
    file: File,
    /// Length up to the end of the last complete chunk.
    kept: u64,
    /// Size of the messages in the open chunk, before compression.
    open_bytes: u64,
}

impl ChunkedFile {
    pub(super) fn create(path: &Path, compression: Compression) -> io::Result<Self> {
        let file = OpenOptions::new().write(true).create_new(true).open(path)?;
        let handle = file.try_clone()?;
        let options = WriteOptions::new()
            .profile("ros2")
            .library(concat!("downbeat ", env!("CARGO_PKG_VERSION")))
            .chunk_size(None)
            .disable_seeking(true);
        let options = match compression {
            Compression::None => options.compression(None),
            // The fastest level, as the real recorder's preset zstd_fast; threads of its own would only add latency.
            Compression::Zstd => {
                options.compression(Some(mcap::Compression::Zstd)).compression_level(1).compression_threads(0)
            }
        };
        let mcap = options.create(BufWriter::new(file)).map_err(io_error)?;
        Ok(Self { path: path.to_owned(), mcap: Some(mcap), file: handle, kept: 0, open_bytes: 0 })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes that are in the file and readable.
    pub(super) fn kept(&self) -> u64 {
        self.kept
    }

    pub(super) fn open_bytes(&self) -> u64 {
        self.open_bytes
    }

    /// Returns the channel of the topic.
    pub(super) fn add_topic(&mut self, topic: &TopicInfo) -> io::Result<u16> {
        let mcap = self.mcap()?;
        // The format asks for an empty encoding where there is no schema text.
        let encoding = if topic.definition.is_empty() { "" } else { "ros2msg" };
        let schema =
            mcap.add_schema(&topic.type_name, encoding, topic.definition.as_bytes()).map_err(io_error)?;
        let metadata = BTreeMap::from([
            ("offered_qos_profiles".to_owned(), qos_to_yaml(&topic.offered_qos)),
            ("topic_type_hash".to_owned(), topic.type_hash.clone()),
        ]);
        mcap.add_channel(schema, &topic.name, "cdr", &metadata).map_err(io_error)
    }

    pub(super) fn write(
        &mut self,
        channel_id: u16,
        log_time: u64,
        publish_time: u64,
        data: &[u8],
    ) -> io::Result<()> {
        // The real recorder leaves the sequence number at 0.
        let header = records::MessageHeader { channel_id, sequence: 0, log_time, publish_time };
        self.mcap()?.write_to_known_channel(&header, data).map_err(io_error)?;
        self.open_bytes += MESSAGE_OVERHEAD + data.len() as u64;
        Ok(())
    }

    /// Ends the open chunk and hands everything to the operating system.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        self.mcap()?.flush().map_err(io_error)?;
        self.kept = self.file.stream_position()?;
        self.open_bytes = 0;
        Ok(())
    }

    /// Writes the record in which rosbag2 keeps its metadata.
    pub(super) fn write_metadata(&mut self, text: String) -> io::Result<()> {
        let metadata = BTreeMap::from([("serialized_metadata".to_owned(), text)]);
        let record = records::Metadata { name: "rosbag2".to_owned(), metadata };
        self.mcap()?.write_metadata(&record).map_err(io_error)
    }

    /// Writes summary and footer and waits until the medium has them: robots are switched off after a recording.
    pub(super) fn finish(&mut self) -> io::Result<()> {
        self.mcap()?.finish().map_err(io_error)?;
        self.mcap = None;
        self.kept = self.file.stream_position()?;
        self.file.sync_all()
    }

    /// After a failed write: cuts the file back to its last complete chunk and ends it there without a summary. That
    /// takes 50 bytes, usually fewer than what was cut off, so it succeeds on a full disk; if not, readers miss only
    /// the end mark.
    pub(super) fn give_up(&mut self) -> io::Result<()> {
        if let Some(mcap) = self.mcap.take() {
            // Taken apart, so that neither the MCAP writer nor the buffer tries to write the rest once more.
            let _ = mcap.into_inner().into_parts();
        }
        self.file.set_len(self.kept)?;
        self.file.seek(SeekFrom::Start(self.kept))?;
        let mut ending = Vec::new();
        ending.push(op::DATA_END);
        ending.extend_from_slice(&4_u64.to_le_bytes());
        ending.extend_from_slice(&[0; 4]); // no checksum of the data
        ending.push(op::FOOTER);
        ending.extend_from_slice(&20_u64.to_le_bytes());
        ending.extend_from_slice(&[0; 20]); // no summary
        ending.extend_from_slice(mcap::MAGIC);
        self.file.write_all(&ending)
    }

    fn mcap(&mut self) -> io::Result<&mut mcap::Writer<BufWriter<File>>> {
        self.mcap.as_mut().ok_or_else(|| io::Error::other("the file is closed"))
    }
}

/// The operating system's error where there is one: its text is what the user can act on.
fn io_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(source) => source,
        other => io::Error::other(other),
    }
}
