//! Creating bags from bags, checking bags, and comparing two bags.

use std::fs;

use downbeat_bags::{
    BagInfo, Copy, DiffOptions, FieldRule, Problem, Reader, TopicSizes, WriterOptions, check, diff, reindex,
};
use downbeat_msgs::qos::QosProfile;

use crate::support::{fixture, messages, number, topic, value, write_numbers};

#[test]
fn bags_are_merged_by_time_and_filtered_by_topic() {
    let folder = tempfile::tempdir().unwrap();
    let mut bags = Vec::new();
    for (name, offset) in [("one", 0), ("two", 500)] {
        let mut writer = WriterOptions::new().create(folder.path().join(name)).unwrap();
        let shared = writer.add_topic(topic("/shared")).unwrap();
        let own = writer.add_topic(topic(&format!("/{name}"))).unwrap();
        for n in 0..50 {
            writer.write(shared, 1000 * n + offset, 7, &number(n + offset)).unwrap();
            writer.write(own, 1000 * n + offset, 7, &number(n)).unwrap();
        }
        writer.finish().unwrap();
        bags.push(Reader::open(folder.path().join(name)).unwrap());
    }
    let target = WriterOptions::new().create(folder.path().join("both")).unwrap();
    let mut progress = 0;
    let copy = Copy::of(&bags, |topic| topic.name != "/two").unwrap();
    assert_eq!(copy.message_count(), 150);
    let copied = copy.into_writer(target, |written| progress = written).unwrap();
    assert_eq!((copied.summary.message_count(), progress, copied.unreadable.len()), (150, 150, 0));
    let both = Reader::open(folder.path().join("both")).unwrap();
    let names: Vec<_> = both.topics().iter().map(|topic| topic.info.name.as_str()).collect();
    assert_eq!(names, ["/shared", "/one"]);
    let read = messages(&both);
    assert!(read.is_sorted_by_key(|message| message.log_time));
    let shared: Vec<i64> = read.iter().filter(|message| message.topic.index() == 0).map(value).collect();
    let expected: Vec<i64> = (0..50).flat_map(|n| [n, n + 500]).collect();
    assert_eq!(shared, expected);
    assert!(read.iter().all(|message| message.publish_time == 7));
}

#[test]
fn bags_with_different_types_of_a_topic_are_not_merged() {
    let folder = tempfile::tempdir().unwrap();
    let mut bags = Vec::new();
    for (name, type_name) in [("one", "std_msgs/msg/Int64"), ("two", "std_msgs/msg/Int32")] {
        let mut writer = WriterOptions::new().create(folder.path().join(name)).unwrap();
        let mut info = topic("/numbers");
        info.type_name = type_name.to_owned();
        writer.add_topic(info).unwrap();
        writer.finish().unwrap();
        bags.push(Reader::open(folder.path().join(name)).unwrap());
    }
    let error = Copy::of(&bags, |_| true).err().unwrap().to_string();
    assert!(error.starts_with("topic /numbers is of type std_msgs/msg/Int64 as cdr in one bag"), "{error}");
    assert!(Copy::of(&bags, |topic| topic.name != "/numbers").is_ok(), "an excluded topic cannot conflict");
}

#[test]
fn a_part_of_a_bag_starts_with_the_last_messages_of_latched_topics() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = WriterOptions::new().create(folder.path().join("whole")).unwrap();
    let numbers = writer.add_topic(topic("/numbers")).unwrap();
    let mut info = topic("/map");
    info.offered_qos = vec![QosProfile::LATCHED.keep_last(2).into()];
    let map = writer.add_topic(info).unwrap();
    for n in 0..100 {
        writer.write(numbers, 10 * n, 10 * n, &number(n)).unwrap();
        if n < 5 {
            writer.write(map, 10 * n + 1, 10 * n + 1, &number(n)).unwrap();
        }
    }
    writer.finish().unwrap();
    let bags = [Reader::open(folder.path().join("whole")).unwrap()];
    let cut = |name: &str, keeps_latched: bool| -> Vec<(usize, i64, i64)> {
        let mut copy = Copy::of(&bags, |_| true).unwrap().times(500, 520);
        if keeps_latched {
            copy = copy.keep_latched();
        }
        let target = WriterOptions::new().create(folder.path().join(name)).unwrap();
        copy.into_writer(target, |_| {}).unwrap();
        let read = messages(&Reader::open(folder.path().join(name)).unwrap());
        read.iter().map(|message| (message.topic.index(), message.log_time, value(message))).collect()
    };
    let part = [(0, 500, 50), (0, 510, 51), (0, 520, 52)];
    assert_eq!(cut("without", false), part);
    assert_eq!(cut("with", true), [&[(1, 500, 3), (1, 500, 4)], &part[..]].concat());
}

#[test]
fn the_readable_part_of_a_damaged_bag_becomes_a_complete_one() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("killed");
    let mut writer = WriterOptions::new().chunk_size(2000).create(&bag).unwrap();
    write_numbers(&mut writer, 500);
    writer.flush().unwrap();
    // Like after a kill: no summary, and an incomplete record at the end.
    std::mem::forget(writer);
    let file = bag.join("killed_0.mcap");
    let mut bytes = fs::read(&file).unwrap();
    // Truncates the last chunk, whose index is smaller than that.
    bytes.truncate(bytes.len() - 1000);
    fs::write(&file, bytes).unwrap();
    let bags = [Reader::open(&bag).unwrap()];
    let found = check(&bags[0], |_| {}).unwrap();
    assert!(matches!(found.problems[0], Problem::Truncated(_)), "{:?}", found.problems);
    let count = messages(&bags[0]).len();
    assert!(count > 300 && count < 500, "{count}");
    let target = WriterOptions::new().create(folder.path().join("repaired")).unwrap();
    Copy::of(&bags, |_| true).unwrap().into_writer(target, |_| {}).unwrap();
    let repaired = Reader::open(folder.path().join("repaired")).unwrap();
    assert_eq!(messages(&repaired), messages(&bags[0]));
    let found = check(&repaired, |_| {}).unwrap();
    assert_eq!((found.messages, found.decoded, found.problems), (count as u64, count as u64, Vec::new()));
}

#[test]
fn a_real_bag_passes_the_check_and_its_metadata_can_be_recreated() {
    for name in ["jazzy_mcap", "jazzy_mcap_zstd"] {
        let folder = tempfile::tempdir().unwrap();
        let file = format!("{name}_0.mcap");
        fs::copy(fixture(name).join(&file), folder.path().join(&file)).unwrap();
        let yaml = fs::read_to_string(fixture(name).join("metadata.yaml")).unwrap();
        fs::write(folder.path().join("metadata.yaml"), &yaml).unwrap();
        let found = check(&Reader::open(folder.path()).unwrap(), |_| {}).unwrap();
        assert_eq!(found.problems, [], "{name}");
        assert!(found.decoded > 300, "{name}: {found:?}");
        reindex(folder.path()).unwrap();
        assert_eq!(fs::read_to_string(folder.path().join("metadata.yaml")).unwrap(), yaml, "{name}");
        fs::remove_file(folder.path().join("metadata.yaml")).unwrap();
        let again = reindex(folder.path()).unwrap();
        let whole = Reader::open(fixture(name)).unwrap();
        assert_eq!(again.message_count, whole.message_count());
        assert_eq!(messages(&Reader::open(folder.path()).unwrap()), messages(&whole));
    }
}

#[test]
fn reindexing_a_split_bag_finds_its_files_in_their_order() {
    let folder = tempfile::tempdir().unwrap();
    for n in [10, 9, 2] {
        let part = folder.path().join(format!("part{n}"));
        let mut writer = WriterOptions::new().create(&part).unwrap();
        let id = writer.add_topic(topic("/numbers")).unwrap();
        writer.write(id, n, n, &number(n)).unwrap();
        writer.finish().unwrap();
        let bag = folder.path().join("bag");
        fs::create_dir_all(&bag).unwrap();
        fs::rename(part.join(format!("part{n}_0.mcap")), bag.join(format!("bag_{n}.mcap"))).unwrap();
    }
    let metadata = reindex(&folder.path().join("bag")).unwrap();
    assert_eq!(metadata.relative_file_paths, ["bag_2.mcap", "bag_9.mcap", "bag_10.mcap"]);
    assert_eq!((metadata.message_count, metadata.starting_time), (3, 2));
    assert_eq!(metadata.topics[0].message_count, 3);
}

#[test]
fn two_bags_are_equal_or_the_first_difference_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, count: i64, change: i64| {
        let mut writer = WriterOptions::new().create(folder.path().join(name)).unwrap();
        let id = writer.add_topic(topic("/numbers")).unwrap();
        for n in 0..count {
            let value = if n == 30 { n + change } else { n };
            writer.write(id, 1000 * n, 0, &number(value)).unwrap();
        }
        writer.finish().unwrap();
        Reader::open(folder.path().join(name)).unwrap()
    };
    let (one, same, other, short) =
        (write("one", 50, 0), write("same", 50, 0), write("other", 50, 2), write("short", 40, 0));
    let exact = DiffOptions::default();
    assert!(diff(&one, &same, &exact, |_| {}).unwrap().is_same());
    let found = diff(&one, &other, &exact, |_| {}).unwrap();
    let (topic, difference) = found.first_difference().unwrap();
    assert_eq!((topic.topic.as_str(), topic.different, topic.compared), ("/numbers", 1, 50));
    assert_eq!((difference.number, difference.time), (30, 30_000));
    assert!(format!("{:?}", difference.what).contains("path: \"data\", first: \"30\", second: \"32\""));
    let rules = vec![FieldRule::tolerance("numbers:data=2").unwrap()];
    assert!(diff(&one, &other, &DiffOptions { rules, ..exact.clone() }, |_| {}).unwrap().is_same());
    let found = diff(&one, &short, &exact, |_| {}).unwrap();
    assert!(!found.is_same() && found.first_difference().is_none());
    assert_eq!(found.topics[0].to_string(), "/numbers: 50 messages in the first bag, 40 in the second");
}

#[test]
fn verbose_info_lists_bytes_requests_and_responses() {
    let reader = Reader::open(fixture("jazzy_mcap")).unwrap();
    let mut info = BagInfo::of(&reader).unwrap();
    let sizes = TopicSizes::read(&reader, |_| {}).unwrap();
    let events = info.services[0].event_count;
    let calls = sizes.calls_of(&info.services[0].name);
    assert!(calls.requests > 0 && calls.responses > 0, "{calls:?} in {events} events");
    assert!(calls.requests + calls.responses <= events);
    let images = messages(&reader)
        .into_iter()
        .filter(|message| reader.topics()[message.topic.index()].info.name == "/reference/camera/image_raw");
    let expected: u64 = images.map(|image| image.data.len() as u64).sum();
    assert_eq!(sizes.bytes_of("/reference/camera/image_raw"), expected);
    info.sizes = Some(sizes);
    let text = info.to_string();
    assert!(text.contains(" | Request Count: ") && text.contains(" | Size Contribution: "), "{text}");
}
