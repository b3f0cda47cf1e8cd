//! Measures how fast bags are checked and repaired.

use std::path::Path;
use std::time::Duration;

use downbeat_bags::{Check, Compression, Copy, McapOptions, Reader, WriterOptions, check};
use downbeat_msgs::cdr;
use downbeat_msgs::sensor_msgs::msg::{Image, Imu, JointState, LaserScan};

use crate::messages::{by_python, inertial, joint_state, topic};

/// Counts the messages of a file with `mcap` of PyPI, and prints the seconds that it took on the processor.
const PYTHON: &str = "\
import sys, time
from mcap.reader import make_reader
started = time.process_time()
with open(sys.argv[1], 'rb') as stream:
    count = sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages())
print(time.process_time() - started)
";

pub(crate) fn run(folder: &Path, bytes: u64, turns: u32) -> anyhow::Result<()> {
    println!("MB of messages per second on one core");
    println!();
    println!("| bag | check | repair | mcap crate, bytes only | mcap of PyPI, bytes only |");
    println!("| --- | --- | --- | --- | --- |");
    for (name, compression) in Compression::ALL {
        let bag = folder.join(name);
        let data = write(&bag, bytes, compression)? as f64 / 1e6;
        let file = bag.join(format!("{name}_0.mcap"));
        let (mut checked, mut repaired) = (Duration::MAX, Duration::MAX);
        // The crate is built without decompression, which is C.
        let mut streamed = (name == "none").then_some(Duration::MAX);
        for _ in 0..turns {
            checked = checked.min(timed(|| {
                let Check { problems, messages, decoded, .. } = check(&Reader::open(&bag)?, |_| {})?;
                anyhow::ensure!(problems.is_empty() && decoded == messages, "{problems:?}");
                Ok(())
            })?);
            repaired = repaired.min(timed(|| repair(&bag, &folder.join("repaired")))?);
            std::fs::remove_dir_all(folder.join("repaired"))?;
            if let Some(streamed) = &mut streamed {
                *streamed = timed(|| stream(&file))?.min(*streamed);
            }
        }
        let python = mcap_of_python(&file)?.map(Duration::from_secs_f64);
        let [checked, repaired, streamed, python] = [Some(checked), Some(repaired), streamed, python]
            .map(|taken| taken.map_or("-".to_owned(), |taken| format!("{:.0}", data / taken.as_secs_f64())));
        println!("| {name} | {checked} | {repaired} | {streamed} | {python} |");
        std::fs::remove_dir_all(&bag)?;
    }
    Ok(())
}

/// Measures processor time.
fn timed(work: impl FnOnce() -> anyhow::Result<()>) -> anyhow::Result<Duration> {
    let now = || {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        Duration::new(time.tv_sec.unsigned_abs(), u32::try_from(time.tv_nsec).unwrap_or(0))
    };
    let started = now();
    work()?;
    Ok(now() - started)
}

/// As `downbeat bag repair`.
fn repair(bag: &Path, target: &Path) -> anyhow::Result<()> {
    let bags = [Reader::open(bag)?];
    Copy::of(&bags, |_| true)?.into_writer(WriterOptions::new().create(target)?, |_| {})?;
    anyhow::ensure!(check(&Reader::open(target)?, |_| {})?.problems.is_empty());
    Ok(())
}

fn stream(file: &Path) -> anyhow::Result<()> {
    let bytes = std::fs::read(file)?;
    for message in mcap::MessageStream::new(&bytes)? {
        std::hint::black_box(message?);
    }
    Ok(())
}

fn mcap_of_python(file: &Path) -> anyhow::Result<Option<f64>> {
    let output = by_python(&["-c".as_ref(), PYTHON.as_ref(), file.as_os_str()])?;
    output.map(|output| Ok(String::from_utf8(output)?.trim().parse()?)).transpose()
}

/// Writes images, scans, joint states and inertial readings of a small robot. Returns the size of the
/// messages in bytes.
fn write(bag: &Path, bytes: u64, compression: Compression) -> anyhow::Result<u64> {
    let storage = McapOptions { compression, ..McapOptions::default() };
    let mut writer = WriterOptions::new().storage(storage).create(bag)?;
    let topics = [
        topic::<Image>("/camera/image_raw"),
        topic::<LaserScan>("/scan"),
        topic::<JointState>("/joint_states"),
        topic::<Imu>("/imu/data_raw"),
    ];
    let mut ids = Vec::new();
    for topic in topics {
        ids.push(writer.add_topic(topic)?);
    }
    let mut written = 0;
    for n in 0_u32.. {
        let time = i64::from(n) * 8_000_000;
        let mut messages = Vec::new();
        if n.is_multiple_of(8) {
            let data =
                (0..320 * 240_u32).map(|at| (((at * 7 + n) / 64) ^ (at.wrapping_mul(40_503) >> 12)) as u8);
            messages.push((
                0,
                cdr::to_vec(&Image { height: 240, width: 320, data: data.collect(), ..Image::default() }),
            ));
        }
        if n.is_multiple_of(4) {
            #[allow(clippy::disallowed_methods)] // any numbers
            let ranges = (0..720_u32).map(|at| ((at + n) as f32 / 50.0).sin()).collect();
            messages.push((1, cdr::to_vec(&LaserScan { ranges, ..LaserScan::default() })));
        }
        messages.push((2, cdr::to_vec(&joint_state(n))));
        messages.push((3, cdr::to_vec(&inertial(f64::from(n) / 3.0))));
        for (topic, data) in messages {
            writer.write(ids[topic], time, time, &data)?;
            written += data.len() as u64;
        }
        if written >= bytes {
            break;
        }
    }
    writer.finish()?;
    Ok(written)
}
