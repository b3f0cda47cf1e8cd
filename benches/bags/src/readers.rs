//! Measures how long several readers take to read one topic of a bag.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::Context as _;
use downbeat::bags::{Reader, Selection, StoragePreset, WriterOptions};
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
use downbeat_msgs::sensor_msgs::msg::{Imu, JointState};
use downbeat_msgs::{Message, cdr};

use crate::messages::{by_python, inertial, joint_state, topic};

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
        let peers = rosbags(&bag, turns)?;
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
        writer.write(states, time, time, &cdr::to_vec(&joint_state(n)))?;
        let reading = cdr::to_vec(&inertial(f64::from(n)));
        for _ in 0..3 {
            writer.write(imu, time, time, &reading)?;
        }
    }
    writer.finish()?;
    Ok(())
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
fn rosbags(bag: &Path, turns: u32) -> anyhow::Result<BTreeMap<String, f64>> {
    let turns = turns.to_string();
    let arguments = [PYTHON.as_ref(), bag.as_os_str(), TOPIC.as_ref(), turns.as_ref()];
    let Some(output) = by_python(&arguments)? else {
        println!("no Python: DOWNBEAT_PYTHON is not set");
        return Ok(BTreeMap::new());
    };
    Ok(serde_json::from_slice(&output)?)
}
