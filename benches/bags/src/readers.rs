//! Measures how long several readers take to read one topic of a bag.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use downbeat::bags::{Reader, Selection, StoragePreset, TopicDescription, WriterOptions};
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
use downbeat_msgs::sensor_msgs::msg::{Imu, JointState};
use downbeat_msgs::{Message, cdr};

const PYTHON: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/python/read_bags.py");
/// The topic that is read; the other topic makes up three quarters of the bag.
const TOPIC: &str = "/joint_states";

/// A contestant: reads the topic and returns the number of messages.
type Contestant = fn(&Path) -> anyhow::Result<u64>;

pub(crate) fn run(folder: &Path, messages: u32, turns: u32) -> anyhow::Result<()> {
    let contestants: [(&str, Contestant); 3] = [
        ("downbeat, bytes", |bag| read(bag, |_| Ok(()))),
        ("downbeat, decoded to structs", |bag| {
            read(bag, |data| {
                let state: JointState = cdr::from_slice(data)?;
                std::hint::black_box(state);
                Ok(())
            })
        }),
        ("downbeat, decoded by the definition of the bag", |bag| {
            let of =
                DynamicType::from_definition_text(JointState::TYPE_NAME, "ros2msg", JointState::DEFINITION)?;
            read(bag, |data| {
                std::hint::black_box(DynamicMessage::from_cdr(&of, data)?);
                Ok(())
            })
        }),
    ];
    println!("| bag | reader | µs per message of the topic | times rosbags |");
    println!("| --- | --- | --- | --- |");
    for (label, preset) in [("not compressed", StoragePreset::None), ("zstd_fast", StoragePreset::ZstdFast)] {
        let bag = folder.join(label.replace(' ', "_"));
        write(&bag, messages, preset)?;
        let peers = by_python(&bag, turns)?;
        for (name, contestant) in contestants {
            let mut best = Duration::MAX;
            for _ in 0..turns {
                let started = Instant::now();
                let count = contestant(&bag)?;
                anyhow::ensure!(count == u64::from(messages), "{name} read {count} messages of {messages}");
                best = best.min(started.elapsed());
            }
            let seconds = best.as_secs_f64() / f64::from(messages);
            let peer = if name.ends_with("bytes") { "rosbags, bytes" } else { "rosbags, decoded" };
            let times = peers.get(peer).map_or_else(String::new, |peer| format!("{:.0}", peer / seconds));
            println!("| {label} | {name} | {:.2} | {times} |", seconds * 1e6);
        }
        for (name, seconds) in &peers {
            println!("| {label} | {name} | {:.2} | 1 |", seconds * 1e6);
        }
        std::fs::remove_dir_all(&bag)?;
    }
    Ok(())
}

fn write(bag: &Path, messages: u32, preset: StoragePreset) -> anyhow::Result<()> {
    let mut writer = WriterOptions::new().storage(preset.options()).create(bag)?;
    let states = writer.add_topic(topic::<JointState>(TOPIC))?;
    let imu = writer.add_topic(topic::<Imu>("/imu"))?;
    for n in 0..messages {
        let time = i64::from(n) * 1_000_000;
        let state = JointState {
            name: (0..20).map(|index| format!("joint_{index}")).collect(),
            position: (0..20).map(|index| f64::from(index + n) / 7.0).collect(),
            ..JointState::default()
        };
        writer.write(states, time, time, &cdr::to_vec(&state))?;
        let mut reading = Imu::default();
        reading.angular_velocity.x = f64::from(n);
        let reading = cdr::to_vec(&reading);
        for _ in 0..3 {
            writer.write(imu, time, time, &reading)?;
        }
    }
    writer.finish()?;
    Ok(())
}

fn topic<T: Message>(name: &str) -> TopicDescription {
    TopicDescription {
        name: name.to_owned(),
        type_name: T::TYPE_NAME.to_owned(),
        definition: T::DEFINITION.to_owned(),
        type_hash: T::TYPE_HASH.to_owned(),
        ..TopicDescription::default()
    }
}

fn read(bag: &Path, mut use_it: impl FnMut(&[u8]) -> anyhow::Result<()>) -> anyhow::Result<u64> {
    let reader = Reader::open(bag)?;
    let topic = reader.topic(TOPIC).context(TOPIC)?;
    let mut count = 0;
    for message in reader.messages(Selection::all().topics([topic]))? {
        use_it(&message?.data)?;
        count += 1;
    }
    Ok(count)
}

/// Best seconds per message.
fn by_python(bag: &Path, turns: u32) -> anyhow::Result<BTreeMap<String, f64>> {
    let Some(python) = std::env::var_os("DOWNBEAT_PYTHON") else {
        println!("no Python: DOWNBEAT_PYTHON is not set");
        return Ok(BTreeMap::new());
    };
    let output = Command::new(python).arg(PYTHON).arg(bag).arg(TOPIC).arg(turns.to_string()).output()?;
    anyhow::ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Ok(serde_json::from_slice(&output.stdout)?)
}
