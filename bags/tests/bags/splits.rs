//! Bags of several files.

use std::fs;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use downbeat_bags::metadata::{FILE_NAME, Metadata};
use downbeat_bags::{
    FileSplit, Problem, Reader, Selection, SplitLimits, TopicDescription, TopicId, Writer, WriterError,
    WriterOptions, check,
};
use downbeat_msgs::qos::{Durability, History, QosProfile};

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

/// A topic whose late subscribers receive that many messages.
fn latched(name: &str, depth: u32) -> TopicDescription {
    let qos = QosProfile {
        history: History::KeepLast(depth),
        durability: Durability::TransientLocal,
        ..QosProfile::DEFAULT
    };
    TopicDescription { offered_qos: vec![qos.into()], ..topic(name) }
}

/// The topics, times and numbers of all messages.
fn all(reader: &Reader, selection: Selection) -> Vec<(String, i64, i64, i64)> {
    let messages = reader.messages(selection).unwrap().map(Result::unwrap);
    let name = |id: TopicId| reader.topics()[id.index()].info.name.clone();
    messages.map(|m| (name(m.topic), m.log_time, m.publish_time, value(&m))).collect()
}

#[test]
fn each_further_file_begins_with_latched_messages_that_the_whole_bag_has_once() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().repeat_latched().create(&bag).unwrap();
    let [map, modes, numbers] = [latched("/map", 1), latched("/modes", 2), topic("/numbers")]
        .map(|info| writer.add_topic(info).unwrap());
    writer.write(map, 100, 90, &number(1)).unwrap();
    for n in 0..3 {
        writer.write(modes, 110 + n, 109 + n, &number(10 + n)).unwrap();
    }
    writer.write(numbers, 200, 200, &number(5)).unwrap();
    writer.split().unwrap();
    writer.write(map, 300, 290, &number(2)).unwrap();
    writer.split().unwrap();
    writer.write(numbers, 400, 400, &number(6)).unwrap();
    writer.finish().unwrap();

    let own = |name: &str, log, publish, value| (name.to_owned(), log, publish, value);
    let first = [
        own("/map", 100, 90, 1),
        own("/modes", 110, 109, 10),
        own("/modes", 111, 110, 11),
        own("/modes", 112, 111, 12),
        own("/numbers", 200, 200, 5),
    ];
    let reader = Reader::open(&bag).unwrap();
    let whole = [&first[..], &[own("/map", 300, 290, 2), own("/numbers", 400, 400, 6)]].concat();
    assert_eq!(all(&reader, Selection::all()), whole);
    assert_eq!(reader.message_count(), 7 + 6);
    assert_eq!(all(&reader, Selection::all().with_repeated()).len(), 7 + 6);
    let custom_data = &reader.metadata().unwrap().custom_data;
    assert_eq!(custom_data["repeated_messages"], "/map: 2, /modes: 4");
    let found = check(&reader, |_| {}).unwrap();
    let counts: Vec<_> =
        found.problems.iter().filter(|found| matches!(found, Problem::Count { .. })).collect();
    assert!(counts.is_empty(), "{counts:?}");

    // Alone, the last file holds what a subscriber that joins at its beginning receives.
    let last = Reader::open(bag.join("bag_2.mcap")).unwrap();
    let expected = [
        own("/map", 300, 290, 2),
        own("/modes", 300, 110, 11),
        own("/modes", 300, 111, 12),
        own("/numbers", 400, 400, 6),
    ];
    assert_eq!(all(&last, Selection::all()), expected);
    // Without an earlier file, or with a damaged one, the copies are the messages.
    let damaged = bag.join("bag_0.mcap");
    let bytes = fs::read(&damaged).unwrap();
    fs::write(&damaged, &bytes[..40]).unwrap();
    let rest = Reader::open(&bag).unwrap();
    let rest: Vec<_> =
        rest.messages(Selection::all()).unwrap().filter_map(Result::ok).map(|m| value(&m)).collect();
    assert!([1, 11, 12, 2, 6].iter().all(|value| rest.contains(value)), "{rest:?}");
}

#[test]
fn files_have_messages_of_their_own_however_large_the_repeated_ones_are() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = by_size(100_000).repeat_latched().create(&bag).unwrap();
    let map = writer.add_topic(latched("/map", 3)).unwrap();
    let numbers = writer.add_topic(topic("/numbers")).unwrap();
    let mut data = number(-1);
    data.resize(40_000, 0);
    for _ in 0..3 {
        writer.write(map, 0, 0, &data).unwrap();
    }
    for n in 0..10_000 {
        writer.write(numbers, n, n, &number(n)).unwrap();
    }
    writer.finish().unwrap();
    let metadata = Metadata::read(&bag.join(FILE_NAME)).unwrap();
    assert!((3..20).contains(&metadata.files.len()), "{}", metadata.files.len());
    assert_eq!(
        metadata.message_count as usize,
        10_003 + metadata.files.len() - 1,
        "one map in each further file"
    );
    assert_eq!(messages(&Reader::open(&bag).unwrap()).len(), 10_003);
}
