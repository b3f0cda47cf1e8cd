//! Measures recording inside the process: a module publishes and the recorder records.

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
    println!(
        "| recorded, zstd_fast | messages | lost | MB in | MB/s in | MB written | % of a core | without the recorder |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- |");
    measure(folder, "100 topics of Imu at 1 kHz", duration, || Load::imus(100, Duration::from_millis(1)))?;
    for (name, is_noise) in [("4 images of 1 MB at 30 Hz, drawn", false), ("the same, noise", true)] {
        measure(folder, name, duration, || Load::images(4, Duration::from_nanos(33_333_333), is_noise))?;
    }
    Ok(())
}

fn measure(folder: &Path, name: &str, duration: Duration, load: impl Fn() -> Load) -> anyhow::Result<()> {
    // Publishing alone, whose cost is not part of recording.
    let (alone, _) = run_core(&load(), duration, |_| Ok(()))?;
    let bag = folder.join(name.replace([' ', ','], "_"));
    let mut recording = None;
    let (processor, message_bytes) = run_core(&load(), duration, |core| {
        let writer = WriterOptions::new().storage(StoragePreset::ZstdFast.options()).create(&bag)?;
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
    let share = |time: Duration| 100.0 * time.as_secs_f64() / duration.as_secs_f64();
    let megabytes = (summary.message_count() * message_bytes) as f64 / 1e6;
    println!(
        "| {name} | {} | {} | {megabytes:.0} | {:.1} | {:.0} | {:.1} | {:.1} |",
        summary.message_count(),
        summary.lost_count(),
        megabytes / duration.as_secs_f64(),
        summary.bytes as f64 / 1e6,
        share(processor),
        share(alone),
    );
    std::fs::remove_dir_all(&bag)?;
    Ok(())
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
