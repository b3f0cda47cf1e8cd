//! Options of MCAP files, as in preset profiles and storage config files of `rosbag2_storage_mcap`.
//!
//! # References
//! `rosbag2_storage_mcap/src/mcap_storage.cpp` and `README.md`, branch jazzy.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::Deserialize;

use crate::storage::Storage;

/// How chunks are compressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// No compression: the least work while recording. The default of rosbag2.
    #[default]
    None,
    /// LZ4, with a single level, since no pure Rust encoder has more.
    Lz4,
    /// Zstandard; see [`CompressionLevel`]. The compressors are slower than the one in C (see README.md) and
    /// run when a chunk is written: use [`Recording`](crate::Recording) if the thread must not wait for that.
    Zstd,
}

impl Compression {
    /// All compressions with their names in robot files and on the command line.
    pub const ALL: [(&'static str, Self); 3] =
        [("none", Self::None), ("lz4", Self::Lz4), ("zstd", Self::Zstd)];
}

/// The effort of the compressor, with the names of the MCAP C++ library.
///
/// No pure Rust Zstandard encoder has all levels. `Fastest` and `Fast` use one compressor optimised for
/// speed, like the negative levels of the C library. `Default` uses another one, close to the C library's
/// level 1, which also codes literals but has a smaller window. `Slow` and `Slowest` run both and keep the
/// smaller result.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CompressionLevel {
    /// Zstandard -5 in C.
    Fastest,
    /// Zstandard -3 in C.
    Fast,
    /// Zstandard 1 in C.
    #[default]
    Default,
    /// Zstandard 5 in C.
    Slow,
    /// Zstandard 19 in C.
    Slowest,
}

/// A preset profile of rosbag2 for the storage `mcap`: `--storage-preset-profile`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StoragePreset {
    /// The default of rosbag2: chunks without compression and checksums.
    #[default]
    None,
    /// No chunks and no checksums: the least work, and a file without an index of its messages.
    FastWrite,
    /// Zstandard at its fastest, no checksums of chunks.
    ZstdFast,
    /// Zstandard at its smallest, chunks of 4 MiB.
    ZstdSmall,
}

impl StoragePreset {
    /// All presets with their names in rosbag2.
    pub const ALL: [(&'static str, Self); 4] = [
        ("none", Self::None),
        ("fastwrite", Self::FastWrite),
        ("zstd_fast", Self::ZstdFast),
        ("zstd_small", Self::ZstdSmall),
    ];

    /// The options of the preset.
    #[must_use]
    pub fn options(self) -> McapOptions {
        // rosbag2 sets these two before applying the preset.
        let rosbag2 = McapOptions { has_chunk_crc: false, has_data_crc: false, ..McapOptions::default() };
        let zstd = |level| McapOptions { compression: Compression::Zstd, level, ..rosbag2 };
        match self {
            Self::None => rosbag2,
            Self::FastWrite => McapOptions { is_chunked: false, has_summary_crc: false, ..rosbag2 },
            Self::ZstdFast => zstd(CompressionLevel::Fastest),
            // Its checksums stay off in rosbag2, though its README says otherwise.
            Self::ZstdSmall => McapOptions { chunk_size: 4 * 1024 * 1024, ..zstd(CompressionLevel::Slowest) },
        }
    }
}

impl fmt::Display for StoragePreset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(Self::ALL.iter().find(|(_, preset)| preset == self).map_or("", |(name, _)| name))
    }
}

impl FromStr for StoragePreset {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL.iter().find(|(name, _)| *name == text).map(|&(_, preset)| preset).ok_or_else(|| {
            format!(
                "unknown preset profile \"{text}\"; available are {}",
                Self::ALL.map(|(name, _)| name).join(", ")
            )
        })
    }
}

/// The layout of an MCAP file. The default is that of rosbag2 with additional checksums of chunks and of the
/// file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct McapOptions {
    /// How chunks are compressed.
    pub compression: Compression,
    /// How much work the compressor does.
    pub level: CompressionLevel,
    /// The size in bytes, before compression, at which a chunk is closed; without chunks, at which collected
    /// records are passed to the operating system.
    pub chunk_size: u64,
    /// Whether a chunk is compressed even if that saves less than 2 %, or it is smaller than 1 KiB.
    pub is_compression_forced: bool,
    /// Whether messages are stored in chunks.
    pub is_chunked: bool,
    /// Whether a chunk has a checksum.
    pub has_chunk_crc: bool,
    /// Whether the data before the summary has a checksum.
    pub has_data_crc: bool,
    /// Whether the summary has a checksum.
    pub has_summary_crc: bool,
    /// Whether chunks have an index of their messages.
    pub has_message_index: bool,
    /// Whether the file ends with a summary.
    pub has_summary: bool,
    /// Whether the summary has all schemas.
    pub repeats_schemas: bool,
    /// Whether the summary has all channels.
    pub repeats_channels: bool,
    /// Whether the summary has statistics.
    pub has_statistics: bool,
    /// Whether the summary has an index of chunks.
    pub has_chunk_index: bool,
    /// Whether the summary has an index of metadata.
    pub has_metadata_index: bool,
    /// Whether the summary has an index of its parts.
    pub has_summary_offsets: bool,
}

/// The chunk size of rosbag2 (that of the MCAP C++ library it carries): 768 KiB.
pub(super) const DEFAULT_CHUNK_SIZE: u64 = 768 * 1024;

impl Default for McapOptions {
    fn default() -> Self {
        Self {
            compression: Compression::None,
            level: CompressionLevel::Default,
            chunk_size: DEFAULT_CHUNK_SIZE,
            is_compression_forced: false,
            is_chunked: true,
            has_chunk_crc: true,
            has_data_crc: true,
            has_summary_crc: true,
            has_message_index: true,
            has_summary: true,
            repeats_schemas: true,
            repeats_channels: true,
            has_statistics: true,
            has_chunk_index: true,
            has_metadata_index: true,
            has_summary_offsets: true,
        }
    }
}

/// Why a storage config file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum StorageConfigError {
    /// It could not be read.
    #[error("cannot read the storage config file {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// `rosbag2_storage_mcap`, or `_sqlite3`, would not accept it.
    #[error("{}:{line}: invalid storage config file of rosbag2_storage_{storage}: {found}", path.display())]
    Form {
        /// The file.
        path: PathBuf,
        /// The line, counted from 1; 0 if unknown.
        line: usize,
        /// The storage whose format it should have.
        storage: Storage,
        /// The problem.
        found: String,
    },
}

impl McapOptions {
    /// Overrides these options with those of a storage config file: `--storage-config-file`.
    ///
    /// ```
    /// use downbeat_bags::{Compression, CompressionLevel, StoragePreset};
    ///
    /// let text = "compression: Zstd\ncompressionLevel: Fast\nchunkSize: 1048576\nnoChunkCRC: false\n";
    /// let options = StoragePreset::None.options().with_config(text, "storage.yaml".as_ref())?;
    /// assert_eq!((options.compression, options.level), (Compression::Zstd, CompressionLevel::Fast));
    /// assert!(options.has_chunk_crc);
    /// # Ok::<(), downbeat_bags::StorageConfigError>(())
    /// ```
    ///
    /// Keys that rosbag2 does not know are ignored like there, but with a warning; `path` is for messages.
    ///
    /// # Errors
    /// Returns an error if rosbag2 would not accept the text.
    pub fn with_config(self, text: &str, path: &Path) -> Result<Self, StorageConfigError> {
        let form = |error: &serde_norway::Error| StorageConfigError::Form {
            path: path.to_owned(),
            line: error.location().map_or(0, |location| location.line()),
            storage: Storage::Mcap,
            found: error.to_string(),
        };
        // An empty file has no settings.
        let config: Option<Config> = downbeat_msgs::yaml::from_str(text).map_err(|error| form(&error))?;
        let config = config.unwrap_or_default();
        for key in config.unknown.keys().filter(|key| !WITHOUT_EFFECT.contains(&key.as_str())) {
            tracing::warn!("{}: unknown key \"{key}\" is ignored", path.display());
        }
        let unless = |no: Option<Flag>, otherwise: bool| no.map_or(otherwise, |no| !no.0);
        Ok(Self {
            compression: config.compression.map_or(self.compression, Into::into),
            level: config.compression_level.map_or(self.level, Into::into),
            chunk_size: config.chunk_size.unwrap_or(self.chunk_size),
            is_compression_forced: config.force_compression.map_or(self.is_compression_forced, |flag| flag.0),
            is_chunked: unless(config.no_chunking, self.is_chunked),
            has_chunk_crc: unless(config.no_chunk_crc, self.has_chunk_crc),
            has_data_crc: config.enable_data_crc.map_or(self.has_data_crc, |flag| flag.0),
            has_summary_crc: unless(config.no_summary_crc, self.has_summary_crc),
            has_message_index: unless(config.no_message_index, self.has_message_index),
            has_summary: unless(config.no_summary, self.has_summary),
            repeats_schemas: unless(config.no_repeated_schemas, self.repeats_schemas),
            repeats_channels: unless(config.no_repeated_channels, self.repeats_channels),
            has_statistics: unless(config.no_statistics, self.has_statistics),
            has_chunk_index: unless(config.no_chunk_index, self.has_chunk_index),
            has_metadata_index: unless(config.no_metadata_index, self.has_metadata_index),
            has_summary_offsets: unless(config.no_summary_offsets, self.has_summary_offsets),
        })
    }

    /// [`McapOptions::with_config`] with the text of a file.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read, or rosbag2 would not accept it.
    pub fn with_config_file(self, path: &Path) -> Result<Self, StorageConfigError> {
        let read = |source| StorageConfigError::Read { path: path.to_owned(), source };
        self.with_config(&downbeat_msgs::user_file::read_text(path).map_err(read)?, path)
    }
}

/// Keys of rosbag2 without effect: bags have no attachments.
const WITHOUT_EFFECT: [&str; 2] = ["noAttachmentCRC", "noAttachmentIndex"];

/// The keys are those of `mcap::McapWriterOptions`.
#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase")]
struct Config {
    #[serde(rename = "noChunkCRC")]
    no_chunk_crc: Option<Flag>,
    #[serde(rename = "enableDataCRC")]
    enable_data_crc: Option<Flag>,
    #[serde(rename = "noSummaryCRC")]
    no_summary_crc: Option<Flag>,
    no_chunking: Option<Flag>,
    no_message_index: Option<Flag>,
    no_summary: Option<Flag>,
    chunk_size: Option<u64>,
    compression: Option<CompressionName>,
    compression_level: Option<LevelName>,
    force_compression: Option<Flag>,
    no_repeated_schemas: Option<Flag>,
    no_repeated_channels: Option<Flag>,
    no_metadata_index: Option<Flag>,
    no_chunk_index: Option<Flag>,
    no_statistics: Option<Flag>,
    no_summary_offsets: Option<Flag>,
    #[serde(flatten)]
    unknown: std::collections::BTreeMap<String, serde_norway::Value>,
}

/// A boolean of YAML 1.1, which yaml-cpp reads.
#[derive(Clone, Copy)]
struct Flag(bool);

impl<'de> Deserialize<'de> for Flag {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Either {
            Truth(bool),
            Word(String),
        }
        match Either::deserialize(deserializer)? {
            Either::Truth(truth) => Ok(Self(truth)),
            Either::Word(word) => match word.to_ascii_lowercase().as_str() {
                "y" | "yes" | "on" => Ok(Self(true)),
                "n" | "no" | "off" => Ok(Self(false)),
                _ => Err(serde::de::Error::custom(format!("\"{word}\" is neither true nor false"))),
            },
        }
    }
}

#[derive(Clone, Copy, Deserialize)]
enum CompressionName {
    None,
    Lz4,
    Zstd,
}

impl From<CompressionName> for Compression {
    fn from(name: CompressionName) -> Self {
        match name {
            CompressionName::None => Self::None,
            CompressionName::Lz4 => Self::Lz4,
            CompressionName::Zstd => Self::Zstd,
        }
    }
}

#[derive(Clone, Copy, Deserialize)]
enum LevelName {
    Fastest,
    Fast,
    Default,
    Slow,
    Slowest,
}

impl From<LevelName> for CompressionLevel {
    fn from(name: LevelName) -> Self {
        match name {
            LevelName::Fastest => Self::Fastest,
            LevelName::Fast => Self::Fast,
            LevelName::Default => Self::Default,
            LevelName::Slow => Self::Slow,
            LevelName::Slowest => Self::Slowest,
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_config_file_overrides_the_preset_key_by_key() {
        // The example of rosbag2_storage_mcap/README.md.
        let text = "# mcap_writer_options.yml\nnoChunkCRC: false\nnoChunking: false\nnoMessageIndex: false\n\
                    noSummary: false\nchunkSize: 786432\ncompression: \"Zstd\"\ncompressionLevel: \"Fast\"\n\
                    forceCompression: false\n";
        let read = StoragePreset::FastWrite.options().with_config(text, Path::new("m.yml")).unwrap();
        let expected = McapOptions {
            compression: Compression::Zstd,
            level: CompressionLevel::Fast,
            has_data_crc: false,
            has_summary_crc: false,
            ..McapOptions::default()
        };
        assert_eq!(read, expected);
        assert_eq!(McapOptions::default().with_config("", Path::new("m")).unwrap(), McapOptions::default());
    }

    #[test]
    fn booleans_are_those_of_yaml_1_1_and_errors_have_their_line() {
        let read = |text: &str| McapOptions::default().with_config(text, Path::new("m.yml"));
        assert!(!read("noSummary: yes\n").unwrap().has_summary);
        assert!(read("noSummary: Off\nnoAttachmentCRC: true\n").unwrap().has_summary);
        for wrong in ["chunkSize: 10\ncompression: Gzip\n", "noSummary: maybe\n", "- a\n"] {
            let error = read(wrong).unwrap_err().to_string();
            assert!(error.starts_with("m.yml:"), "{error}");
        }
    }
}
