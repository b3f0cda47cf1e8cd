//! Files that no recorder writes, but that are readable.

use std::fs;

use downbeat_bags::{Reader, Selection, TopicDescription, WriterOptions, check};
use mcap::records::op;

use crate::parts::{Chunk, Content, Part, Parts, add, text};

fn channel(id: u16, topic: &str) -> Part {
    let ids = [id.to_le_bytes(), 0_u16.to_le_bytes()].concat();
    Part::Record(op::CHANNEL, [ids, text(topic), text("cdr"), vec![0; 4]].concat())
}

fn message(channel: u16, time: u64) -> Vec<u8> {
    let header = [&channel.to_le_bytes()[..], &[0; 4], &time.to_le_bytes(), &time.to_le_bytes()].concat();
    [header, vec![0, 1, 0, 0, 7]].concat()
}

/// A chunk of messages at those times, which declares others.
fn chunk(times: &[u64], declared: (u64, u64)) -> Part {
    let mut content = Vec::new();
    times.iter().for_each(|time| add(&mut content, op::MESSAGE, &message(1, *time)));
    Part::Chunk(Chunk::new("", declared, Content::Plain(content)))
}

fn file_of(data: Vec<Part>) -> Vec<u8> {
    Parts { data, summary: Vec::new(), has_summary: false }.to_file()
}

/// The times of all messages, and what was said.
fn read(file: Vec<u8>) -> (Vec<i64>, Vec<String>) {
    let reader = Reader::from_bytes("odd.mcap", file).unwrap();
    let messages = reader.messages(Selection::all()).unwrap();
    let times = messages.filter_map(Result::ok).map(|message| message.log_time).collect();
    let found = check(&reader, |_| {}).unwrap();
    // The topics have no definition.
    let said =
        found.problems.iter().map(ToString::to_string).filter(|said| !said.contains("no definition of"));
    (times, said.collect())
}

#[test]
fn chunks_without_messages_between_others_are_no_problem() {
    let empty = || chunk(&[], (0, 0));
    let (times, said) = read(file_of(vec![
        empty(),
        channel(1, "/a"),
        chunk(&[1, 2], (1, 2)),
        empty(),
        chunk(&[3], (3, 3)),
        empty(),
    ]));
    assert_eq!((times, said), (vec![1, 2, 3], vec![]));
}

#[test]
fn times_that_go_back_are_sorted() {
    let (times, said) = read(file_of(vec![
        channel(1, "/a"),
        chunk(&[50, 60, 40], (40, 60)),
        chunk(&[9, 55], (9, 55)),
        chunk(&[0], (0, 0)),
    ]));
    assert_eq!((times, said), (vec![0, 9, 40, 50, 55, 60], vec![]));
}

#[test]
fn messages_outside_of_the_times_that_their_chunk_declares_are_read() {
    for declared in [(1, 2), (0, 0), (9, 3), (u64::MAX, u64::MAX)] {
        let (times, _) = read(file_of(vec![
            channel(1, "/a"),
            chunk(&[100, 200, 300], declared),
            chunk(&[150], (150, 150)),
        ]));
        assert_eq!(times, [100, 150, 200, 300], "{declared:?}");
    }
}

#[test]
fn records_with_huge_lengths_are_skipped_and_what_follows_is_read() {
    for opcode in [op::ATTACHMENT, op::METADATA, op::SCHEMA, op::MESSAGE_INDEX, 0x80, 0] {
        for length in [1_u64 << 60, u64::MAX, 1 << 40, u64::MAX - 8] {
            let whole = file_of(vec![channel(1, "/a"), chunk(&[1, 2], (1, 2))]);
            let behind = file_of(vec![chunk(&[3, 4], (3, 4)), chunk(&[5], (5, 5))]);
            let end = whole.len() - (9 + 4) - (9 + 20) - 8;
            let mut file = whole[..end].to_vec();
            file.push(opcode);
            file.extend(length.to_le_bytes());
            file.extend(&behind[8..]);
            let (times, said) = read(file);
            assert_eq!(times, [1, 2, 3, 4, 5], "opcode {opcode}, length {length}");
            assert!(said.iter().any(|said| said.contains("are no record")), "{said:?}");
        }
    }
}

#[test]
fn files_of_a_split_may_use_the_same_channels_for_different_topics() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("split");
    fs::create_dir(&bag).unwrap();
    let topics =
        [("/a", "std_msgs/msg/Int64", "int64 data\n", 8), ("/b", "std_msgs/msg/Int8", "int8 data\n", 1)];
    for (number, (name, type_name, definition, width)) in topics.into_iter().enumerate() {
        let part = folder.path().join(format!("part_{number}"));
        let mut writer = WriterOptions::new().create(&part).unwrap();
        let topic = TopicDescription {
            name: name.to_owned(),
            type_name: type_name.to_owned(),
            definition: definition.to_owned(),
            ..TopicDescription::default()
        };
        let id = writer.add_topic(topic).unwrap();
        let data = [&[0, 1, 0, 0][..], &vec![0; width]].concat();
        writer.write(id, number as i64, 0, &data).unwrap();
        writer.finish().unwrap();
        let name = format!("part_{number}_0.mcap");
        fs::copy(part.join(&name), bag.join(format!("split_{number}.mcap"))).unwrap();
    }
    let reader = Reader::open(&bag).unwrap();
    let messages = reader.messages(Selection::all()).unwrap().map(Result::unwrap);
    let read: Vec<_> = messages
        .map(|message| (reader.topics()[message.topic.index()].info.name.clone(), message.data.len()))
        .collect();
    assert_eq!(read, [("/a".to_owned(), 12), ("/b".to_owned(), 5)]);
    let found = check(&reader, |_| {}).unwrap();
    assert_eq!(found.decoded, 2, "{:?}", found.problems);
}

#[test]
fn a_message_of_a_channel_without_description_is_reported() {
    let mut content = Vec::new();
    add(&mut content, op::MESSAGE, &message(1, 1));
    add(&mut content, op::MESSAGE, &message(2, 2));
    let (times, said) =
        read(file_of(vec![channel(1, "/a"), Part::Chunk(Chunk::new("", (1, 2), Content::Plain(content)))]));
    assert_eq!(times, [1]);
    assert!(said.iter().any(|said| said.contains("channel 2, which has no description")), "{said:?}");
}
