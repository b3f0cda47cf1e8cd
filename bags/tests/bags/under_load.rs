//! Recordings under load: what is written, what is lost, and which other readers open the bags.
//!
//! `cargo xtask recorder` runs these tests, which take minutes. Each prints rows of a table.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader};
use std::os::linux::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use bytes::Bytes;
use downbeat_bags::{
    Copy, Reader, Recording, RecordingOptions, RecordingSender, RecordingSummary, Selection, SplitLimits,
    SyncPolicy, TopicId, WriterOptions,
};
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::cdr;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::sensor_msgs::msg::CompressedImage;
use downbeat_msgs::std_srvs::srv::SetBoolEvent;
use test_machine::SmallDisk;

use crate::interrupted::{BAG, child, kill};
use crate::python::topic;
use crate::stock_readers;

/// How many minutes the longest recording takes.
const MINUTES: &str = "DOWNBEAT_MINUTES";

const TOPICS: u32 = 10;
const MEGABYTE: u64 = 1_000_000;

/// Numbered messages on [`TOPICS`] topics.
#[derive(Clone, Copy)]
struct Load {
    message_bytes: usize,
    bytes_per_second: u64,
}

/// 10 MB/s in messages of 10 kB.
const CAMERAS: Load = Load { message_bytes: 10_000, bytes_per_second: 10 * MEGABYTE };

impl Load {
    fn topics(sender: &RecordingSender) -> Vec<TopicId> {
        let name = |number| format!("/camera_{number}");
        let topic = |number| topic::<CompressedImage>(&name(number), QosProfile::SENSOR_DATA);
        (0..TOPICS).map(|number| sender.add_topic(topic(number)).unwrap()).collect()
    }

    fn message(self, number: u32) -> Bytes {
        let mut image = CompressedImage { format: "noise".to_owned(), ..CompressedImage::default() };
        // In nanoseconds, so that each number is a stamp.
        image.header.stamp = Time { sec: 0, nanosec: number };
        let mut state = u64::from(number) | 1;
        image.data = Vec::with_capacity(self.message_bytes);
        while image.data.len() < self.message_bytes {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            image.data.extend_from_slice(&state.to_le_bytes());
        }
        cdr::to_vec(&image).into()
    }

    /// Records at the rate of the load, in turn on each topic, without ever waiting for the disk. `at` is
    /// called after each millisecond with the number of messages so far.
    fn offer(self, sender: &RecordingSender, duration: Duration, mut at: impl FnMut(u32)) -> u32 {
        let topics = Self::topics(sender);
        let started = Instant::now();
        let mut next = 0;
        loop {
            let elapsed = started.elapsed().min(duration);
            let due = elapsed.as_secs_f64() * self.bytes_per_second as f64 / self.message_bytes as f64;
            while next < due as u32 {
                let time = i64::try_from(started.elapsed().as_nanos()).unwrap();
                // A rejected message is counted by the recording.
                let _ = sender.record(topics[(next % TOPICS) as usize], time, time, self.message(next));
                next += 1;
            }
            at(next);
            if elapsed == duration {
                return next;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

/// What became of a load.
struct Figures {
    offered: u32,
    seconds: f64,
    /// The most bytes that waited for the disk, in each half of the time.
    most_queued: [usize; 2],
    summary: RecordingSummary,
}

fn record(bag: &Path, writer: WriterOptions, cache: usize, load: Load, duration: Duration) -> Figures {
    let options = RecordingOptions::new().cache_bytes(cache);
    let recording = Recording::start_with(writer.create(bag).unwrap(), &options).unwrap();
    let (sender, started) = (recording.sender(), Instant::now());
    let mut most_queued = [0, 0];
    let mut next_look = started;
    let offered = load.offer(&sender, duration, |_| {
        let now = Instant::now();
        if now >= next_look {
            next_look = now + Duration::from_millis(10);
            let half = usize::from(now - started > duration / 2);
            most_queued[half] = most_queued[half].max(sender.statistics().queued_bytes);
        }
    });
    let seconds = started.elapsed().as_secs_f64();
    let summary = match recording.finish() {
        Ok(summary) => summary,
        Err(failed) => *failed.summary,
    };
    let figures = Figures { offered, seconds, most_queued, summary };
    let accounted = figures.summary.message_count() + figures.summary.lost_count();
    assert_eq!(accounted, u64::from(offered), "each message is written or counted as lost");
    figures
}

impl Figures {
    fn row(&self, name: &str, load: Load, readers: &str) {
        let [first, second] = self.most_queued.map(|bytes| bytes as f64 / 1e6);
        println!(
            "| {name} | {:.0} s of {} MB/s | {} | {} | {} | {first:.1}, {second:.1} | {} | {readers} |",
            self.seconds,
            load.bytes_per_second / MEGABYTE,
            self.offered,
            self.summary.message_count(),
            self.summary.lost_count(),
            self.summary.files,
        );
    }
}

/// The numbers of the messages by topic.
fn read(bag: &Path) -> BTreeMap<String, Vec<u32>> {
    let reader = Reader::open(bag).unwrap();
    let names: Vec<String> = reader.topics().iter().map(|topic| topic.info.name.clone()).collect();
    let mut numbers: BTreeMap<String, Vec<u32>> = BTreeMap::new();
    for message in reader.messages(Selection::all()).unwrap() {
        let message = message.unwrap();
        let image: CompressedImage = cdr::from_slice(&message.data).unwrap();
        let name = &names[message.topic.index()];
        numbers.entry(name.clone()).or_default().push(image.header.stamp.nanosec);
    }
    numbers
}

/// Checks that the messages of each topic are in order, and returns their number.
fn count_in_order(bag: &Path) -> u64 {
    let numbers = read(bag);
    for (topic, numbers) in &numbers {
        assert!(numbers.is_sorted_by(|a, b| a < b), "{topic}");
    }
    numbers.values().map(|numbers| numbers.len() as u64).sum()
}

/// Opens all bags in the folder with other readers, which must find the messages that we find. Returns the
/// names of the readers.
fn open_with_others(folder: &Path) -> String {
    for bag in fs::read_dir(folder).unwrap() {
        let bag = bag.unwrap().path();
        assert_eq!(Reader::open(&bag).unwrap().truncation().count(), 0, "{}", bag.display());
    }
    stock_readers::open_bags(folder).join(", ")
}

/// Copies what can be read of a bag into a whole one, and returns the number of its messages.
fn repair(bag: &Path, copy: &Path) -> u64 {
    let reader = [Reader::open(bag).unwrap()];
    let target = WriterOptions::new().create(copy).unwrap();
    Copy::of(&reader, |_| true).unwrap().into_writer(target, |_| {}).unwrap().summary.message_count()
}

/// Threads that compute on every processor, until it is dropped.
struct BusyCores {
    ends: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl BusyCores {
    fn start() -> Self {
        let ends = Arc::<AtomicBool>::default();
        let spin = |_| {
            let ends = Arc::clone(&ends);
            std::thread::spawn(move || {
                while !ends.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            })
        };
        let threads = (0..std::thread::available_parallelism().unwrap().get()).map(spin).collect();
        Self { ends, threads }
    }
}

impl Drop for BusyCores {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        self.threads.drain(..).for_each(|thread| thread.join().unwrap());
    }
}

/// Limits what this process writes to the disk of a folder, in a control group of the kernel's controller
/// `blkio`, until it is dropped.
struct SlowDisk {
    group: PathBuf,
}

const BLKIO: &str = "/sys/fs/cgroup/blkio";

impl SlowDisk {
    /// Returns `None` and reports a skipped test if this is not permitted.
    fn limit(folder: &Path, bytes_per_second: u64) -> Option<Self> {
        let group = Path::new(BLKIO).join(format!("downbeat_test_{}", std::process::id()));
        let limited = || -> std::io::Result<Self> {
            fs::create_dir(&group)?;
            let slow = Self { group: group.clone() };
            let device = fs::metadata(folder)?.st_dev();
            let (major, minor) = (rustix::fs::major(device), rustix::fs::minor(device));
            let limit = format!("{major}:{minor} {bytes_per_second}");
            fs::write(slow.group.join("blkio.throttle.write_bps_device"), limit)?;
            fs::write(slow.group.join("cgroup.procs"), std::process::id().to_string())?;
            Ok(slow)
        };
        match limited() {
            Ok(slow) => Some(slow),
            Err(error) => {
                test_machine::skipped(&format!("a slow disk needs the controller in {BLKIO}: {error}"));
                None
            }
        }
    }
}

impl Drop for SlowDisk {
    fn drop(&mut self) {
        let _ = fs::write(Path::new(BLKIO).join("cgroup.procs"), std::process::id().to_string());
        // The kernel lets go of a group after its last write is done.
        let until = Instant::now() + Duration::from_secs(10);
        while fs::remove_dir(&self.group).is_err() && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

#[test]
#[ignore = "minutes: cargo xtask recorder"]
fn ten_megabytes_a_second_beside_busy_cores_lose_nothing() {
    let minutes: f64 = std::env::var(MINUTES).map_or(2.0, |minutes| minutes.parse().unwrap());
    let duration = Duration::from_secs_f64(minutes * 60.0);
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("busy");
    let busy = BusyCores::start();
    let figures = record(&bag, WriterOptions::new(), Recording::DEFAULT_QUEUE_BYTES, CAMERAS, duration);
    drop(busy);
    assert_eq!(figures.summary.lost_count(), 0);
    assert_eq!(count_in_order(&bag), u64::from(figures.offered));
    figures.row("beside busy cores", CAMERAS, &open_with_others(folder.path()));
    let per_hour = figures.summary.bytes as f64 / figures.seconds * 3600.0 / 1e9;
    let [first, second] = figures.most_queued.map(|bytes| bytes as f64 / 1e6);
    println!(
        "extrapolated, an hour is {per_hour:.1} GB in one file, with nothing lost as long as the disk keeps up: the queue held at most \
         {first:.1} MB in the first half and {second:.1} MB in the second, of {:.0} MB",
        Recording::DEFAULT_QUEUE_BYTES as f64 / 1e6
    );
}

#[test]
#[ignore = "a minute: cargo xtask recorder"]
fn a_slow_disk_costs_nothing_if_it_keeps_up_and_only_counted_messages_if_not() {
    for (name, limit, keeps_up) in [("a disk of 20 MB/s", 20, true), ("a disk of 4 MB/s", 4, false)] {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("slow");
        // What is not synced, the kernel writes later, for no group.
        let options = WriterOptions::new().sync(SyncPolicy::Chunks);
        let figures = {
            let Some(_slow) = SlowDisk::limit(folder.path(), limit * MEGABYTE) else { return };
            record(&bag, options, 8_000_000, CAMERAS, Duration::from_secs(15))
        };
        assert_eq!(figures.summary.lost_count() == 0, keeps_up, "{name}");
        assert_eq!(count_in_order(&bag), figures.summary.message_count());
        figures.row(name, CAMERAS, &open_with_others(folder.path()));
    }
}

#[test]
#[ignore = "a minute: cargo xtask recorder"]
fn splits_under_load_lose_nothing() {
    let limits = SplitLimits { max_bytes: Some(MEGABYTE), ..SplitLimits::NONE };
    for (name, is_slow) in [("a split at each MB", false), ("the same, a disk of 20 MB/s", true)] {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("splits");
        let options = WriterOptions::new().split(limits).sync(SyncPolicy::Files);
        let figures = {
            let slow = is_slow.then(|| SlowDisk::limit(folder.path(), 20 * MEGABYTE));
            if matches!(slow, Some(None)) {
                return;
            }
            let _busy = BusyCores::start();
            let cache = Recording::DEFAULT_QUEUE_BYTES;
            record(&bag, options, cache, CAMERAS, Duration::from_secs(10))
        };
        assert!(figures.summary.files > 80, "{}", figures.summary.files);
        assert_eq!(figures.summary.lost_count(), 0, "{name}");
        assert_eq!(count_in_order(&bag), u64::from(figures.offered));
        figures.row(name, CAMERAS, &open_with_others(folder.path()));
    }
}

/// Prints the number of messages so far.
#[test]
fn child_records_under_load() {
    let Some(bag) = std::env::var_os(BAG) else { return };
    let recording =
        Recording::start(WriterOptions::new().create(bag).unwrap(), Recording::DEFAULT_QUEUE_BYTES).unwrap();
    CAMERAS.offer(&recording.sender(), Duration::from_secs(60), |offered| println!("offered {offered}"));
}

#[test]
#[ignore = "a minute: cargo xtask recorder"]
fn a_killed_recording_keeps_all_but_the_last_second() {
    for turn in 0..5_u64 {
        let folder = tempfile::tempdir().unwrap();
        let (bag, copy) = (folder.path().join("killed"), folder.path().join("copies/repaired"));
        let mut recorder = child("under_load::child_records_under_load", &bag, None).spawn().unwrap();
        let ends_at = Duration::from_millis(2000 + 337 * turn);
        let started = Instant::now();
        let mut offered: Vec<(Duration, u64)> = Vec::new();
        let lines = BufReader::new(recorder.stdout.take().unwrap()).lines();
        for line in lines.map_while(Result::ok) {
            if let Some(count) = line.strip_prefix("offered ") {
                offered.push((started.elapsed(), count.parse().unwrap()));
            }
            if started.elapsed() >= ends_at {
                break;
            }
        }
        kill(recorder);
        // A chunk is at most as old as the flush interval, and then is in the queue and written at once.
        let kept_until = started.elapsed().min(ends_at) - WriterOptions::DEFAULT_FLUSH_INTERVAL * 3 / 2;
        let least = offered.iter().rev().find(|(at, _)| *at <= kept_until).map_or(0, |(_, count)| *count);
        let kept = repair(&bag, &copy);
        assert!(kept >= least, "{kept} of {least}");
        assert_eq!(count_in_order(&copy), kept);
        let readers = open_with_others(&folder.path().join("copies"));
        let last = offered.last().map_or(0, |(_, count)| *count);
        println!(
            "| killed after {:.1} s, and repaired | 10 MB/s | {last} | {kept} | {} with the last chunk | - | 1 | {readers} |",
            ends_at.as_secs_f64(),
            last.saturating_sub(kept)
        );
    }
}

#[test]
#[ignore = "seconds: cargo xtask recorder"]
fn on_a_full_disk_each_message_is_kept_or_counted() {
    let Some(disk) = SmallDisk::mount(20_000) else { return };
    let bags = disk.path.join("bags");
    fs::create_dir(&bags).unwrap();
    let bag = bags.join("full");
    let cache = Recording::DEFAULT_QUEUE_BYTES;
    let figures = record(&bag, WriterOptions::new(), cache, CAMERAS, Duration::from_secs(4));
    assert!(figures.summary.lost_count() > 0 && figures.summary.message_count() > 1000);
    assert_eq!(count_in_order(&bag), figures.summary.message_count());
    // Its index had no place, without which not everybody reads it.
    let elsewhere = tempfile::tempdir().unwrap();
    assert_eq!(repair(&bag, &elsewhere.path().join("repaired")), figures.summary.message_count());
    figures.row(
        "a disk of 20 MB that fills, and repaired elsewhere",
        CAMERAS,
        &open_with_others(elsewhere.path()),
    );
}

#[test]
#[ignore = "seconds: cargo xtask recorder"]
fn messages_larger_than_chunks_are_read_by_others() {
    let load = Load { message_bytes: 2_000_000, bytes_per_second: 40 * MEGABYTE };
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("large");
    let options = WriterOptions::new().chunk_size(1024);
    let figures = record(&bag, options, Recording::DEFAULT_QUEUE_BYTES, load, Duration::from_secs(5));
    assert_eq!(figures.summary.lost_count(), 0);
    assert_eq!(count_in_order(&bag), u64::from(figures.offered));
    figures.row("messages of 2 MB, chunks of 1 kB", load, &open_with_others(folder.path()));
}

#[test]
#[ignore = "seconds: cargo xtask recorder"]
fn a_flood_of_service_events_is_recorded() {
    const EVENTS: u32 = 100_000;
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("flood");
    let recording =
        Recording::start(WriterOptions::new().create(&bag).unwrap(), Recording::DEFAULT_QUEUE_BYTES).unwrap();
    let sender = recording.sender();
    let events = topic::<SetBoolEvent>("/light/_service_event", QosProfile::SERVICES);
    let events = sender.add_topic(events).unwrap();
    let started = Instant::now();
    for number in 0..EVENTS {
        let mut event = SetBoolEvent::default();
        event.info.sequence_number = i64::from(number);
        let time = i64::from(number);
        let _ = sender.record(events, time, time, cdr::to_vec(&event).into());
    }
    let seconds = started.elapsed().as_secs_f64();
    let summary = recording.finish().unwrap();
    assert_eq!((summary.message_count(), summary.lost_count()), (u64::from(EVENTS), 0));
    let readers = open_with_others(folder.path());
    println!(
        "| 100 000 service events | {seconds:.2} s | {EVENTS} | {} | 0 | - | 1 | {readers} |",
        summary.message_count()
    );
}
