#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use parking_lot::{Condvar, Mutex};

use super::options::SnapshotLimits;
use super::queue::{Queue, QueuedTopic};
use super::{Progress, RecordError, Recording, RecordingOptions, RecordingSender, Shared, run, with_losses};
use downbeat_msgs::qos::{Durability, QosProfile};

use crate::metadata::Metadata;
use crate::reader::{Reader, Selection};
use crate::topic::TopicDescription;
use crate::writer::{Writer, WriterOptions};

fn topic(name: &str) -> TopicDescription {
    TopicDescription {
        name: name.to_owned(),
        type_name: "std_msgs/msg/Empty".to_owned(),
        ..TopicDescription::default()
    }
}

/// A [`Recording`] without its thread: nothing is written until the test runs it.
fn without_thread(writer: &Writer, queue_bytes: usize) -> RecordingSender {
    let topics = writer.topics().map(QueuedTopic::of);
    let queue = Queue::new(&RecordingOptions::new().cache_bytes(queue_bytes), topics.collect());
    let progress = Mutex::new(Progress::of(writer));
    let (path, has_ended, ended) = (writer.path().to_owned(), Mutex::new(false), Condvar::new());
    RecordingSender { shared: Arc::new(Shared { queue, progress, path, has_ended, ended }) }
}

#[test]
fn messages_refused_by_a_full_queue_are_counted_reported_and_noted_in_the_bag() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    let busy = writer.add_topic(topic("/busy")).unwrap();
    let sender = without_thread(&writer, 2000);
    let quiet = sender.add_topic(topic("/quiet")).unwrap();

    sender.record(busy, 1, 1, Bytes::from(vec![0; 1500])).unwrap();
    let error = sender.record(busy, 2, 2, Bytes::from(vec![0; 1500])).unwrap_err();
    assert_eq!(error, RecordError::QueueFull { topic: "/busy".to_owned(), lost: 1 });
    sender.record(busy, 3, 3, Bytes::from(vec![0; 1500])).unwrap_err();
    sender.record(quiet, 4, 4, Bytes::from_static(&[0; 4])).unwrap();
    sender.shared.queue.close();
    let summary = with_losses(&sender.shared, run(&sender.shared, writer)).unwrap();

    let counts: Vec<_> = summary.topics.iter().map(|t| (t.name.as_str(), t.written, t.lost)).collect();
    assert_eq!(counts, [("/busy", 1, 2), ("/quiet", 1, 0)]);
    let metadata = Metadata::read(&bag.join("metadata.yaml")).unwrap();
    assert_eq!(metadata.custom_data["lost_messages"], "/busy: 2");
}

#[test]
fn the_blocking_variant_waits_for_room_and_loses_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    let id = writer.add_topic(topic("/a")).unwrap();
    let recording = Recording::start(writer, 1000).unwrap();
    let producers: Vec<_> = (0..2_u8)
        .map(|producer| {
            let sender = recording.sender();
            std::thread::spawn(move || {
                for number in 0..500 {
                    sender.record_blocking(id, number, 0, Bytes::from(vec![producer; 100])).unwrap();
                }
            })
        })
        .collect();
    for producer in producers {
        producer.join().unwrap();
    }
    let summary = recording.finish().unwrap();
    assert_eq!((summary.message_count(), summary.lost_count()), (1000, 0));
    assert_eq!(Reader::open(&bag).unwrap().message_count(), 1000);
}

#[test]
fn a_message_larger_than_the_queue_is_accepted_alone() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = WriterOptions::new().create(folder.path().join("bag")).unwrap();
    let id = writer.add_topic(topic("/a")).unwrap();
    let recording = Recording::start(writer, 10).unwrap();
    recording.sender().record_blocking(id, 1, 1, Bytes::from(vec![0; 1000])).unwrap();
    assert_eq!(recording.finish().unwrap().message_count(), 1);
}

#[test]
fn topics_can_be_added_while_recording_and_messages_keep_their_order() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let recording =
        Recording::start(WriterOptions::new().create(&bag).unwrap(), Recording::DEFAULT_QUEUE_BYTES).unwrap();
    let sender = recording.sender();
    for number in 0..20 {
        let id = sender.add_topic(topic(&format!("/topic_{}", number % 5))).unwrap();
        sender.record(id, number, number, Bytes::copy_from_slice(&number.to_le_bytes())).unwrap();
    }
    recording.finish().unwrap();
    let reader = Reader::open(&bag).unwrap();
    let messages: Vec<_> = reader.messages(Selection::all()).unwrap().map(Result::unwrap).collect();
    let expected: Vec<(i64, String)> = (0..20).map(|n| (n, format!("/topic_{}", n % 5))).collect();
    let read: Vec<(i64, String)> =
        messages.iter().map(|m| (m.log_time, reader.topics()[m.topic.index()].info.name.clone())).collect();
    assert_eq!(read, expected);
}

#[test]
fn messages_after_the_end_are_refused_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = WriterOptions::new().create(folder.path().join("bag")).unwrap();
    let id = writer.add_topic(topic("/a")).unwrap();
    let recording = Recording::start(writer, 1000).unwrap();
    let sender = recording.sender();
    recording.finish().unwrap();
    assert_eq!(sender.record(id, 1, 1, Bytes::new()), Err(RecordError::Stopped));
    assert_eq!(sender.record_blocking(id, 1, 1, Bytes::new()), Err(RecordError::Stopped));
    assert_eq!(sender.shared.queue.lock().topics[0].lost, 2);
}

#[test]
fn a_time_before_the_epoch_is_refused_when_queued() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = WriterOptions::new().create(folder.path().join("bag")).unwrap();
    let id = writer.add_topic(topic("/a")).unwrap();
    let recording = Recording::start(writer, 1000).unwrap();
    let refused = recording.sender().record(id, 5, -5, Bytes::new());
    assert_eq!(refused, Err(RecordError::NegativeTime { time: -5 }));
    recording.finish().unwrap();
}

#[test]
fn a_triggered_snapshot_has_what_was_before_and_after_and_the_latched_messages() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    let id = writer.add_topic(topic("/a")).unwrap();
    let qos = QosProfile { durability: Durability::TransientLocal, ..QosProfile::DEFAULT };
    let map = TopicDescription { offered_qos: vec![qos.into()], ..topic("/map") };
    let map = writer.add_topic(map).unwrap();
    let limits = SnapshotLimits { max_bytes: 1 << 20, max_duration: Some(Duration::from_nanos(10)) };
    let options = RecordingOptions::new().snapshot(limits).repeat_latched();
    let recording = Recording::start_with(writer, &options).unwrap();
    let (sender, control) = (recording.sender(), recording.control());
    sender.record(map, 1, 0, Bytes::from_static(b"map")).unwrap();
    let record = |times: std::ops::Range<i64>| {
        times.for_each(|time| sender.record(id, time, time, Bytes::new()).unwrap());
    };
    record(2..101);
    assert!(control.snapshot_around(100, Duration::from_nanos(20)));
    record(101..150);
    // The second one is not complete when recording ends.
    assert!(control.snapshot_around(149, Duration::from_nanos(20)));
    record(150..152);
    recording.finish().unwrap();
    let reader = Reader::open(&bag).unwrap();
    let read: Vec<_> = reader.messages(Selection::all()).unwrap().map(Result::unwrap).collect();
    let of_map: Vec<_> =
        read.iter().filter(|m| m.topic == map).map(|m| (m.log_time, m.publish_time)).collect();
    assert_eq!(of_map, [(90, 0)]);
    let times: Vec<_> = read.iter().filter(|m| m.topic == id).map(|m| m.log_time).collect();
    assert_eq!(times, (90..=120).chain(139..152).collect::<Vec<_>>());
    assert!(!control.snapshot_around(200, Duration::ZERO), "recording has ended");
}
