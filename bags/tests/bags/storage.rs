//! Presets and layouts of files, read by others.

use std::fs;

use downbeat_bags::{
    Compression, CompressionLevel, McapOptions, Reader, Storage, StorageError, StorageOptions, StoragePreset,
    SyncPolicy, TopicDescription, WriterOptions,
};
use downbeat_msgs::{Message, cdr, std_msgs};
use mcap::Summary;

use crate::matrix::{Way, With};
use crate::python::read_with_python;
use crate::support::{messages, noted, value, write_numbers};

const LEVELS: [CompressionLevel; 5] = [
    CompressionLevel::Fastest,
    CompressionLevel::Fast,
    CompressionLevel::Default,
    CompressionLevel::Slow,
    CompressionLevel::Slowest,
];

/// Each preset, each compression at each level, and layouts without optional parts.
fn layouts() -> Vec<(String, McapOptions)> {
    let mut layouts: Vec<_> =
        StoragePreset::ALL.iter().map(|(name, preset)| ((*name).to_owned(), preset.options())).collect();
    for (name, compression) in Compression::ALL {
        for level in LEVELS {
            let options = McapOptions { compression, level, ..McapOptions::default() };
            layouts.push((format!("{name} {level:?}"), options));
        }
    }
    let plain = McapOptions::default();
    layouts.push(("no message index".to_owned(), McapOptions { has_message_index: false, ..plain }));
    layouts.push(("no summary".to_owned(), McapOptions { has_summary: false, ..plain }));
    layouts.push(("no chunk index".to_owned(), McapOptions { has_chunk_index: false, ..plain }));
    layouts.push(("no statistics".to_owned(), McapOptions { has_statistics: false, ..plain }));
    layouts
}

/// Text, which compresses well, and occasional bytes that do not.
fn write_texts(bag: &std::path::Path, options: McapOptions) -> u64 {
    let options = McapOptions { chunk_size: 30_000, ..options };
    let mut writer = WriterOptions::new().storage(options).create(bag).unwrap();
    let id = writer
        .add_topic(TopicDescription {
            name: "/texts".to_owned(),
            type_name: std_msgs::msg::String::TYPE_NAME.to_owned(),
            definition: std_msgs::msg::String::DEFINITION.to_owned(),
            type_hash: std_msgs::msg::String::TYPE_HASH.to_owned(),
            ..TopicDescription::default()
        })
        .unwrap();
    let mut state = 1_u32;
    for n in 0..500 {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let noise: String =
            (0..n % 90).map(|at| char::from(b'a' + (state.rotate_left(at as u32) % 26) as u8)).collect();
        let data =
            format!("message {n} of the walk over the lawn, left foot first: {noise}").repeat(1 + n % 5);
        let time = 1_000_000 * n as i64;
        writer.write(id, time, time, &cdr::to_vec(&std_msgs::msg::String { data })).unwrap();
    }
    writer.finish().unwrap().message_count()
}

#[test]
fn others_decode_every_message_of_every_layout() {
    let folder = tempfile::tempdir().unwrap();
    let mut counts = Vec::new();
    for (number, (_, options)) in layouts().into_iter().enumerate() {
        counts.push(write_texts(&folder.path().join(format!("bag_{number:02}")), options));
    }
    let Some(found) = read_with_python("decode_layouts.py", folder.path()) else { return };
    let readers = [With::Mcap, With::McapRos2, With::Rosbags];
    let _checks = readers.map(|with| noted("every storage preset and level of compression", with, Way::Out));
    let _others =
        [With::Mcap, With::McapRos2].map(|with| noted("files without indexes or summary", with, Way::Out));
    let plain = &found["bag_00"]["hash"];
    for (number, (name, _)) in layouts().into_iter().enumerate() {
        let found = &found[format!("bag_{number:02}")];
        for reader in ["mcap", "mcap_ros2", "rosbags"] {
            // rosbags finds messages through indexes only.
            if reader == "rosbags" && name.starts_with("no ") {
                continue;
            }
            assert_eq!(found[reader], counts[number], "{reader} of {name}: {found}");
        }
        assert_eq!(found["hash"], *plain, "{name}: the same messages");
    }
}

#[test]
fn we_read_what_we_write_with_every_layout() {
    let folder = tempfile::tempdir().unwrap();
    for (number, (name, options)) in layouts().into_iter().enumerate() {
        if options.compression == Compression::Lz4 {
            continue; // read by others, above
        }
        let bag = folder.path().join(format!("bag_{number}"));
        let options = WriterOptions::new().storage(options).chunk_size(700).sync(SyncPolicy::Chunks);
        let mut writer = options.create(&bag).unwrap();
        write_numbers(&mut writer, 300);
        writer.finish().unwrap();
        let reader = Reader::open(&bag).unwrap();
        assert_eq!(
            messages(&reader).iter().map(value).collect::<Vec<_>>(),
            (0..300).collect::<Vec<_>>(),
            "{name}"
        );
    }
}

#[test]
fn presets_are_those_of_rosbag2() {
    let folder = tempfile::tempdir().unwrap();
    let summary = |preset: StoragePreset| {
        let bag = folder.path().join(preset.to_string());
        write_texts(&bag, preset.options());
        let bytes = fs::read(bag.join(format!("{preset}_0.mcap"))).unwrap();
        let summary = Summary::read(&bytes).unwrap().unwrap();
        let stored: u64 = summary.chunk_indexes.iter().map(|chunk| chunk.compressed_size).sum();
        (summary, stored)
    };
    let (none, plain) = summary(StoragePreset::None);
    assert!(none.chunk_indexes.iter().all(|chunk| chunk.compression.is_empty()));
    let (fastwrite, _) = summary(StoragePreset::FastWrite);
    assert!(fastwrite.chunk_indexes.is_empty());
    assert_eq!(fastwrite.stats.unwrap().message_count, 500);
    let (fast, fast_size) = summary(StoragePreset::ZstdFast);
    assert!(fast.chunk_indexes.iter().all(|chunk| chunk.compression == "zstd"));
    let (_, small_size) = summary(StoragePreset::ZstdSmall);
    assert!(small_size <= fast_size && fast_size < plain / 3, "{small_size} {fast_size} {plain}");
    assert_eq!(StoragePreset::ZstdSmall.options().chunk_size, 4 << 20);
}

#[test]
fn incompressible_content_is_stored_uncompressed() {
    let folder = tempfile::tempdir().unwrap();
    let noise: Vec<u8> = (0..20_000_u64)
        .map(|n| (n.wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(23).wrapping_mul(n | 1) >> 40) as u8)
        .collect();
    for (name, compression) in Compression::ALL {
        let bag = folder.path().join(name);
        let mut writer = WriterOptions::new().compression(compression).create(&bag).unwrap();
        let id = writer.add_topic(crate::support::topic("/noise")).unwrap();
        writer.write(id, 1, 1, &noise).unwrap();
        writer.finish().unwrap();
        let bytes = fs::read(bag.join(format!("{name}_0.mcap"))).unwrap();
        let summary = Summary::read(&bytes).unwrap().unwrap();
        assert_eq!(summary.chunk_indexes[0].compression, "", "{name}");
    }
}

#[test]
fn mcap_and_sqlite_and_their_presets_are_chosen_by_name() {
    let preset = |storage: &str, name: &str| StorageOptions::preset(storage.parse().unwrap(), name);
    assert_eq!(preset("mcap", "fastwrite"), Ok(StoragePreset::FastWrite.options().into()));
    assert_eq!(
        "rocks".parse::<Storage>().unwrap_err(),
        "unknown storage \"rocks\"; available are mcap, sqlite3"
    );
    assert!(preset("mcap", "resilient").unwrap_err().to_string().ends_with("zstd_fast, zstd_small"));
    if cfg!(feature = "sqlite") {
        assert_eq!(preset("sqlite3", "resilient"), StorageOptions::of(Storage::Sqlite3));
        assert_eq!(
            preset("sqlite3", "zstd_fast").unwrap_err().to_string(),
            "unknown preset profile \"zstd_fast\" of the storage sqlite3; available are none, resilient"
        );
        let mut options = StorageOptions::of(Storage::Sqlite3).unwrap();
        assert_eq!(options.mcap_mut(), Err(StorageError::Compression));
    } else {
        assert_eq!(StorageOptions::of(Storage::Sqlite3), Err(StorageError::NotBuilt));
        let message = preset("sqlite3", "resilient").unwrap_err().to_string();
        assert!(message.contains("--features sqlite"), "{message}");
    }
}
