//! The records of our files, read with the `mcap` crate and checked by checksums.

use std::fs;
use std::path::Path;

use downbeat_bags::{Compression, WriterOptions};
use mcap::Summary;
use mcap::records::{Record, op};

use crate::support::{number, topic, write_numbers};

/// Two topics of one type, alternating, in many chunks.
fn write(folder: &Path, compression: Compression) -> Vec<u8> {
    let bag = folder.join("bag");
    let mut writer = WriterOptions::new().compression(compression).chunk_size(300).create(&bag).unwrap();
    write_numbers(&mut writer, 20);
    let other = writer.add_topic(topic("/other")).unwrap();
    let numbers = writer.add_topic(topic("/numbers")).unwrap();
    for n in 20..60 {
        let id = if n % 3 == 0 { other } else { numbers };
        writer.write(id, 1_000_000 * n, 1_000_000 * n, &number(n)).unwrap();
    }
    writer.finish().unwrap();
    fs::read(bag.join("bag_0.mcap")).unwrap()
}

#[test]
fn the_summary_describes_the_contents_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let summary = Summary::read(&write(folder.path(), Compression::Zstd)).unwrap().unwrap();
    let statistics = summary.stats.unwrap();
    assert_eq!((statistics.message_count, statistics.schema_count, statistics.channel_count), (60, 1, 2));
    assert_eq!((statistics.message_start_time, statistics.message_end_time), (0, 59_000_000));
    assert_eq!(statistics.chunk_count as usize, summary.chunk_indexes.len());
    assert_eq!((statistics.metadata_count, summary.metadata_indexes.len()), (2, 2));
    let count = |name: &str| {
        let channel = summary.channels.values().find(|channel| channel.topic == name).unwrap();
        statistics.channel_message_counts[&channel.id]
    };
    assert_eq!((count("/numbers"), count("/other")), (47, 13));
}

#[test]
fn every_message_is_found_through_the_indexes() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = write(folder.path(), Compression::None);
    let summary = Summary::read(&bytes).unwrap().unwrap();
    let mut found = Vec::new();
    for chunk in &summary.chunk_indexes {
        let indexes = summary.read_message_indexes(&bytes, chunk).unwrap();
        assert_eq!(indexes.len(), chunk.message_index_offsets.len());
        for (channel, entries) in indexes {
            for entry in entries {
                let message = summary.seek_message(&bytes, chunk, &entry).unwrap();
                assert_eq!((message.channel.id, message.log_time), (channel.id, entry.log_time));
                assert!((chunk.message_start_time..=chunk.message_end_time).contains(&entry.log_time));
                found.push(i64::from_le_bytes(message.data[4..].try_into().unwrap()));
            }
        }
    }
    found.sort_unstable();
    assert_eq!(found, (0..60).collect::<Vec<_>>());
    for index in &summary.metadata_indexes {
        let metadata = mcap::read::metadata(&bytes, index).unwrap();
        assert!(metadata.metadata["serialized_metadata"].starts_with("version: 9"));
    }
}

#[test]
fn summary_offsets_point_to_records_of_their_kind_and_checksums_are_correct() {
    let folder = tempfile::tempdir().unwrap();
    for compression in [Compression::None, Compression::Zstd] {
        let folder = folder.path().join(format!("{compression:?}"));
        let bytes = write(&folder, compression);
        let footer = mcap::read::footer(&bytes).unwrap();
        let start = footer.summary_start as usize;
        // The footer is 29 bytes, its checksum the last 4 of them; the end mark follows.
        assert_eq!(footer.summary_crc, crc32fast::hash(&bytes[start..bytes.len() - 12]));
        let data_end = start - 13;
        let Record::DataEnd(end) = mcap::parse_record(bytes[data_end], &bytes[data_end + 9..start]).unwrap()
        else {
            panic!("the summary follows the end of the data");
        };
        assert_eq!(end.data_section_crc, crc32fast::hash(&bytes[..data_end]));

        let mut kinds = Vec::new();
        let mut offset = footer.summary_offset_start as usize;
        while bytes[offset] == op::SUMMARY_OFFSET {
            let end = offset + 9 + 17;
            let Record::SummaryOffset(group) =
                mcap::parse_record(op::SUMMARY_OFFSET, &bytes[offset + 9..end]).unwrap()
            else {
                panic!("no summary offset at {offset}");
            };
            assert_eq!(bytes[group.group_start as usize], group.group_opcode);
            kinds.push(group.group_opcode);
            offset = end;
        }
        assert_eq!(bytes[offset], op::FOOTER);
        assert_eq!(kinds, [op::SCHEMA, op::CHANNEL, op::STATISTICS, op::CHUNK_INDEX, op::METADATA_INDEX]);
    }
}
