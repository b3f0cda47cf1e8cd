//! Measures recording inside the process: a module publishes and the recorder records.

use std::fs::File;
use std::hint::black_box;
use std::io::Write as _;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use downbeat::bags::{Recording, StoragePreset, WriterOptions};
use downbeat::recorder::{self, WhenFull};
use downbeat_executor::{Context, Core, Module, Publication, Setup, SetupError};
use downbeat_msgs::encoding::Encoding;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::sensor_msgs::msg::{Image, Imu};
use rustix::time::{ClockId, clock_gettime};

pub(crate) fn run(folder: &Path, seconds: u64) -> anyhow::Result<()> {
    let duration = Duration::from_secs(seconds);
    println!("All shares are of a core.\n");
    println!(
        "| recorded | preset | messages | lost | MB/s in | MB written | all | publishing | recording | plain writes | ratio |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    for preset in [StoragePreset::None, StoragePreset::ZstdFast] {
        let load = || Load::imus(100, Duration::from_millis(1));
        measure(folder, "100 topics of Imu at 1 kHz", preset, duration, load)?;
    }
    for (name, is_noise) in [("4 images of 1 MB at 30 Hz, drawn", false), ("the same, noise", true)] {
        let load = || Load::images(4, Duration::from_nanos(33_333_333), is_noise);
        measure(folder, name, StoragePreset::ZstdFast, duration, load)?;
    }
    Ok(())
}

fn measure(
    folder: &Path,
    name: &str,
    preset: StoragePreset,
    duration: Duration,
    load: impl Fn() -> Load,
) -> anyhow::Result<()> {
    // Publishing alone, whose cost is not part of recording.
    let (alone, _) = run_core(&load(), duration, |_| Ok(()))?;
    let bag = folder.join("bag");
    let mut recording = None;
    let (processor, message_bytes) = run_core(&load(), duration, |core| {
        let writer = WriterOptions::new().storage(preset.options()).create(&bag)?;
        let started = Recording::start(writer, Recording::DEFAULT_QUEUE_BYTES)?;
        let topics: Vec<_> = core.topics().cloned().collect();
        let interfaces = downbeat::bridge::edge::Interfaces::carried();
        let qos_of = |_: &str| QosProfile::DEFAULT;
        recorder::record(core, &started, &topics, WhenFull::Lose, Encoding::Cdr, &interfaces, qos_of)?;
        recording = Some(started);
        Ok(())
    })?;
    let finishing = processor_time();
    let summary = recording.context("nothing was recorded")?.finish()?;
    let processor = processor + (processor_time() - finishing);
    let plain = plain_writes(&folder.join("plain"), summary.message_count(), message_bytes)?;
    let share = |time: Duration| 100.0 * time.as_secs_f64() / duration.as_secs_f64();
    let (recording, plain) = (share(processor.saturating_sub(alone)), share(plain));
    let megabytes = (summary.message_count() * message_bytes) as f64 / 1e6;
    println!(
        "| {name} | {preset:?} | {} | {} | {:.1} | {:.0} | {:.1} % | {:.1} % | {recording:.1} % | {plain:.1} % | {:.1} |",
        summary.message_count(),
        summary.lost_count(),
        megabytes / duration.as_secs_f64(),
        summary.bytes as f64 / 1e6,
        share(processor),
        share(alone),
        recording / plain,
    );
    std::fs::remove_dir_all(&bag)?;
    Ok(())
}

/// The processor time of copying as many messages into a buffer of the size of a chunk, and writing that to a
/// file whenever it is full: what no recorder can do without.
fn plain_writes(path: &Path, messages: u64, message_bytes: u64) -> anyhow::Result<Duration> {
    let message = vec![1; usize::try_from(message_bytes)?];
    let chunk = usize::try_from(WriterOptions::DEFAULT_CHUNK_SIZE)?;
    let before = processor_time();
    let mut file = File::create(path)?;
    let mut buffer = Vec::with_capacity(chunk + message.len());
    for _ in 0..messages {
        buffer.extend_from_slice(black_box(&message));
        if buffer.len() >= chunk {
            file.write_all(&buffer)?;
            buffer.clear();
        }
    }
    file.write_all(&buffer)?;
    let spent = processor_time() - before;
    std::fs::remove_file(path)?;
    Ok(spent)
}

/// Returns the processor time and the size of a message.
fn run_core(
    load: &Load,
    duration: Duration,
    join: impl FnOnce(&mut Core) -> anyhow::Result<()>,
) -> anyhow::Result<(Duration, u64)> {
    let mut core = Core::new();
    core.add("load", load.clone())?;
    join(&mut core)?;
    let handle = core.handle();
    let before = processor_time();
    let started = Instant::now();
    let running = std::thread::spawn(move || core.run());
    std::thread::sleep(duration.saturating_sub(started.elapsed()));
    handle.stop();
    running.join().map_err(|_| anyhow::anyhow!("the core panicked"))??;
    Ok((processor_time() - before, load.message_bytes()))
}

/// The processor time of all threads of this process.
fn processor_time() -> Duration {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    Duration::new(time.tv_sec as u64, time.tv_nsec as u32)
}

/// Publishes the same message on each of its topics in each period.
#[derive(Clone)]
struct Load {
    period: Duration,
    imus: Vec<Option<Publication<Imu>>>,
    images: Vec<Option<Publication<Image>>>,
    image: Image,
    imu: Imu,
    count: u64,
}

impl Load {
    fn imus(topics: usize, period: Duration) -> Self {
        Self { imus: vec![None; topics], ..Self::nothing(period) }
    }

    fn images(topics: usize, period: Duration, is_noise: bool) -> Self {
        let mut state = 1_u64;
        let pixel = |at: usize| {
            if is_noise {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 56) as u8
            } else {
                // Bands and blobs, like a lawn with lines on it.
                ((at / 1024 / 8 * 3) ^ (at % 1024 / 64 * 5)) as u8
            }
        };
        let data: Vec<u8> = (0..1_000_000).map(pixel).collect();
        let image = Image { height: 976, width: 1024, step: 1024, data, ..Image::default() };
        Self { images: vec![None; topics], image, ..Self::nothing(period) }
    }

    fn nothing(period: Duration) -> Self {
        let (imus, images) = (Vec::new(), Vec::new());
        Self { period, imus, images, image: Image::default(), imu: Imu::default(), count: 0 }
    }

    fn message_bytes(&self) -> u64 {
        let image = downbeat_msgs::cdr::to_vec(&self.image).len();
        let imu = downbeat_msgs::cdr::to_vec(&self.imu).len();
        if self.images.is_empty() { imu as u64 } else { image as u64 }
    }

    fn publish(&mut self, ctx: &mut Context<'_>) {
        self.count += 1;
        self.imu.angular_velocity.x = self.count as f64 / 1000.0;
        for publication in self.imus.iter().flatten() {
            ctx.publish(*publication, self.imu.clone());
        }
        for publication in self.images.iter().flatten() {
            ctx.publish(*publication, self.image.clone());
        }
    }
}

impl Module for Load {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        for (number, publication) in self.imus.iter_mut().enumerate() {
            *publication = Some(setup.publish(&format!("imu_{number}"))?);
        }
        for (number, publication) in self.images.iter_mut().enumerate() {
            *publication = Some(setup.publish(&format!("image_{number}"))?);
        }
        setup.every(self.period, Self::publish)
    }
}
