#![allow(clippy::unwrap_used)]

use std::time::{Duration, Instant};

use super::{Writer, WriterError, WriterOptions};
use crate::metadata::{self, Metadata};
use crate::topic::TopicDescription;

fn topic(name: &str, type_name: &str) -> TopicDescription {
    TopicDescription { name: name.to_owned(), type_name: type_name.to_owned(), ..TopicDescription::default() }
}

fn written(writer: &Writer) -> u64 {
    writer.summary().message_count()
}

#[test]
fn a_chunk_is_written_when_it_is_as_old_as_the_flush_interval() {
    let folder = tempfile::tempdir().unwrap();
    let options = WriterOptions::new().flush_interval(Duration::from_secs(1));
    let mut writer = options.create(folder.path().join("bag")).unwrap();
    let id = writer.add_topic(topic("/a", "std_msgs/msg/Empty")).unwrap();
    let start = Instant::now();
    let length = || std::fs::metadata(folder.path().join("bag/bag_0.mcap")).unwrap().len();
    let empty = length();

    writer.write_at(start, id, 1, 1, &[0; 8]).unwrap();
    writer.write_at(start + Duration::from_millis(999), id, 2, 2, &[0; 8]).unwrap();
    assert_eq!((written(&writer), length()), (0, empty));
    writer.write_at(start + Duration::from_secs(1), id, 3, 3, &[0; 8]).unwrap();
    assert_eq!(written(&writer), 3);
    assert!(length() > empty, "passed to the operating system at once");
    assert_eq!(writer.summary().bytes, length());

    writer.write_at(start + Duration::from_millis(1500), id, 4, 4, &[0; 8]).unwrap();
    assert_eq!(written(&writer), 3, "the age counts from the first message of each chunk");
}

#[test]
fn a_chunk_is_written_when_it_is_full() {
    let folder = tempfile::tempdir().unwrap();
    let options = WriterOptions::new().chunk_size(1000).flush_interval(Duration::MAX);
    let mut writer = options.create(folder.path().join("bag")).unwrap();
    let id = writer.add_topic(topic("/a", "std_msgs/msg/Empty")).unwrap();
    writer.write(id, 1, 1, &[0; 600]).unwrap();
    assert_eq!(written(&writer), 0);
    writer.write(id, 2, 2, &[0; 600]).unwrap();
    assert_eq!(written(&writer), 2);
}

#[test]
fn metadata_yaml_exists_from_the_start_and_is_updated() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    let read = || Metadata::read(&bag.join(metadata::FILE_NAME)).unwrap();
    assert_eq!((read().message_count, read().starting_time), (0, metadata::NEVER));

    let id = writer.add_topic(topic("/a", "std_msgs/msg/Empty")).unwrap();
    writer.write(id, 100, 90, &[0; 8]).unwrap();
    writer.flush().unwrap();
    assert_eq!(read().topics.len(), 1, "a new topic is listed with the next flush");
    let later = Instant::now() + super::METADATA_INTERVAL;
    writer.write_at(later, id, 300, 290, &[0; 8]).unwrap();
    // However long the last update took.
    writer.flush_at(later + 3600 * super::METADATA_INTERVAL).unwrap();
    assert_eq!(read().message_count, 2);
    assert_eq!((read().starting_time, read().duration), (100, Duration::from_nanos(200)));
}

#[test]
fn an_existing_directory_is_refused_and_not_changed() {
    let folder = tempfile::tempdir().unwrap();
    let error = WriterOptions::new().create(folder.path()).err().unwrap();
    assert!(matches!(&error, WriterError::AlreadyExists { path } if path == folder.path()), "{error}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_topic_has_one_type() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = WriterOptions::new().create(folder.path().join("bag")).unwrap();
    let id = writer.add_topic(topic("/a", "std_msgs/msg/Empty")).unwrap();
    assert_eq!(writer.add_topic(topic("/a", "std_msgs/msg/Empty")).unwrap(), id);
    let error = writer.add_topic(topic("/a", "std_msgs/msg/String")).unwrap_err();
    assert!(matches!(error, WriterError::TypeConflict { .. }), "{error}");
}

#[test]
fn a_time_before_the_epoch_is_refused_and_recording_continues() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = WriterOptions::new().create(folder.path().join("bag")).unwrap();
    let id = writer.add_topic(topic("/a", "std_msgs/msg/Empty")).unwrap();
    let error = writer.write(id, -1, 0, &[]).unwrap_err();
    assert!(matches!(error, WriterError::NegativeTime { time: -1, .. }), "{error}");
    writer.write(id, 0, 0, &[]).unwrap();
    assert_eq!(writer.finish().unwrap().message_count(), 1);
}

#[test]
fn dropping_a_writer_finishes_its_bag() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    let id = writer.add_topic(topic("/a", "std_msgs/msg/Empty")).unwrap();
    writer.write(id, 5, 5, &[0; 8]).unwrap();
    drop(writer);
    assert_eq!(Metadata::read(&bag.join(metadata::FILE_NAME)).unwrap().message_count, 1);
    assert!(std::fs::read(bag.join("bag_0.mcap")).unwrap().ends_with(mcap::MAGIC));
}
