//! Full disks: a small in-memory file system, if the test may mount one.

use std::fs;
use std::path::Path;

use bytes::Bytes;
use downbeat_bags::metadata::{FILE_NAME, Metadata};
use downbeat_bags::{
    Reader, Recording, SplitLimits, TruncationCause, WhenDiskFull, WhenLow, WriterError, WriterOptions,
};
use test_machine::SmallDisk;

use crate::support::{messages, number, topic};

fn read(bag: &Path) -> Vec<i64> {
    let value = |data: &[u8]| i64::from_le_bytes(data[4..12].try_into().unwrap());
    messages(&Reader::open(bag).unwrap()).iter().map(|message| value(&message.data)).collect()
}

/// A message of 1 KiB that starts like a number.
fn large(n: i64) -> Bytes {
    let mut data = number(n);
    data.resize(1024, 0);
    data.into()
}

#[test]
fn recording_stops_on_a_full_disk_and_everything_before_is_kept() {
    let Some(disk) = SmallDisk::mount(300) else { return };
    let bag = disk.path.join("bag");
    let recording =
        Recording::start(WriterOptions::new().chunk_size(10_000).create(&bag).unwrap(), 100_000).unwrap();
    let sender = recording.sender();
    let id = sender.add_topic(topic("/numbers")).unwrap();
    let mut offered = 0;
    while sender.record_blocking(id, offered, offered, large(offered)).is_ok() {
        offered += 1;
    }
    // The robot continues: further messages are refused at once, and counted.
    for _ in 0..100 {
        offered += 1;
        assert!(sender.record(id, offered, offered, large(offered)).is_err());
    }
    let start = std::time::Instant::now();
    let failure = loop {
        if let Some(failure) = sender.statistics().failure {
            break failure;
        }
        assert!(start.elapsed() < std::time::Duration::from_secs(60), "the failure is not reported");
        std::thread::yield_now();
    };
    assert!(failure.contains("recording has stopped"), "{failure}");
    let failed = recording.finish().unwrap_err();
    assert!(matches!(failed.error, WriterError::Write { .. }), "{failed}");
    let kept = failed.summary.message_count() as i64;
    assert!(kept > 200, "{kept}");
    assert_eq!(kept + failed.summary.lost_count() as i64, offered + 1, "written or counted");
    assert_eq!(read(&bag), (0..kept).collect::<Vec<_>>());
    assert_eq!(Reader::open(&bag).unwrap().truncation().count(), 0, "the file was finished");
    assert_eq!(Metadata::read(&bag.join(FILE_NAME)).unwrap().message_count as i64, kept);
}

#[test]
fn recording_that_drops_continues_when_there_is_room_again() {
    let Some(disk) = SmallDisk::mount(300) else { return };
    let (bag, ballast) = (disk.path.join("bag"), disk.path.join("ballast"));
    fs::write(&ballast, vec![0; 200_000]).unwrap();
    let options = WriterOptions::new().chunk_size(10_000).when_disk_full(WhenDiskFull::Drop);
    let mut writer = options.create(&bag).unwrap();
    let id = writer.add_topic(topic("/numbers")).unwrap();
    let mut next = 0;
    let mut write = |writer: &mut downbeat_bags::Writer, count: i64| {
        for n in next..next + count {
            writer.write(id, n, n, &large(n)).unwrap();
        }
        next += count;
    };
    write(&mut writer, 200);
    assert!(writer.is_disk_full());
    let (kept, lost) = (writer.summary().message_count() as i64, writer.summary().lost_count() as i64);
    assert!(kept > 30 && lost > 50, "{kept} {lost}");
    fs::remove_file(&ballast).unwrap();
    write(&mut writer, 100);
    assert!(!writer.is_disk_full());
    let summary = writer.finish().unwrap();
    assert_eq!(summary.message_count() + summary.lost_count(), 300, "written or counted");

    let found = read(&bag);
    assert_eq!(found.len() as u64, summary.message_count());
    assert!(found.iter().take(kept as usize).copied().eq(0..kept), "nothing before is lost");
    assert_eq!(found.last(), Some(&299));
    let metadata = Metadata::read(&bag.join(FILE_NAME)).unwrap();
    assert_eq!(metadata.custom_data["lost_messages"], format!("/numbers: {}", summary.lost_count()));
}

#[test]
fn a_bag_that_deletes_its_oldest_files_records_on_a_disk_of_any_size() {
    let Some(disk) = SmallDisk::mount(300) else { return };
    let bag = disk.path.join("bag");
    let limits = SplitLimits { max_bytes: Some(50_000), ..SplitLimits::NONE };
    let options = WriterOptions::new().chunk_size(10_000).split(limits);
    assert_keeps_the_newest(&bag, options);
}

/// Records more than fits on the disk, into at most three files.
fn assert_keeps_the_newest(bag: &Path, options: WriterOptions) {
    let options = options.max_bag_files(std::num::NonZeroUsize::new(3).unwrap());
    let mut writer = options.create(bag).unwrap();
    let id = writer.add_topic(topic("/numbers")).unwrap();
    for n in 0..3000 {
        writer.write(id, n, n, &large(n)).unwrap();
    }
    let summary = writer.finish().unwrap();
    assert_eq!(summary.message_count() + summary.deleted, 3000);
    assert_eq!(read(bag), (summary.deleted as i64..3000).collect::<Vec<_>>());
}

#[test]
fn a_recording_killed_on_a_full_disk_is_readable() {
    let Some(disk) = SmallDisk::mount(300) else { return };
    let bag = disk.path.join("bag");
    let mut writer =
        WriterOptions::new().chunk_size(10_000).when_disk_full(WhenDiskFull::Drop).create(&bag).unwrap();
    let id = writer.add_topic(topic("/numbers")).unwrap();
    for n in 0..400 {
        writer.write(id, n, n, &large(n)).unwrap();
    }
    let kept = writer.summary().message_count() as i64;
    // Like a kill: nothing is finished.
    std::mem::forget(writer);
    assert_eq!(read(&bag), (0..kept).collect::<Vec<_>>());
    let causes: Vec<_> = Reader::open(&bag).unwrap().truncation().map(|t| t.cause.clone()).collect();
    assert_eq!(causes, [TruncationCause::NoEnd]);
}

#[cfg(feature = "sqlite")]
#[test]
fn a_recording_in_sqlite_stops_on_a_full_disk_and_everything_before_is_kept() {
    for preset in [downbeat_bags::SqlitePreset::None, downbeat_bags::SqlitePreset::Resilient] {
        let Some(disk) = SmallDisk::mount(600) else { return };
        let bag = disk.path.join("bag");
        let options = WriterOptions::new().storage(preset.options()).chunk_size(10_000);
        let mut writer = options.create(&bag).unwrap();
        let id = writer.add_topic(topic("/numbers")).unwrap();
        let mut next = 0;
        let error = loop {
            match writer.write(id, next, next, &large(next)) {
                Ok(()) => next += 1,
                Err(error) => break error,
            }
        };
        let WriterError::Write { kept, source, .. } = &error else { panic!("{error}") };
        assert_eq!(source.kind(), std::io::ErrorKind::StorageFull, "{error}");
        let summary = writer.finish().unwrap();
        assert_eq!(summary.message_count(), *kept);
        assert_eq!(summary.message_count() + summary.lost_count(), next as u64 + 1, "written or counted");
        // A log contains some pages several times.
        assert!(*kept > 100, "{preset:?}: {kept}");
        assert_eq!(read(&bag), (0..*kept as i64).collect::<Vec<_>>(), "{preset:?}");
        assert_eq!(Metadata::read(&bag.join(FILE_NAME)).unwrap().message_count, *kept);
    }
}

#[cfg(feature = "sqlite")]
#[test]
fn a_recording_in_sqlite_that_drops_continues_when_there_is_room_again() {
    let Some(disk) = SmallDisk::mount(1500) else { return };
    let (bag, ballast) = (disk.path.join("bag"), disk.path.join("ballast"));
    fs::write(&ballast, vec![0; 1_200_000]).unwrap();
    let options = WriterOptions::new().storage(downbeat_bags::SqliteOptions::default());
    let options = options.chunk_size(10_000).when_disk_full(WhenDiskFull::Drop);
    let mut writer = options.create(&bag).unwrap();
    let id = writer.add_topic(topic("/numbers")).unwrap();
    for n in 0..300 {
        if n == 200 {
            assert!(writer.is_disk_full());
            fs::remove_file(&ballast).unwrap();
        }
        writer.write(id, n, n, &large(n)).unwrap();
    }
    assert!(!writer.is_disk_full());
    let summary = writer.finish().unwrap();
    assert_eq!(summary.message_count() + summary.lost_count(), 300, "written or counted");
    assert!(summary.lost_count() > 20, "{}", summary.lost_count());
    let found = read(&bag);
    assert_eq!((found.len() as u64, found.last()), (summary.message_count(), Some(&299)));
    assert_eq!(Reader::open(&bag).unwrap().truncation().count(), 0, "the file was finished");
}

#[cfg(feature = "sqlite")]
#[test]
fn a_bag_in_sqlite_that_deletes_its_oldest_files_records_on_a_disk_of_any_size() {
    let Some(disk) = SmallDisk::mount(1000) else { return };
    let bag = disk.path.join("bag");
    let limits = SplitLimits { max_bytes: Some(100_000), ..SplitLimits::NONE };
    let options = WriterOptions::new().storage(downbeat_bags::SqliteOptions::default());
    let options = options.chunk_size(10_000).split(limits);
    assert_keeps_the_newest(&bag, options);
}

/// Writes messages until an error, at most `most`; returns their number and the error.
fn write_until_error(options: WriterOptions, bag: &Path, most: i64) -> (i64, Option<WriterError>) {
    let mut writer = options.chunk_size(10_000).create(bag).unwrap();
    let id = writer.add_topic(topic("/numbers")).unwrap();
    for n in 0..most {
        if let Err(error) = writer.write(id, n, n, &large(n)) {
            // The message belongs to a chunk that was written before the check.
            return (n + 1, Some(error));
        }
    }
    writer.finish().unwrap();
    (most, None)
}

fn free(disk: &SmallDisk) -> u64 {
    let found = rustix::fs::statvfs(&disk.path).unwrap();
    found.f_bavail * found.f_frsize
}

#[test]
fn a_recording_stops_before_it_takes_the_space_that_stays_free_and_loses_nothing() {
    let Some(disk) = SmallDisk::mount(300) else { return };
    let bag = disk.path.join("bag");
    let options = WriterOptions::new().keep_free(100_000, WhenLow::Stop);
    let (offered, error) = write_until_error(options, &bag, i64::MAX);
    let error = error.unwrap();
    let WriterError::LowSpace { kept, .. } = error else { panic!("{error}") };
    assert_eq!(kept as i64, offered);
    assert!(error.to_string().contains("of 100000 to keep free"), "{error}");
    // One chunk and the end of the file are written after the limit.
    assert!((75_000..100_000).contains(&free(&disk)), "{}", free(&disk));
    assert_eq!(read(&bag), (0..offered).collect::<Vec<_>>());
    assert_eq!(Reader::open(&bag).unwrap().truncation().count(), 0, "the file was finished");
    assert_eq!(Metadata::read(&bag.join(FILE_NAME)).unwrap().message_count as i64, offered);
}

#[test]
fn the_oldest_files_make_room_for_a_recording_that_goes_on() {
    let Some(disk) = SmallDisk::mount(300) else { return };
    let (bag, ballast) = (disk.path.join("bag"), disk.path.join("ballast"));
    let split = SplitLimits { max_bytes: Some(40_000), ..SplitLimits::NONE };
    let options = || WriterOptions::new().split(split).keep_free(100_000, WhenLow::DropOldest);
    let (offered, error) = write_until_error(options(), &bag, 1000);
    assert!(error.is_none(), "{error:?}");
    assert!(free(&disk) > 50_000, "{}", free(&disk));
    let metadata = Metadata::read(&bag.join(FILE_NAME)).unwrap();
    let deleted: i64 = metadata.custom_data["deleted_messages"].parse().unwrap();
    assert_eq!(read(&bag), (deleted..offered).collect::<Vec<_>>());
    assert_eq!(fs::read_dir(&bag).unwrap().count(), metadata.files.len() + 1);

    // If others fill the disk, there is nothing left to delete.
    fs::write(&ballast, vec![0; 30_000]).unwrap();
    let second = disk.path.join("second");
    let (_, error) = write_until_error(options(), &second, 1000);
    assert!(matches!(error, Some(WriterError::LowSpace { .. })), "{error:?}");
    assert_eq!(Metadata::read(&second.join(FILE_NAME)).unwrap().files.len(), 1);
}

#[test]
fn a_bag_of_one_file_has_no_oldest_files_to_drop() {
    let folder = tempfile::tempdir().unwrap();
    let options = WriterOptions::new().keep_free(1, WhenLow::DropOldest);
    let error = options.create(folder.path().join("bag")).err().unwrap();
    assert!(error.to_string().contains("max_bag_size"), "{error}");
    assert!(!folder.path().join("bag").exists());
}
