//! Pausing, splitting, stopping, and taking snapshots of a recording.

use std::fs;
use std::path::Path;
use std::sync::mpsc;
use std::time::Duration;

use bytes::Bytes;
use downbeat_bags::metadata::{FILE_NAME, Metadata};
use downbeat_bags::{
    ControlError, Reader, RecordError, Recording, RecordingOptions, RecordingSender, SnapshotLimits, TopicId,
    WhenSlow, WriterError, WriterOptions,
};

use crate::support::{messages, number, topic, value};

const WATCHDOG: Duration = Duration::from_secs(60);

fn start(bag: &Path, options: RecordingOptions) -> (Recording, RecordingSender, TopicId) {
    let recording = Recording::start_with(WriterOptions::new().create(bag).unwrap(), &options).unwrap();
    let sender = recording.sender();
    let id = sender.add_topic(topic("/numbers")).unwrap();
    (recording, sender, id)
}

fn record(sender: &RecordingSender, id: TopicId, numbers: std::ops::Range<i64>) {
    for n in numbers {
        sender.record(id, n * 1_000_000, n * 1_000_000, Bytes::from(number(n))).unwrap();
    }
}

fn read(bag: &Path) -> Vec<i64> {
    messages(&Reader::open(bag).unwrap()).iter().map(value).collect()
}

/// Waits for the answer to a request.
fn answer<T: Send + 'static>(ask: impl FnOnce(Box<dyn FnOnce(T) + Send>)) -> T {
    let (sender, receiver) = mpsc::channel();
    ask(Box::new(move |result| sender.send(result).unwrap()));
    receiver.recv_timeout(WATCHDOG).unwrap()
}

#[test]
fn messages_while_paused_are_ignored_and_not_counted_as_lost() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let (recording, sender, id) = start(&bag, RecordingOptions::new().start_paused());
    let control = recording.control();
    assert!(control.is_paused() && recording.statistics().is_paused);
    record(&sender, id, 0..10);
    assert!(control.resume() && !control.resume());
    record(&sender, id, 10..20);
    assert!(control.toggle_paused());
    record(&sender, id, 20..30);
    assert!(!control.pause() && !control.toggle_paused());
    record(&sender, id, 30..40);
    let summary = recording.finish().unwrap();
    assert_eq!((summary.message_count(), summary.lost_count()), (20, 0));
    assert_eq!(read(&bag), (10..20).chain(30..40).collect::<Vec<_>>());
    assert!(!Metadata::read(&bag.join(FILE_NAME)).unwrap().custom_data.contains_key("lost_messages"));
}

#[test]
fn a_split_follows_earlier_messages() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let (recording, sender, id) = start(&bag, RecordingOptions::new());
    record(&sender, id, 0..100);
    let split = answer(|done| recording.control().split(done)).unwrap();
    assert_eq!(split.closed, bag.join("bag_0.mcap"));
    record(&sender, id, 100..150);
    recording.finish().unwrap();
    assert_eq!(read(&bag.join("bag_0.mcap")), (0..100).collect::<Vec<_>>());
    assert_eq!(read(&bag.join("bag_1.mcap")), (100..150).collect::<Vec<_>>());
}

#[test]
fn a_snapshot_holds_the_latest_messages_and_nothing_is_written_without_one() {
    let folder = tempfile::tempdir().unwrap();
    let by_time = SnapshotLimits { max_bytes: 1_000_000, max_duration: Some(Duration::from_millis(49)) };
    let bag = folder.path().join("by_time");
    let (recording, sender, id) = start(&bag, RecordingOptions::new().snapshot(by_time));
    record(&sender, id, 0..200);
    assert!(recording.statistics().queued_bytes > 0);
    answer(|done| recording.control().snapshot(done)).unwrap();
    assert_eq!(read(&bag), (150..200).collect::<Vec<_>>(), "written before completion is reported");
    record(&sender, id, 200..300);
    assert_eq!(recording.finish().unwrap().lost_count(), 0);
    assert_eq!(read(&bag), (150..200).collect::<Vec<_>>(), "no second snapshot was requested");

    let by_size = SnapshotLimits { max_bytes: 10_000, max_duration: None };
    let bag = folder.path().join("by_size");
    let (recording, sender, id) = start(&bag, RecordingOptions::new().snapshot(by_size));
    record(&sender, id, 0..1000);
    let too_large = sender.record(id, 1, 1, Bytes::from(vec![0; 20_000])).unwrap_err();
    assert!(matches!(too_large, RecordError::QueueFull { lost: 1, .. }), "{too_large}");
    answer(|done| recording.control().snapshot(done)).unwrap();
    record(&sender, id, 1000..1010);
    answer(|done| recording.control().snapshot(done)).unwrap();
    recording.finish().unwrap();
    let found = read(&bag);
    assert!(found.len() > 50 && found.len() < 300, "{}", found.len());
    assert_eq!(found, (1010 - found.len() as i64..1010).collect::<Vec<_>>());
}

#[test]
fn impossible_requests_are_completed_with_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let (recording, ..) = start(&folder.path().join("bag"), RecordingOptions::new());
    let control = recording.control();
    assert_eq!(answer(|done| control.snapshot(done)), Err(ControlError::NoSnapshots));
    control.stop();
    assert!(control.is_stopped());
    assert_eq!(answer(|done| control.split(done)), Err(ControlError::Ended));
    recording.finish().unwrap();
    assert_eq!(answer(|done| control.flush(done)), Err(ControlError::Ended));
}

#[test]
fn a_recording_without_gaps_stops_when_it_cannot_keep_up() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let options = RecordingOptions::new().cache_bytes(1).when_slow(WhenSlow::Stop);
    let (recording, sender, id) = start(&bag, options);
    let mut kept = 0;
    // The writing thread is sometimes fast enough for a cache of one message.
    while sender.record(id, kept, kept, Bytes::from(number(kept))).is_ok() {
        kept += 1;
    }
    let failed = recording.finish().unwrap_err();
    assert!(matches!(failed.error, WriterError::TooSlow { cache_bytes: 1, .. }), "{failed}");
    assert_eq!((failed.summary.message_count() as i64, failed.summary.lost_count()), (kept, 1));
    assert_eq!(read(&bag), (0..kept).collect::<Vec<_>>(), "no gap");
    let metadata = Metadata::read(&bag.join(FILE_NAME)).unwrap();
    assert_eq!(metadata.custom_data["lost_messages"], "/numbers: 1");
}

#[test]
fn losses_are_in_metadata_yaml_during_recording() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let (recording, sender, id) = start(&bag, RecordingOptions::new().cache_bytes(1));
    let mut n = 0;
    while sender.record(id, n, n, Bytes::from(number(n))).is_ok() {
        n += 1;
    }
    // metadata.yaml is updated with the next new topic at the latest.
    let mut text = String::new();
    for number in 0..1000 {
        sender.add_topic(topic(&format!("/later_{number}"))).unwrap();
        answer(|done| recording.control().flush(done)).unwrap();
        text = fs::read_to_string(bag.join(FILE_NAME)).unwrap();
        if text.contains("lost_messages: \"/numbers: 1\"") {
            break;
        }
    }
    assert!(text.contains("lost_messages: \"/numbers: 1\""), "{text}");
    recording.finish().unwrap();
}
