//! rosbag2 metadata: the file metadata.yaml and the metadata record inside an MCAP file.
//!
//! Source of the format: `rosbag2_storage/bag_metadata.hpp`, `yaml.hpp` and `qos.cpp` of branch jazzy
//! (version 9).

mod emit;
mod parse;
mod qos;

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::{user_file, yaml};

pub use qos::{RecordedDurability, RecordedHistory, RecordedLiveliness, RecordedQos, RecordedReliability};

/// The version of the metadata that is written.
pub const FORMAT_VERSION: u32 = 9;

/// The version of ROS 2 Humble, which is written on request: QoS profiles are texts with numbers. Keys of
/// later versions are written too; readers of this version ignore them.
pub const HUMBLE_VERSION: u32 = 5;

/// The distribution of ROS 2 in whose environment this process runs (`ROS_DISTRO`, as rosbag2 reads it), or
/// `jazzy`, whose format is written.
#[must_use]
pub fn ros_distro() -> String {
    let set = std::env::var("ROS_DISTRO").ok().filter(|name| !name.is_empty());
    set.unwrap_or_else(|| "jazzy".to_owned())
}

/// The name of the metadata file in a bag directory.
pub const FILE_NAME: &str = "metadata.yaml";

/// Start time of a bag without messages, as in rosbag2.
pub const NEVER: i64 = i64::MAX;

/// The contents of metadata.yaml. Times are nanoseconds since the epoch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Metadata {
    /// The version when it was read. [`HUMBLE_VERSION`] is written as it is, others as [`FORMAT_VERSION`].
    pub version: u32,
    /// `mcap` or `sqlite3`.
    pub storage_identifier: String,
    /// From the first to the last message.
    pub duration: Duration,
    /// The receive time of the first message, [`NEVER`] if there is none.
    pub starting_time: i64,
    /// Messages of all topics.
    pub message_count: u64,
    /// The topics, including those without messages.
    pub topics: Vec<TopicMetadata>,
    /// `zstd` when whole files or messages are compressed; empty for compressed MCAP chunks.
    pub compression_format: String,
    /// `FILE`, `MESSAGE` or empty.
    pub compression_mode: String,
    /// The bag files, relative to the directory.
    pub relative_file_paths: Vec<String>,
    /// More about each file (since version 5).
    pub files: Vec<FileMetadata>,
    /// Custom data of the user.
    pub custom_data: BTreeMap<String, String>,
    /// `jazzy`; empty before version 8.
    pub ros_distro: String,
    /// What could not be understood of the entries of topics and files, and was replaced by a default or left
    /// out: a sentence for each. Not written.
    pub oddities: Vec<String>,
}

/// The entry of a topic in metadata.yaml.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicMetadata {
    /// Topic name.
    pub name: String,
    /// ROS type name.
    pub type_name: String,
    /// `cdr`.
    pub serialization_format: String,
    /// What each publisher offered (since version 4).
    pub offered_qos: Vec<RecordedQos>,
    /// Type hash (since version 7), else empty.
    pub type_hash: String,
    /// Messages of this topic.
    pub message_count: u64,
}

/// The entry of a bag file in metadata.yaml.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileMetadata {
    /// Relative to the directory.
    pub path: String,
    /// The receive time of its first message, [`NEVER`] if it has none.
    pub starting_time: i64,
    /// From its first to its last message.
    pub duration: Duration,
    /// The number of messages in it.
    pub message_count: u64,
}

/// Why metadata could not be read.
#[derive(Debug, thiserror::Error)]
pub enum MetadataError {
    /// The file could not be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The text is not rosbag2 metadata.
    #[error("{}:{line}: not rosbag2 metadata as expected: {found}", path.display())]
    Form {
        /// The file.
        path: PathBuf,
        /// The line, counted from 1; 0 if unknown.
        line: usize,
        /// The problem.
        found: String,
    },
}

impl Metadata {
    /// Reads `metadata.yaml`.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read or is not rosbag2 metadata; then the error names file and
    /// line.
    pub fn read(path: &Path) -> Result<Self, MetadataError> {
        let text = user_file::read_text(path)
            .map_err(|source| MetadataError::Read { path: path.to_owned(), source })?;
        Self::parse(&text, path)
    }

    /// Reads the text of a metadata.yaml; `path` is for error messages.
    ///
    /// # Errors
    /// Returns an error if the text is not rosbag2 metadata.
    pub fn parse(text: &str, path: &Path) -> Result<Self, MetadataError> {
        let root: parse::Root = yaml::from_str(text).map_err(|error| form(path, &error))?;
        Ok(root.into())
    }

    /// Reads the text of the metadata record inside an MCAP file; `path` is for error messages.
    ///
    /// # Errors
    /// Returns an error if the text is not rosbag2 metadata; the line is that within the record.
    pub fn parse_record(text: &str, path: &Path) -> Result<Self, MetadataError> {
        let information: parse::Information = yaml::from_str(text).map_err(|error| form(path, &error))?;
        Ok(information.into())
    }

    /// The text of metadata.yaml, in version 9 or 5.
    #[must_use]
    pub fn to_yaml(&self) -> String {
        emit::file_text(self)
    }

    /// The text of the metadata record inside an MCAP file, in version 9 or 5.
    #[must_use]
    pub fn to_record(&self) -> String {
        emit::record_text(self)
    }

    /// Replaces the metadata.yaml of `directory` atomically: readers see either the complete old or the
    /// complete new text.
    ///
    /// # Errors
    /// The error of the operating system.
    pub fn replace_in(&self, directory: &Path) -> io::Result<()> {
        let temporary = directory.join(".metadata.yaml.new");
        let write = || fs::File::create(&temporary)?.write_all(self.to_yaml().as_bytes());
        write().and_then(|()| fs::rename(&temporary, directory.join(FILE_NAME))).inspect_err(|_| {
            // The first error is the one to report.
            let _ = fs::remove_file(&temporary);
        })
    }
}

impl Metadata {
    /// Overwrites the metadata.yaml of `directory` in place, if it fits into the blocks of the file: on a
    /// full disk nothing else can be written. A concurrent reader may see a partial file.
    #[cfg(unix)]
    pub(crate) fn overwrite_in(&self, directory: &Path) -> io::Result<()> {
        use std::os::unix::fs::MetadataExt;
        let text = self.to_yaml();
        let mut file = fs::OpenOptions::new().write(true).open(directory.join(FILE_NAME))?;
        // `st_blocks` counts in units of 512 bytes on every system.
        if file.metadata()?.blocks().saturating_mul(512) < text.len() as u64 {
            return Err(io::ErrorKind::StorageFull.into());
        }
        file.write_all(text.as_bytes())?;
        file.set_len(text.len() as u64)
    }

    /// Not implemented on other systems.
    #[cfg(not(unix))]
    pub(crate) fn overwrite_in(&self, _: &Path) -> io::Result<()> {
        Err(io::ErrorKind::StorageFull.into())
    }
}

/// The YAML text of the MCAP channel metadata `offered_qos_profiles`.
#[must_use]
pub fn qos_to_yaml(profiles: &[QosProfile]) -> String {
    let recorded: Vec<RecordedQos> = profiles.iter().map(RecordedQos::from).collect();
    recorded_qos_to_yaml(&recorded, FORMAT_VERSION)
}

/// The YAML text of the MCAP channel metadata `offered_qos_profiles`, of profiles as stored in a bag with
/// metadata of that version.
#[must_use]
pub fn recorded_qos_to_yaml(profiles: &[RecordedQos], version: u32) -> String {
    emit::qos_text(profiles, version)
}

/// Reads the YAML text of the MCAP channel metadata `offered_qos_profiles`; `path` is for error messages.
///
/// # Errors
/// Returns an error if the text is not a list of profiles; the line is that within the text.
pub fn qos_from_yaml(text: &str, path: &Path) -> Result<Vec<RecordedQos>, MetadataError> {
    if text.trim().is_empty() {
        return Ok(Vec::new());
    }
    let list: parse::QosList = yaml::from_str(text).map_err(|error| form(path, &error))?;
    Ok(list.0)
}

fn form(path: &Path, error: &serde_norway::Error) -> MetadataError {
    let line = error.location().map_or(0, |location| location.line());
    MetadataError::Form { path: path.to_owned(), line, found: error.to_string() }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::path::Path;
    use std::time::Duration;

    use downbeat_msgs::qos::{Durability, History, Liveliness, QosProfile};

    use super::{Metadata, MetadataError, RecordedHistory, qos_from_yaml, qos_to_yaml};

    const OLD: &str = r#"rosbag2_bagfile_information:
  version: 5
  storage_identifier: sqlite3
  duration:
    nanoseconds: 2000000000
  starting_time:
    nanoseconds_since_epoch: 1600000000000000000
  message_count: 3
  topics_with_message_count:
    - topic_metadata:
        name: /chatter
        type: std_msgs/msg/String
        serialization_format: cdr
        offered_qos_profiles: "- history: 3\n  depth: 0\n  reliability: 1\n  durability: 2\n  deadline:\n    sec: 2147483647\n    nsec: 4294967295\n  lifespan:\n    sec: 10\n    nsec: 5\n  liveliness: 1\n  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n  avoid_ros_namespace_conventions: false"
      message_count: 3
  compression_format: ""
  compression_mode: ""
  relative_file_paths:
    - old_0.db3
"#;

    #[test]
    fn the_older_form_with_quality_of_service_as_text_with_numbers_is_read() {
        let metadata = Metadata::parse(OLD, Path::new("metadata.yaml")).unwrap();
        let qos = metadata.topics[0].offered_qos[0];
        assert_eq!(qos.history, RecordedHistory::Unknown);
        assert_eq!(qos.deadline, None, "the infinite of Fast DDS in Foxy");
        assert_eq!(qos.lifespan, Some(Duration::new(10, 5)));
        assert_eq!(qos.to_profile().durability, Durability::Volatile);
        assert!(metadata.files.is_empty() && metadata.ros_distro.is_empty());
    }

    #[test]
    fn an_error_names_the_file_and_the_line() {
        let broken = OLD.replace("message_count: 3\n  topics", "message_count: many\n  topics");
        let error = Metadata::parse(&broken, Path::new("bag/metadata.yaml")).unwrap_err();
        let MetadataError::Form { line, .. } = &error else { panic!("{error}") };
        assert_eq!(*line, 8, "{error}");
        assert!(error.to_string().starts_with("bag/metadata.yaml:8: "), "{error}");
    }

    #[test]
    fn odd_quality_of_service_is_noted_and_the_rest_is_read() {
        let line = OLD.lines().find(|line| line.contains("offered_qos_profiles")).unwrap();
        let key = "        offered_qos_profiles: ";
        for odd in [
            r#""history: keep_all\n  depth: 5""#,
            r#""history: keep_all\ndepth: 5\nreliability: reliable\ndurability: volatile""#,
            r#""- history: 3\n  depth: 0\n  reliability: [""#,
            "{history: keep_last}",
            "[{history: keep_last, depth: -1, reliability: reliable, durability: volatile}]",
            "[{history: [], depth: 1, reliability: reliable, durability: volatile}]",
            "[7]",
            "12",
            "[{history: 1, reliability: 1, durability: 1, deadline: never}]",
        ] {
            let metadata =
                Metadata::parse(&OLD.replace(line, &format!("{key}{odd}")), Path::new("m")).unwrap();
            assert_eq!(metadata.topics[0].name, "/chatter", "{odd}");
            assert_eq!(metadata.topics[0].offered_qos, [], "{odd}");
            assert_eq!(metadata.oddities.len(), 1, "{odd}");
            assert!(metadata.oddities[0].starts_with("/chatter: its offered_qos_profiles is odd"), "{odd}");
        }
        assert_eq!(Metadata::parse(OLD, Path::new("m")).unwrap().oddities, [""; 0]);
    }

    #[test]
    fn odd_entries_of_topics_and_files_are_noted_and_the_rest_is_read() {
        for (from, to, note) in [
            ("type: std_msgs/msg/String", "type: [1]", "/chatter: its type is odd"),
            ("serialization_format: cdr", "serialization_format: {}", "/chatter: its serialization_format"),
            ("      message_count: 3\n", "      message_count: many\n", "/chatter: its message_count"),
            ("name: /chatter", "name: [x]", "a topic without a name"),
            ("relative_file_paths:", "files: [{path: 3}]\n  relative_file_paths:", "the entry of file 1"),
            ("relative_file_paths:", "custom_data: {a: [1], b: 2}\n  relative_file_paths:", "custom_data"),
        ] {
            let text = OLD.replacen(from, to, 1);
            assert_ne!(text, OLD, "{from}");
            let metadata = Metadata::parse(&text, Path::new("m")).unwrap();
            assert_eq!(metadata.message_count, 3);
            assert_eq!(metadata.oddities.len(), 1, "{to}: {:?}", metadata.oddities);
            assert!(metadata.oddities[0].contains(note), "{to}: {:?}", metadata.oddities);
        }
    }

    #[test]
    fn every_profile_survives_writing_and_reading() {
        let odd = QosProfile {
            history: History::KeepAll,
            deadline: Some(Duration::from_millis(1500)),
            liveliness: Liveliness::ManualByTopic,
            liveliness_lease_duration: Some(Duration::from_nanos(1)),
            ..QosProfile::DEFAULT
        };
        let profiles =
            [QosProfile::DEFAULT, QosProfile::SENSOR_DATA, QosProfile::ROSOUT, QosProfile::LATCHED, odd];
        let read = qos_from_yaml(&qos_to_yaml(&profiles), Path::new("x")).unwrap();
        let read: Vec<QosProfile> = read.iter().map(super::RecordedQos::to_profile).collect();
        assert_eq!(read, profiles);
        assert_eq!(qos_to_yaml(&[]), "[]");
        let recorded: Vec<super::RecordedQos> = profiles.iter().map(Into::into).collect();
        let of_humble = super::recorded_qos_to_yaml(&recorded, super::HUMBLE_VERSION);
        assert_eq!(qos_from_yaml(&of_humble, Path::new("x")).unwrap(), recorded);
        assert!(!of_humble.contains("reliable"), "{of_humble}");
        assert!(qos_from_yaml("[]", Path::new("x")).unwrap().is_empty());
    }

    #[test]
    fn custom_data_may_have_any_number_of_brackets() {
        let mut metadata = Metadata::parse(OLD, Path::new("m")).unwrap();
        metadata.version = super::FORMAT_VERSION;
        metadata.custom_data.insert("settings".to_owned(), "{\"a\": [1]}, ".repeat(20_000));
        assert_eq!(Metadata::parse(&metadata.to_yaml(), Path::new("m")).unwrap(), metadata);
    }

    #[test]
    fn custom_data_is_read_back_as_text_even_where_it_looks_like_something_else() {
        let mut metadata = Metadata::parse(OLD, Path::new("m")).unwrap();
        metadata.version = super::FORMAT_VERSION;
        for (key, value) in [("emulated", "true"), ("note", "line 1\nline 2: \"x\""), ("run", "007")] {
            metadata.custom_data.insert(key.to_owned(), value.to_owned());
        }
        assert_eq!(Metadata::parse(&metadata.to_yaml(), Path::new("m")).unwrap(), metadata);
        let unquoted = metadata.to_yaml().replace("emulated: \"true\"", "emulated: true");
        assert_eq!(Metadata::parse(&unquoted, Path::new("m")).unwrap(), metadata);
    }
}
