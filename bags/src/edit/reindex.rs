//! Recreates metadata.yaml from the files of a bag.

use std::path::Path;

use super::CopyError;
use crate::metadata::{self, FORMAT_VERSION, FileMetadata, Metadata, RecordedQos, TopicMetadata};
use crate::reader::{Reader, RecordedTopic};

/// Recreates the metadata.yaml of a bag directory from its files, like `ros2 bag reindex`. An existing one is
/// only used for what the files do not contain: `custom_data` is kept if it is readable.
///
/// # Errors
/// If there are no files, or they cannot be read, or metadata.yaml cannot be written.
pub fn reindex(directory: &Path) -> Result<Metadata, CopyError> {
    let reader = Reader::open_files_of(directory)?;
    let told = Metadata::read(&directory.join(metadata::FILE_NAME)).ok();
    let told = told.as_ref().or(reader.metadata());
    let is_packed = reader.files().any(|path| path.extension().is_some_and(|ending| ending == "zstd"));
    let mode = match told.map(|told| told.compression_mode.as_str()) {
        Some(mode) if mode.eq_ignore_ascii_case("message") => mode.to_owned(),
        _ if is_packed => "FILE".to_owned(),
        _ => String::new(),
    };
    let files: Vec<FileMetadata> = reader.file_metadata().collect();
    let metadata = Metadata {
        version: FORMAT_VERSION,
        storage_identifier: reader.storage_identifier().to_owned(),
        duration: reader.duration(),
        starting_time: reader.start_time().unwrap_or(metadata::NEVER),
        message_count: reader.message_count(),
        topics: reader
            .topics()
            .iter()
            .map(|topic| TopicMetadata {
                name: topic.info.name.clone(),
                type_name: topic.info.type_name.clone(),
                serialization_format: topic.serialization_format.clone(),
                offered_qos: offered_qos(topic, told),
                type_hash: topic.info.type_hash.clone(),
                message_count: topic.message_count,
            })
            .collect(),
        compression_format: if mode.is_empty() { String::new() } else { "zstd".to_owned() },
        compression_mode: mode,
        relative_file_paths: files.iter().map(|file| file.path.clone()).collect(),
        files,
        custom_data: told.map(|told| told.custom_data.clone()).unwrap_or_default(),
        ros_distro: told.map(|told| told.ros_distro.clone()).unwrap_or_default(),
    };
    let path = directory.join(metadata::FILE_NAME);
    metadata
        .replace_in(directory)
        .map_err(|error| CopyError::File { path: path.clone(), found: error.to_string() })?;
    Ok(Metadata::read(&path)?)
}

/// The profiles in the old metadata, which can contain more than one in the file, or else those in the file.
fn offered_qos(topic: &RecordedTopic, told: Option<&Metadata>) -> Vec<RecordedQos> {
    let topics = told.map(|told| told.topics.as_slice()).unwrap_or_default();
    let told = topics.iter().find(|told| told.name == topic.info.name && !told.offered_qos.is_empty());
    told.map_or(&topic.info.offered_qos, |told| &told.offered_qos).clone()
}
