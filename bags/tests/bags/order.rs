//! Order, selection and splits.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use downbeat_bags::{
    Compression, Playback, PlaybackOptions, PlayerError, Reader, Selection, Step, WriterOptions,
};

use crate::support::{messages, number, topic, value, write_numbers};

#[test]
fn messages_are_sorted_by_log_time_and_equal_times_by_file_order() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().chunk_size(200).create(&bag).unwrap();
    let id = writer.add_topic(topic("/a")).unwrap();
    // Every chunk of five overlaps with its neighbours.
    let times: Vec<i64> = (0..100).map(|n| (n * 37) % 50).collect();
    for (n, time) in times.iter().enumerate() {
        writer.write(id, *time, *time, &number(n as i64)).unwrap();
    }
    writer.finish().unwrap();
    let mut expected: Vec<(i64, i64)> = times.iter().enumerate().map(|(n, time)| (*time, n as i64)).collect();
    expected.sort();
    let reader = Reader::open(&bag).unwrap();
    let read: Vec<(i64, i64)> = messages(&reader).iter().map(|m| (m.log_time, value(m))).collect();
    assert_eq!(read, expected);
}

#[test]
fn the_files_of_a_split_bag_are_read_as_one_in_the_order_of_their_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let split = folder.path().join("split");
    fs::create_dir(&split).unwrap();
    for part in 0..11 {
        let bag = folder.path().join(format!("part{part}"));
        let mut writer = WriterOptions::new().create(&bag).unwrap();
        let id = writer.add_topic(topic("/a")).unwrap();
        // All at the same time: only the order of the files decides which is first.
        writer.write(id, 7, 7, &number(part)).unwrap();
        writer.finish().unwrap();
        let file = format!("part{part}_0.mcap");
        fs::copy(bag.join(file), split.join(format!("split_{part}.mcap"))).unwrap();
    }
    let reader = Reader::open(&split).unwrap();
    let read: Vec<i64> = messages(&reader).iter().map(value).collect();
    assert_eq!(read, (0..11).collect::<Vec<_>>());
    assert_eq!((reader.topics().len(), reader.message_count()), (1, 11));
}

#[test]
fn chunks_without_messages_of_the_selected_topics_are_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    let ids = [writer.add_topic(topic("/often")).unwrap(), writer.add_topic(topic("/seldom")).unwrap()];
    for (id, time) in [(ids[0], 1), (ids[1], 2), (ids[0], 3)] {
        writer.write(id, time, time, &number(time)).unwrap();
        writer.flush().unwrap();
    }
    writer.finish().unwrap();
    let file = bag.join("bag_0.mcap");
    let mut bytes = fs::read(&file).unwrap();
    // Within the data of the first and the last message, which invalidates the checksums of their chunks.
    for value in [1, 3] {
        let at = bytes.windows(12).position(|bytes| bytes == number(value)).unwrap();
        bytes[at + 6] ^= 1;
    }
    fs::write(&file, bytes).unwrap();
    let reader = Reader::open(&bag).unwrap();
    let read = |topic| reader.messages(Selection::all().topics([topic])).unwrap().collect::<Vec<_>>();
    let seldom: Vec<i64> = read(ids[1]).iter().map(|message| value(message.as_ref().unwrap())).collect();
    assert_eq!(seldom, [2]);
    assert_eq!(read(ids[0]).iter().filter(|message| message.is_err()).count(), 2);
}

#[test]
fn a_selection_returns_only_its_topics_from_its_time() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer =
        WriterOptions::new().compression(Compression::Zstd).chunk_size(300).create(&bag).unwrap();
    let ids = [writer.add_topic(topic("/a")).unwrap(), writer.add_topic(topic("/b")).unwrap()];
    for n in 0..100 {
        writer.write(ids[n as usize % 2], n, n, &number(n)).unwrap();
    }
    writer.finish().unwrap();
    let reader = Reader::open(&bag).unwrap();
    let selection = Selection::all().topics(reader.topic("/b")).from(90);
    let read: Vec<i64> = reader.messages(selection).unwrap().map(|m| value(&m.unwrap())).collect();
    assert_eq!(read, [91, 93, 95, 97, 99]);
}

#[test]
fn a_file_without_chunks_as_of_the_preset_fastwrite_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fastwrite_0.mcap");
    write_without_chunks(&path, 5000);
    let reader = Reader::open(&path).unwrap();
    assert_eq!(reader.truncation().count(), 0);
    assert_eq!(reader.message_count(), 5000);
    let read: Vec<i64> = messages(&reader).iter().map(value).collect();
    assert_eq!(read, (0..5000).collect::<Vec<_>>());
}

fn write_without_chunks(path: &Path, count: i64) {
    let mut writer = mcap::WriteOptions::new()
        .use_chunks(false)
        .profile("ros2")
        .create(std::io::BufWriter::new(fs::File::create(path).unwrap()))
        .unwrap();
    let schema = writer.add_schema("std_msgs/msg/Int64", "ros2msg", b"int64 data\n").unwrap();
    let channel = writer.add_channel(schema, "/numbers", "cdr", &BTreeMap::new()).unwrap();
    for n in 0..count {
        let time = n as u64;
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: 0,
            log_time: time,
            publish_time: time,
        };
        writer.write_to_known_channel(&header, &number(n)).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn an_empty_bag_is_a_bag() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    writer.add_topic(topic("/silent")).unwrap();
    writer.finish().unwrap();
    let reader = Reader::open(&bag).unwrap();
    assert_eq!((reader.message_count(), reader.start_time(), reader.topics().len()), (0, None, 1));
    assert!(messages(&reader).is_empty());
    assert_eq!(reader.truncation().count(), 0);
}

#[test]
fn playback_starts_at_its_offset_with_the_chosen_topics() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    write_numbers(&mut writer, 10);
    let other = writer.add_topic(topic("/other")).unwrap();
    writer.write(other, 6_000_000, 6_000_000, &number(-1)).unwrap();
    writer.finish().unwrap();
    let reader = Reader::open(&bag).unwrap();

    let options = PlaybackOptions {
        start_offset: std::time::Duration::from_millis(5),
        topics: Some(vec!["/numbers".to_owned()]),
        ..PlaybackOptions::default()
    };
    let mut playback = Playback::open(&reader, &options).unwrap();
    // The clock jumps to the time requested by the pacer.
    let mut now = std::time::Duration::from_secs(77);
    let mut played = Vec::new();
    loop {
        match playback.step(now) {
            Step::Due(message) => played.push((value(&message), now.as_millis() - 77_000)),
            Step::Wait(wait) => now += wait,
            Step::Finished => break,
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(played, [(5, 0), (6, 1), (7, 2), (8, 3), (9, 4)]);

    let late = PlaybackOptions { start_offset: std::time::Duration::from_millis(10), ..options.clone() };
    let error = Playback::open(&reader, &late).err().unwrap();
    assert_eq!(error.to_string(), "cannot start 10ms into the bag: it is 9ms long");
    let wrong = PlaybackOptions { topics: Some(vec!["/nubmers".to_owned()]), ..options };
    let error = Playback::open(&reader, &wrong).err().unwrap();
    assert!(matches!(error, PlayerError::UnknownTopic { .. }), "{error}");
    assert_eq!(error.to_string(), "cannot play topic /nubmers: the bag has /numbers, /other");
}

/// Numbers in their place would be written to new bags.
#[test]
fn times_that_ros_2_cannot_represent_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("late.mcap");
    let mut writer = mcap::Writer::new(std::fs::File::create(&file).unwrap()).unwrap();
    let schema = writer.add_schema("std_msgs/msg/Int64", "ros2msg", b"int64 data\n").unwrap();
    let channel = writer.add_channel(schema, "/n", "cdr", &std::collections::BTreeMap::new()).unwrap();
    for (sequence, times) in (0..).zip([(5, 5), (6, u64::MAX), (u64::MAX - 1, 7), (8, 8)]) {
        let (log_time, publish_time) = times;
        let header = mcap::records::MessageHeader { channel_id: channel, sequence, log_time, publish_time };
        writer.write_to_known_channel(&header, &[0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0]).unwrap();
    }
    writer.finish().unwrap();
    let reader = downbeat_bags::Reader::open(&file).unwrap();
    let (mut times, mut refused) = (Vec::new(), Vec::new());
    for message in reader.messages(downbeat_bags::Selection::all()).unwrap() {
        match message {
            Ok(message) => times.push((message.log_time, message.publish_time)),
            Err(error) => refused.push(error.to_string()),
        }
    }
    assert_eq!(times, [(5, 5), (8, 8)]);
    assert!(refused.len() == 1 && refused[0].contains("after the year 2262"), "{refused:?}");
    assert!(refused[0].contains("18446744073709551615"), "{refused:?}");
    assert!(!downbeat_bags::check(&reader, |_| ()).unwrap().problems.is_empty());
}
