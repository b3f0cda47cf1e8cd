//! Compares our recorder with the real one: the same topics and messages, with our own definitions, result in
//! the same records.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use downbeat_bags::metadata::{FILE_NAME, Metadata};
use downbeat_bags::{StoragePreset, TopicDescription, WriterOptions};
use downbeat_msgs::dynamic::{AmentPrefixPath, Definitions};
use mcap::records::{Channel, ChunkHeader, Record, SchemaHeader, Statistics, op};
use python_peer::Python;

use crate::matrix::{Way, With};
use crate::support::{fixture, noted};

/// A file of the real or of this recorder, record by record.
#[derive(Default)]
struct Taken {
    /// The opcodes, without those of the indexes of messages.
    layout: Vec<u8>,
    chunks: Vec<(ChunkHeader, Vec<u8>)>,
    /// The number of indexes after the chunks.
    indexes: usize,
    schemas: Vec<(SchemaHeader, Vec<u8>)>,
    channels: Vec<Channel>,
    statistics: Option<Statistics>,
    data_crc: u32,
    metadata: Vec<String>,
}

fn records(bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    let mut offset = 0;
    std::iter::from_fn(move || {
        let header = bytes.get(offset..offset + 9)?;
        let length = u64::from_le_bytes(header[1..].try_into().unwrap()) as usize;
        let body = bytes.get(offset + 9..offset + 9 + length)?;
        offset += 9 + length;
        Some((header[0], body))
    })
}

fn take_apart(bytes: &[u8]) -> Taken {
    let mut taken = Taken::default();
    for (opcode, body) in records(&bytes[8..bytes.len() - 8]) {
        match mcap::parse_record(opcode, body).unwrap() {
            Record::Chunk { header, data } => taken.chunks.push((header, data.into_owned())),
            Record::Schema { header, data } => taken.schemas.push((header, data.into_owned())),
            Record::Channel(channel) => taken.channels.push(channel),
            Record::Statistics(statistics) => taken.statistics = Some(statistics),
            Record::DataEnd(end) => taken.data_crc = end.data_section_crc,
            Record::Metadata(metadata) => {
                assert_eq!(metadata.name, "rosbag2");
                taken.metadata.push(metadata.metadata["serialized_metadata"].clone());
            }
            Record::MessageIndex(_) => taken.indexes += 1,
            _ => {}
        }
        if opcode != op::MESSAGE_INDEX {
            taken.layout.push(opcode);
        }
    }
    taken
}

/// The source of definitions: the interfaces installed with ROS 2, as for the real recorder, if Python is
/// available; else the built-in ones, which have no comments.
fn definitions() -> (Definitions, bool) {
    let prefix =
        Python::find().map(|python| python.prefix()).filter(|prefix| prefix.join("share/std_msgs").is_dir());
    match prefix {
        Some(prefix) => (Definitions::new().with(AmentPrefixPath::new([prefix])).with_carried(), true),
        None => (Definitions::new().with_carried(), false),
    }
}

/// The topics of the real file in their original order, with definitions that are not from the file.
fn our_topics(real: &Taken, metadata: &Metadata) -> Vec<TopicDescription> {
    let (definitions, has_comments) = definitions();
    let topic = |channel: &Channel| {
        let recorded = metadata.topics.iter().find(|recorded| recorded.name == channel.topic).unwrap();
        let (mut definition, type_hash) = definitions.find_text(&recorded.type_name).unwrap();
        let schema = real.schemas.iter().find(|(header, _)| header.name == recorded.type_name);
        let real_text = schema.map(|(_, text)| String::from_utf8_lossy(text).into_owned()).unwrap();
        // Not installed with rclpy: uses the built-in definitions, which have no comments.
        let package = recorded.type_name.split('/').next().unwrap();
        if has_comments && ["rosbag2_interfaces", "tf2_msgs"].contains(&package) {
            assert_eq!(without_comments(&definition), without_comments(&real_text));
            definition = real_text;
        }
        TopicDescription {
            name: channel.topic.clone(),
            type_name: recorded.type_name.clone(),
            definition,
            type_hash,
            offered_qos: recorded.offered_qos.clone(),
            format: None,
        }
    };
    real.channels.iter().map(topic).collect()
}

/// Removes comments and empty lines, if the available definitions have none.
fn comparable(text: &[u8]) -> String {
    let text = String::from_utf8_lossy(text).into_owned();
    if definitions().1 { text } else { without_comments(&text) }
}

fn without_comments(text: &str) -> String {
    let code = text.lines().map(|line| line.split('#').next().unwrap_or_default());
    let words = code.map(|line| line.split_whitespace().collect::<Vec<_>>().join(" "));
    words.filter(|line| !line.is_empty()).collect::<Vec<_>>().join("\n")
}

/// The decompressed content of a chunk of the real recorder.
fn content(chunk: &(ChunkHeader, Vec<u8>)) -> Vec<u8> {
    let (header, data) = chunk;
    if header.compression.is_empty() {
        return data.clone();
    }
    let mut out = Vec::new();
    std::io::Read::read_to_end(
        &mut ruzstd::decoding::StreamingDecoder::new(data.as_slice()).unwrap(),
        &mut out,
    )
    .unwrap();
    out
}

/// Our file and the real one, with the same messages.
fn beside(name: &str, preset: StoragePreset, folder: &Path) -> (Taken, Taken) {
    let metadata = Metadata::read(&fixture(name).join(FILE_NAME)).unwrap();
    let mut real = take_apart(&fs::read(fixture(name).join(format!("{name}_0.mcap"))).unwrap());
    real.channels.sort_by_key(|channel| channel.id);
    let bag = folder.join(name);
    let mut writer = WriterOptions::new()
        .storage(preset.options())
        .flush_interval(std::time::Duration::MAX)
        .create(&bag)
        .unwrap();
    // The real recorder knows its topics before the first message.
    let ids: Vec<_> =
        our_topics(&real, &metadata).into_iter().map(|topic| writer.add_topic(topic).unwrap()).collect();
    for chunk in &real.chunks {
        for (opcode, body) in records(&content(chunk)) {
            if let Record::Message { header, data } = mcap::parse_record(opcode, body).unwrap() {
                let id = ids[usize::from(header.channel_id) - 1];
                writer.write(id, header.log_time as i64, header.publish_time as i64, &data).unwrap();
            }
        }
    }
    writer.finish().unwrap();
    let ours = take_apart(&fs::read(bag.join(format!("{name}_0.mcap"))).unwrap());
    let mut written = Metadata::read(&bag.join(FILE_NAME)).unwrap();
    // The real recorder stores its topics in a hash table.
    let order: BTreeMap<&str, usize> =
        metadata.topics.iter().enumerate().map(|(index, topic)| (topic.name.as_str(), index)).collect();
    written.topics.sort_by_key(|topic| order[topic.name.as_str()]);
    assert_eq!(written.to_yaml(), fs::read_to_string(fixture(name).join(FILE_NAME)).unwrap(), "{name}");
    (ours, real)
}

const BAGS: [(&str, StoragePreset); 2] =
    [("jazzy_mcap", StoragePreset::None), ("jazzy_mcap_zstd", StoragePreset::ZstdFast)];

#[test]
fn schemas_and_channels_equal_those_of_the_real_recorder() {
    let folder = tempfile::tempdir().unwrap();
    for (name, preset) in BAGS {
        let (ours, real) = beside(name, preset, folder.path());
        assert_eq!(ours.channels, real.channels, "{name}");
        assert_eq!(ours.schemas.len(), real.schemas.len(), "{name}");
        for ((our_header, our_text), (header, text)) in ours.schemas.iter().zip(&real.schemas) {
            if header.name.contains("/srv/") {
                // The real recorder writes a text that other readers, `rosbags` among them, refuse together
                // with the whole bag.
                assert_eq!((&*header.encoding, &*our_header.encoding), ("unknown", "ros2idl"), "{name}");
                continue;
            }
            let encoding = |header: &SchemaHeader| (header.id, header.name.clone(), header.encoding.clone());
            assert_eq!(encoding(our_header), encoding(header), "{name}");
            assert_eq!(comparable(our_text), comparable(text), "{name}: {}", header.name);
        }
    }
}

#[test]
fn the_records_of_the_file_are_those_of_the_real_recorder() {
    let _check = noted("the same records for the same messages", With::Rosbag2, Way::Out);
    let folder = tempfile::tempdir().unwrap();
    for (name, preset) in BAGS {
        let (ours, real) = beside(name, preset, folder.path());
        assert_eq!(ours.layout, real.layout, "{name}");
        assert_eq!(ours.indexes, real.indexes, "{name}");
        assert_eq!(ours.statistics, real.statistics, "{name}");
        assert_eq!(ours.data_crc, real.data_crc, "{name}");
        assert_eq!(ours.chunks.len(), real.chunks.len(), "{name}");
        for (our_chunk, chunk) in ours.chunks.iter().zip(&real.chunks) {
            // Schema, channel and message records in order; the compressed bytes differ.
            let (our_content, content) = (content(our_chunk), content(chunk));
            let kinds = |content: &[u8]| records(content).map(|(opcode, _)| opcode).collect::<Vec<_>>();
            assert_eq!(kinds(&our_content), kinds(&content), "{name}");
            let has_services = content.windows(5).any(|bytes| bytes == b"/srv/");
            if definitions().1 && !has_services {
                assert!(our_content == content, "{name}: byte for byte");
                let header = |header: &ChunkHeader| ChunkHeader { compressed_size: 0, ..header.clone() };
                assert_eq!(header(&our_chunk.0), header(&chunk.0), "{name}");
            }
        }
        let metadata = |text: &String| Metadata::parse_record(text, Path::new(name)).unwrap();
        let (ours, real) = (ours.metadata.iter().map(metadata), real.metadata.iter().map(metadata));
        for (ours, real) in ours.zip(real) {
            assert_eq!((ours.message_count, ours.files), (real.message_count, real.files), "{name}");
        }
    }
}
