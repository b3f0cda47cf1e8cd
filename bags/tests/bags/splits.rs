//! Bags of several files.

use std::fs;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use downbeat_bags::metadata::{FILE_NAME, Metadata};
use downbeat_bags::{FileSplit, Reader, SplitLimits, Writer, WriterError, WriterOptions};

use crate::matrix::{Way, With};
use crate::python::read_with_python;
use crate::support::{messages, noted, number, topic, value, write_numbers};

fn read(bag: &Path) -> Vec<i64> {
    messages(&Reader::open(bag).unwrap()).iter().map(value).collect()
}

fn by_size(bytes: u64) -> WriterOptions {
    let limits = SplitLimits { max_bytes: Some(bytes), ..SplitLimits::NONE };
    WriterOptions::new().split(limits).flush_interval(Duration::MAX)
}

#[test]
fn a_bag_split_by_size_has_files_of_that_size_and_all_messages() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = by_size(10_000).create(&bag).unwrap();
    write_numbers(&mut writer, 2000);
    writer.finish().unwrap();

    let metadata = Metadata::read(&bag.join(FILE_NAME)).unwrap();
    assert!(metadata.files.len() > 5, "{}", metadata.files.len());
    let names: Vec<_> = (0..metadata.files.len()).map(|number| format!("bag_{number}.mcap")).collect();
    assert_eq!(metadata.relative_file_paths, names);
    let mut next = 0;
    for file in &metadata.files {
        let size = fs::metadata(bag.join(&file.path)).unwrap().len();
        assert!((8_000..20_000).contains(&size) || next + file.message_count == 2000, "{size}");
        assert_eq!(file.starting_time, next as i64 * 1_000_000, "{}", file.path);
        assert_eq!(file.duration, Duration::from_millis(file.message_count - 1));
        assert_eq!(read(&bag.join(&file.path)).len() as u64, file.message_count);
        next += file.message_count;
    }
    assert_eq!((metadata.message_count, next), (2000, 2000));
    assert_eq!(read(&bag), (0..2000).collect::<Vec<_>>());
    let Some(found) = read_with_python("count_split.py", &bag) else { return };
    let _checks = [With::Mcap, With::Rosbags].map(|with| noted("a bag of several files", with, Way::Out));
    assert_eq!(found["rosbags"], 2000);
    assert_eq!(found["files"].as_array().unwrap().len(), metadata.files.len());
    let in_mcap: u64 = found["files"].as_array().unwrap().iter().map(|count| count.as_u64().unwrap()).sum();
    assert_eq!(in_mcap, 2000);
}

#[test]
fn a_bag_split_by_duration_starts_a_file_with_the_first_later_message() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let limits = SplitLimits { max_duration: Some(Duration::from_millis(100)), ..SplitLimits::NONE };
    let mut writer = WriterOptions::new().split(limits).create(&bag).unwrap();
    write_numbers(&mut writer, 303);
    writer.finish().unwrap();
    let metadata = Metadata::read(&bag.join(FILE_NAME)).unwrap();
    // rosbag2 splits when a message is later than the first of its file by more than the limit: 0 to 100 are
    // one file.
    let counts: Vec<_> = metadata.files.iter().map(|file| file.message_count).collect();
    assert_eq!(counts, [101, 101, 101]);
    assert_eq!(read(&bag), (0..303).collect::<Vec<_>>());
}

#[test]
fn a_bag_split_on_request_reports_the_closed_and_the_opened_file() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    let splits = Arc::new(Mutex::new(Vec::new()));
    let pushed = Arc::clone(&splits);
    writer.on_split(move |split: &FileSplit| pushed.lock().unwrap().push(split.clone()));
    write_numbers(&mut writer, 10);
    let split = writer.split().unwrap();
    let file = |number| bag.join(format!("bag_{number}.mcap"));
    assert_eq!(split, FileSplit { closed: file(0), opened: Some(file(1)) });
    assert!(fs::read(file(0)).unwrap().ends_with(mcap::MAGIC), "the first file is complete");
    assert_eq!(Metadata::read(&bag.join(FILE_NAME)).unwrap().files.len(), 2);
    writer.finish().unwrap();
    let last = FileSplit { closed: file(1), opened: None };
    assert_eq!(*splits.lock().unwrap(), [split, last]);
    assert_eq!(read(&bag), (0..10).collect::<Vec<_>>());
}

#[test]
fn every_file_has_the_topics_it_needs_even_if_added_in_an_earlier_file() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    write_numbers(&mut writer, 3);
    let other = writer.add_topic(topic("/other")).unwrap();
    writer.split().unwrap();
    writer.write(other, 5_000_000, 5_000_000, &number(7)).unwrap();
    writer.finish().unwrap();
    let reader = Reader::open(bag.join("bag_1.mcap")).unwrap();
    assert_eq!(messages(&reader).iter().map(value).collect::<Vec<_>>(), [7]);
    assert_eq!(reader.topics()[reader.topic("/other").unwrap().index()].info.definition, "int64 data\n");
}

fn keeping(most: usize) -> WriterOptions {
    WriterOptions::new().max_bag_files(NonZeroUsize::new(most).unwrap())
}

fn write_and_split(writer: &mut Writer, files: i64) {
    let id = writer.add_topic(topic("/numbers")).unwrap();
    for file in 0..files {
        for n in file * 10..file * 10 + 10 {
            writer.write(id, 1_000_000 * n, 1_000_000 * n, &number(n)).unwrap();
        }
        if file + 1 < files {
            writer.split().unwrap();
        }
    }
}

#[test]
fn the_oldest_file_is_deleted_when_there_would_be_too_many() {
    for (most, first) in [(3, 20), (1, 40)] {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        let mut writer = keeping(most).create(&bag).unwrap();
        write_and_split(&mut writer, 5);
        let summary = writer.finish().unwrap();
        assert_eq!(read(&bag), (first..50).collect::<Vec<_>>());
        let metadata = Metadata::read(&bag.join(FILE_NAME)).unwrap();
        assert_eq!(metadata.files.len(), most);
        assert_eq!(metadata.message_count as i64, 50 - first);
        assert_eq!(metadata.topics[0].message_count as i64, 50 - first);
        assert_eq!(metadata.starting_time, first * 1_000_000);
        assert_eq!(metadata.custom_data["deleted_messages"], first.to_string());
        assert_eq!((summary.files, summary.deleted as i64), (most, first));
        assert_eq!(fs::read_dir(&bag).unwrap().count(), most + 1, "the files and metadata.yaml");
    }
}

#[test]
fn file_sizes_below_rosbag2s_minimum_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let error = by_size(1023).create(&bag).err().unwrap();
    assert!(matches!(error, WriterError::SplitSize { bytes: 1023, least: 1024 }), "{error}");
    assert!(!bag.exists());
    // A message larger than the limit has its own file.
    let mut writer = by_size(1024).create(&bag).unwrap();
    let id = writer.add_topic(topic("/large")).unwrap();
    for time in 0..3 {
        writer.write(id, time, time, &[0; 5000]).unwrap();
    }
    assert_eq!(writer.finish().unwrap().files, 3);
}
