//! Measures how fast several writers write the same messages.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use downbeat_bags::{Compression, McapOptions, StoragePreset, TopicDescription, WriterOptions};
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::{Message, cdr};

const PYTHON: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/python/write_bags.py");

/// A contestant: writes the message the given number of times into a new folder.
type Contestant = fn(&Path, &[u8], u64) -> anyhow::Result<()>;

pub(crate) fn run(folder: &Path, bytes: u64, turns: u32) -> anyhow::Result<()> {
    let contestants: [(&str, Contestant); 6] = [
        ("file, the bytes alone", write_bytes),
        ("mcap crate (limit)", write_mcap),
        ("downbeat", |folder, message, count| write_ours(folder, message, count, McapOptions::default())),
        ("downbeat, preset none", |folder, message, count| {
            write_ours(folder, message, count, StoragePreset::None.options())
        }),
        ("downbeat, zstd_fast", |folder, message, count| {
            write_ours(folder, message, count, StoragePreset::ZstdFast.options())
        }),
        ("downbeat, lz4", |folder, message, count| {
            let options = McapOptions { compression: Compression::Lz4, ..McapOptions::default() };
            write_ours(folder, message, count, options)
        }),
    ];
    println!("| message | writer | MB/s | ns per message | times the limit |");
    println!("| --- | --- | --- | --- | --- |");
    for (label, message) in messages() {
        let count = (bytes / message.len() as u64).max(1);
        let mut best = [Duration::MAX; 6];
        for _ in 0..turns {
            // The contestants take turns, so that a disturbance affects all of them.
            for ((_, write), best) in contestants.iter().zip(&mut best) {
                *best = (*best).min(timed(folder, |bag| write(bag, &message, count))?);
            }
        }
        let limit = best[1].as_secs_f64() / count as f64;
        for ((name, _), time) in contestants.iter().zip(best) {
            row(label, name, time.as_secs_f64() / count as f64, message.len(), limit);
        }
        for (name, seconds) in by_python(folder, &message, (count / 10).max(1))? {
            row(label, &name, seconds, message.len(), limit);
        }
    }
    Ok(())
}

fn row(label: &str, name: &str, seconds: f64, bytes: usize, limit: f64) {
    let (rate, ns) = (bytes as f64 / seconds / 1e6, seconds * 1e9);
    println!("| {label} | {name} | {rate:.0} | {ns:.0} | {:.2} |", seconds / limit);
}

fn messages() -> [(&'static str, Vec<u8>); 3] {
    let joints = JointState {
        name: (0..20).map(|index| format!("joint_{index}")).collect(),
        position: (0..20).map(|index| f64::from(index) / 7.0).collect(),
        ..JointState::default()
    };
    [
        ("100 B", vec![7; 100]),
        ("JointState of 20", cdr::to_vec(&joints)),
        ("1 MB", (0..1_000_000_u32).map(|n| ((n / 1000) ^ n) as u8).collect()),
    ]
}

/// Measures a write into a folder that is removed after the measurement.
fn timed(folder: &Path, write: impl FnOnce(&Path) -> anyhow::Result<()>) -> anyhow::Result<Duration> {
    let bag = folder.join("turn");
    let started = Instant::now();
    write(&bag)?;
    let time = started.elapsed();
    fs::remove_dir_all(&bag)?;
    Ok(time)
}

fn write_bytes(folder: &Path, message: &[u8], count: u64) -> anyhow::Result<()> {
    fs::create_dir(folder)?;
    let mut file = BufWriter::with_capacity(768 * 1024, File::create(folder.join("bytes"))?);
    for _ in 0..count {
        file.write_all(message)?;
    }
    file.flush()?;
    Ok(())
}

fn write_mcap(folder: &Path, message: &[u8], count: u64) -> anyhow::Result<()> {
    fs::create_dir(folder)?;
    let options = mcap::WriteOptions::new().compression(None).profile("ros2").chunk_size(Some(768 * 1024));
    let mut writer = options.create(BufWriter::new(File::create(folder.join("turn_0.mcap"))?))?;
    let schema = writer.add_schema(JointState::TYPE_NAME, "ros2msg", JointState::DEFINITION.as_bytes())?;
    let channel = writer.add_channel(schema, "/joint_states", "cdr", &BTreeMap::new())?;
    for n in 0..count {
        let header =
            mcap::records::MessageHeader { channel_id: channel, sequence: 0, log_time: n, publish_time: n };
        writer.write_to_known_channel(&header, message)?;
    }
    writer.finish()?;
    Ok(())
}

fn write_ours(folder: &Path, message: &[u8], count: u64, options: McapOptions) -> anyhow::Result<()> {
    // Like the other writers: until the operating system has the data.
    let options = WriterOptions::new().storage(options).sync(downbeat_bags::SyncPolicy::Never);
    let mut writer = options.create(folder)?;
    let topic = writer.add_topic(TopicDescription {
        name: "/joint_states".to_owned(),
        type_name: JointState::TYPE_NAME.to_owned(),
        definition: JointState::DEFINITION.to_owned(),
        ..TopicDescription::default()
    })?;
    for n in 0..count as i64 {
        writer.write(topic, n, n, message)?;
    }
    writer.finish()?;
    Ok(())
}

/// Seconds per message of the Python writers, which all run in one process.
fn by_python(folder: &Path, message: &[u8], count: u64) -> anyhow::Result<Vec<(String, f64)>> {
    let Some(python) = std::env::var_os("DOWNBEAT_PYTHON") else {
        println!("no Python: DOWNBEAT_PYTHON is not set");
        return Ok(Vec::new());
    };
    let path = folder.join("message");
    fs::write(&path, message)?;
    let output = Command::new(python).arg(PYTHON).arg(&path).arg(count.to_string()).arg(folder).output()?;
    anyhow::ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let times: BTreeMap<String, f64> = serde_json::from_slice(&output.stdout)?;
    Ok(times.into_iter().collect())
}
