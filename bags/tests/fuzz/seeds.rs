//! Small bag files with every kind of content, so that most mutations affect something that is read.

use std::fs;
use std::path::{Path, PathBuf};

use downbeat_bags::metadata::{FILE_NAME, Metadata};
use downbeat_bags::{Compression, McapOptions, MessageFormat, TopicDescription, WriterOptions};
use downbeat_msgs::encoding::Schema;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::{Message, cdr, sensor_msgs, std_msgs, std_srvs};
use mcap::records::op;

use crate::parts::{Content, Part, Parts, add, records, text, zstd};

pub enum Seed {
    /// An MCAP file.
    File(Vec<u8>),
    /// A file compressed as a whole, and its content.
    Packed(Vec<u8>, Vec<u8>),
    Text(Vec<u8>),
}

/// Our files in different layouts, and metadata.yaml.
pub fn small() -> Vec<Seed> {
    let folder = tempfile::tempdir().unwrap();
    let plain = McapOptions { chunk_size: 300, is_compression_forced: true, ..McapOptions::default() };
    let layouts = [
        plain,
        McapOptions { compression: Compression::Lz4, ..plain },
        McapOptions { compression: Compression::Zstd, ..plain },
        McapOptions { has_summary: false, ..plain },
        McapOptions { is_chunked: false, ..plain },
        McapOptions { has_chunk_crc: false, has_statistics: false, ..plain },
    ];
    let bag = |number: usize| folder.path().join(format!("bag_{number}"));
    let mut files = Vec::new();
    for (number, layout) in layouts.into_iter().enumerate() {
        write(&bag(number), layout);
        files.push(fs::read(bag(number).join(format!("bag_{number}_0.mcap"))).unwrap());
    }
    let mut attached = Parts::of(&files[0]);
    attached.data.insert(1, Part::Record(op::ATTACHMENT, attachment()));
    let packed_messages = with_packed_messages(&files[0]);
    // Parsing YAML takes longer than everything else: only these two and the first have it.
    files.iter_mut().skip(1).for_each(|file| *file = without_metadata(file));
    let packed = Seed::Packed(zstd(&files[1]), files[1].clone());
    let yaml = Seed::Text(fs::read(bag(0).join(FILE_NAME)).unwrap());
    files.extend([attached.to_file(), packed_messages]);
    files.into_iter().map(Seed::File).chain([packed, yaml]).collect()
}

/// Bags of the real recorder.
pub fn recorded() -> Vec<Seed> {
    let of = |name: &str, file: &str| {
        let data = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data");
        fs::read(data.join(name).join(file)).unwrap()
    };
    vec![
        Seed::File(of("jazzy_mcap_zstd", "jazzy_mcap_zstd_0.mcap")),
        Seed::File(of("jazzy_mcap", "jazzy_mcap_0.mcap")),
        Seed::Text(of("jazzy_mcap", FILE_NAME)),
    ]
}

/// Messages described as messages, as events of a service, by IDL, and not at all.
fn write(bag: &Path, storage: McapOptions) {
    let mut writer = WriterOptions::new().storage(storage).create(bag).unwrap();
    let joints = TopicDescription {
        offered_qos: vec![QosProfile::DEFAULT.into()],
        ..topic::<sensor_msgs::msg::JointState>("/joint_states")
    };
    let idl = "================================================================================\nIDL: demo_msgs/msg/Number\n\
               module demo_msgs { module msg { struct Number { int64 data; }; }; };\n";
    let number = TopicDescription {
        name: "/number".to_owned(),
        type_name: "demo_msgs/msg/Number".to_owned(),
        format: Some(MessageFormat {
            message_encoding: "cdr".to_owned(),
            schema: Schema {
                name: "demo_msgs/msg/Number".to_owned(),
                encoding: "ros2idl".to_owned(),
                data: idl.into(),
            },
        }),
        ..TopicDescription::default()
    };
    let events = topic::<std_srvs::srv::SetBoolEvent>("/switch/_service_event");
    let unknown = TopicDescription { definition: String::new(), ..topic::<std_msgs::msg::Empty>("/unknown") };
    let state = sensor_msgs::msg::JointState {
        name: vec!["pan".to_owned(), "tilt".to_owned()],
        position: vec![0.5, -1.5],
        ..Default::default()
    };
    let messages = [
        (joints, cdr::to_vec(&state)),
        (number, [&[0, 1, 0, 0][..], &7_i64.to_le_bytes()].concat()),
        (events, cdr::to_vec(&std_srvs::srv::SetBoolEvent::default())),
        (unknown, vec![0, 1, 0, 0, 0]),
    ];
    for (start, (topic, message)) in (1_000..).step_by(700).zip(messages) {
        let id = writer.add_topic(topic).unwrap();
        for time in [start, start + 500, start + 1000] {
            writer.write(id, time, time - 10, &message).unwrap();
        }
    }
    writer.finish().unwrap();
}

fn topic<M: Message>(name: &str) -> TopicDescription {
    TopicDescription {
        name: name.to_owned(),
        type_name: M::TYPE_NAME.to_owned(),
        definition: M::DEFINITION.to_owned(),
        type_hash: M::TYPE_HASH.to_owned(),
        ..TopicDescription::default()
    }
}

fn attachment() -> Vec<u8> {
    let mut body = [1_u64, 2].map(u64::to_le_bytes).concat();
    body.extend_from_slice(&text("calibration.yaml"));
    body.extend_from_slice(&text("text/yaml"));
    body.extend_from_slice(&9_u64.to_le_bytes());
    body.extend_from_slice(b"gain: 1.5");
    body.extend_from_slice(&crc32fast::hash(&body).to_le_bytes());
    body
}

fn without_metadata(file: &[u8]) -> Vec<u8> {
    let mut parts = Parts::of(file);
    parts.data.retain(|part| !matches!(part, Part::Record(op::METADATA, _)));
    parts.to_file()
}

/// The same as created by rosbag2 with `--compression-mode message`.
fn with_packed_messages(file: &[u8]) -> Vec<u8> {
    let mut parts = Parts::of(file);
    for part in &mut parts.data {
        match part {
            Part::Chunk(chunk) => {
                let mut packed = Vec::new();
                for (opcode, body) in records(chunk.plain()) {
                    let (header, data) = body.split_at(if opcode == op::MESSAGE { 22 } else { body.len() });
                    let data = if opcode == op::MESSAGE { zstd(data) } else { Vec::new() };
                    add(&mut packed, opcode, &[header, &data].concat());
                }
                chunk.content = Content::Plain(packed);
            }
            Part::Record(op::METADATA, body) => *body = metadata_of_packed_messages(body),
            Part::Record(..) => {}
        }
    }
    parts.to_file()
}

fn metadata_of_packed_messages(body: &[u8]) -> Vec<u8> {
    let Ok(mcap::records::Record::Metadata(record)) = mcap::parse_record(op::METADATA, body) else {
        panic!("no metadata")
    };
    let mut metadata =
        Metadata::parse_record(&record.metadata["serialized_metadata"], Path::new("seed")).unwrap();
    metadata.compression_mode = "MESSAGE".to_owned();
    metadata.compression_format = "zstd".to_owned();
    let entry = [text("serialized_metadata"), text(&metadata.to_record())].concat();
    [text("rosbag2"), (entry.len() as u32).to_le_bytes().to_vec(), entry].concat()
}
