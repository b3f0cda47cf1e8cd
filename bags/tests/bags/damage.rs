//! Files that are truncated, altered, or not bags.

use std::fs;
use std::path::{Path, PathBuf};

use downbeat_bags::{
    BagInfo, Compression, McapOptions, Reader, ReaderError, Selection, TruncationCause, WriterOptions,
};

use crate::support::{fixture, messages, value, write_numbers};

const COUNT: i64 = 80;

/// Small chunks, which are compressed anyway.
fn storage(compression: Compression) -> McapOptions {
    McapOptions { compression, is_compression_forced: true, chunk_size: 200, ..McapOptions::default() }
}

/// The bytes of a bag file with many chunks, and for each chunk its end and the number of messages up to
/// there.
fn many_chunks(folder: &Path, compression: Compression) -> (Vec<u8>, Vec<(usize, usize)>) {
    let bag = folder.join("whole");
    let mut writer = WriterOptions::new().storage(storage(compression)).create(&bag).unwrap();
    write_numbers(&mut writer, COUNT);
    writer.finish().unwrap();
    let bytes = fs::read(bag.join("whole_0.mcap")).unwrap();
    let mut chunks = Vec::new();
    let mut count = 0;
    let mut offset = 8;
    while bytes[offset] != 0x0f {
        let length = u64::from_le_bytes(bytes[offset + 1..offset + 9].try_into().unwrap()) as usize;
        let end = offset + 9 + length;
        match bytes[offset] {
            0x06 => chunks.push((end, count)),
            // The message index that follows a chunk: channel id, length in bytes, 16 bytes for each message.
            0x07 => {
                let index = u32::from_le_bytes(bytes[offset + 11..offset + 15].try_into().unwrap());
                count += index as usize / 16;
                chunks.last_mut().unwrap().1 = count;
            }
            _ => {}
        }
        offset = end;
    }
    assert_eq!(count as i64, COUNT);
    assert!(chunks.len() > 10);
    fs::remove_dir_all(&bag).unwrap();
    (bytes, chunks)
}

#[test]
fn a_file_truncated_anywhere_never_loses_a_complete_chunk() {
    for compression in [Compression::None, Compression::Zstd] {
        let folder = tempfile::tempdir().unwrap();
        let (bytes, chunks) = many_chunks(folder.path(), compression);
        let path = folder.path().join("cut.mcap");
        let mut partly = 0;
        // Every 23rd byte, and every byte around the ends of chunks and of the file.
        let near_end = |length: &usize| {
            let ends = chunks.iter().map(|(end, _)| *end).chain([0, bytes.len()]);
            length.is_multiple_of(23) || ends.into_iter().any(|end| end.abs_diff(*length) <= 9)
        };
        for length in (0..bytes.len()).filter(near_end) {
            fs::write(&path, &bytes[..length]).unwrap();
            let reader = Reader::open(&path).unwrap_or_else(|error| panic!("truncated to {length}: {error}"));
            let complete = chunks.iter().rev().find(|(end, _)| *end <= length).map_or(0, |(_, count)| *count);
            let upto = chunks.iter().find(|(end, _)| *end > length).map_or(complete, |(_, count)| *count);
            let read: Vec<i64> = messages(&reader).iter().map(value).collect();
            assert_eq!(
                read,
                (0..read.len() as i64).collect::<Vec<_>>(),
                "cut to {length} of {}",
                bytes.len()
            );
            assert!((complete..=upto).contains(&read.len()), "cut to {length}: {} messages", read.len());
            partly += usize::from(read.len() > complete);
            assert_eq!(reader.message_count(), read.len() as u64, "cut to {length}");
            let truncation: Vec<_> = reader.truncation().collect();
            assert_eq!(truncation.len(), 1, "truncated to {length}: the missing part is reported");
            assert_eq!(truncation[0].offset + truncation[0].lost_bytes, length as u64);
        }
        let is_plain = matches!(compression, Compression::None);
        assert!(
            partly > 20 || !is_plain,
            "messages before the cut are read from an uncompressed chunk: {partly}"
        );
    }
}

#[test]
fn missing_parts_are_reported_and_listed_in_info() {
    let folder = tempfile::tempdir().unwrap();
    let (bytes, chunks) = many_chunks(folder.path(), Compression::None);
    let path = folder.path().join("cut.mcap");
    fs::write(&path, &bytes[..chunks[3].0 + 100]).unwrap();
    let reader = Reader::open(&path).unwrap();
    let truncation = reader.truncation().next().unwrap();
    assert_eq!(truncation.cause, TruncationCause::TornRecord);
    let info = BagInfo::of(&reader).unwrap().to_string();
    assert!(info.contains("Warning:           "), "{info}");
    assert!(info.contains("recording or copying was interrupted"), "{info}");
}

#[test]
fn a_damaged_chunk_is_reported_once_and_later_chunks_are_read() {
    for compression in [Compression::None, Compression::Zstd] {
        let folder = tempfile::tempdir().unwrap();
        let (mut bytes, chunks) = many_chunks(folder.path(), compression);
        bytes[chunks[2].0 - 20] ^= 0x40;
        let path = folder.path().join("damaged.mcap");
        for (length, is_whole) in [(bytes.len(), true), (chunks[8].0, false)] {
            fs::write(&path, &bytes[..length]).unwrap();
            let reader = Reader::open(&path).unwrap();
            let items: Vec<_> = reader.messages(Selection::all()).unwrap().collect();
            let errors: Vec<_> = items.iter().filter_map(|item| item.as_ref().err()).collect();
            let read: Vec<i64> = items.iter().filter_map(|item| item.as_ref().ok()).map(value).collect();
            let upto = if is_whole { COUNT } else { chunks[8].1 as i64 };
            // The damaged byte is not part of a number. Compressed, everything behind it may be lost.
            let lost = match compression {
                Compression::None => 0..0,
                _ => chunks[1].1 as i64..chunks[2].1 as i64,
            };
            let intact = read.iter().filter(|n| !lost.contains(n)).copied().collect::<Vec<_>>();
            assert_eq!(intact, (0..upto).filter(|n| !lost.contains(n)).collect::<Vec<_>>());
            if is_whole {
                // With the summary the file is not scanned, so the damage is found when reading.
                assert_eq!(errors.len(), 1);
                assert!(matches!(errors[0], ReaderError::Damaged { .. }), "{}", errors[0]);
            } else {
                let causes: Vec<_> = reader.truncation().map(|truncation| &truncation.cause).collect();
                assert!(matches!(causes[0], TruncationCause::DamagedChunk(_)), "{causes:?}");
            }
        }
    }
}

#[test]
fn a_chunk_with_a_wrong_declared_size_is_reported_and_read() {
    let folder = tempfile::tempdir().unwrap();
    let (bytes, _) = many_chunks(folder.path(), Compression::Zstd);
    // The chunk decompresses to more than declared, like a decompression bomb.
    for (declared, expected) in
        [(10, "found more"), (1 << 29, "too many for"), (u64::MAX, "18446744073709551615 bytes of content")]
    {
        let mut altered = bytes.clone();
        let start = chunk_start(&bytes, 2);
        // Opcode, length, and two times come before the uncompressed size.
        altered[start + 25..start + 33].copy_from_slice(&u64::to_le_bytes(declared));
        let path = folder.path().join("altered.mcap");
        fs::write(&path, &altered).unwrap();
        let items: Vec<_> = Reader::open(&path).unwrap().messages(Selection::all()).unwrap().collect();
        let errors: Vec<_> = items.iter().filter_map(|item| item.as_ref().err()).collect();
        assert_eq!(errors.len(), 1);
        assert!(errors[0].to_string().contains(expected), "{}", errors[0]);
        let read: Vec<i64> = items.iter().filter_map(|item| item.as_ref().ok()).map(value).collect();
        assert_eq!(read, (0..COUNT).collect::<Vec<_>>(), "the content itself is intact");
    }
}

/// The offset of the chunk with that index.
fn chunk_start(bytes: &[u8], index: usize) -> usize {
    let mut offset = 8;
    let mut left = index;
    while bytes[offset] != 0x06 || left > 0 {
        left -= usize::from(bytes[offset] == 0x06);
        offset += 9 + u64::from_le_bytes(bytes[offset + 1..offset + 9].try_into().unwrap()) as usize;
    }
    offset
}

#[test]
fn no_altered_byte_makes_the_reader_panic() {
    let folder = tempfile::tempdir().unwrap();
    let own = |compression| many_chunks(folder.path(), compression).0;
    let real = |name: &str| fs::read(fixture(name).join(format!("{name}_0.mcap"))).unwrap();
    let inputs = [
        (own(Compression::None), 19),
        (own(Compression::Zstd), 19),
        // The real recorder writes no chunk checksums, so an altered length is found when it is used.
        (real("jazzy_mcap"), 3511),
        (real("jazzy_mcap_zstd"), 2011),
    ];
    let path = folder.path().join("altered.mcap");
    let mut opened = 0;
    for (bytes, step) in inputs {
        for position in (0..bytes.len()).step_by(step) {
            for change in [0xff, 0x01] {
                let mut altered = bytes.clone();
                altered[position] ^= change;
                fs::write(&path, &altered).unwrap();
                if let Ok(reader) = Reader::open(&path) {
                    let _ = messages(&reader);
                    opened += 1;
                }
            }
        }
    }
    assert!(opened > 300, "a file with damage inside can be opened");
}

#[test]
fn altered_files_without_a_summary_do_not_panic_either() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("altered.mcap");
    let (bytes, chunks) = many_chunks(folder.path(), Compression::Zstd);
    let bytes = &bytes[..chunks[4].0];
    for position in (8..bytes.len()).step_by(3) {
        for change in [0xff, 0x80, 0x01] {
            let mut altered = bytes.to_vec();
            altered[position] ^= change;
            fs::write(&path, &altered).unwrap();
            let reader = Reader::open(&path).unwrap();
            assert_eq!(messages(&reader).len() as u64, reader.message_count(), "at {position}");
        }
    }
}

#[test]
fn other_files_are_refused_with_a_description() {
    let folder = tempfile::tempdir().unwrap();
    let error = |path: &Path| Reader::open(path).unwrap_err().to_string();

    let missing = folder.path().join("nowhere");
    assert!(error(&missing).starts_with(&format!("cannot read {}", missing.display())));
    assert!(error(folder.path()).contains("neither metadata.yaml nor a file *.mcap"));

    let picture = folder.path().join("picture.mcap");
    fs::write(&picture, b"\x89PNG\r\n\x1a\n and so on").unwrap();
    assert!(
        error(&picture).contains("is not an MCAP file: it starts with [89, 50, 4e, 47"),
        "{}",
        error(&picture)
    );

    let yaml = fs::read_to_string(fixture("jazzy_mcap").join("metadata.yaml")).unwrap();
    let bag = folder.path().join("bag");
    fs::create_dir(&bag).unwrap();
    let write = |text: String| fs::write(bag.join("metadata.yaml"), text).unwrap();
    write(yaml.clone());
    assert!(error(&bag).contains("jazzy_mcap_0.mcap"), "names the missing file: {}", error(&bag));
    write(yaml.replace("version: 9", "version: nine"));
    assert!(error(&bag).contains("metadata.yaml:2: "), "{}", error(&bag));
}

/// A bag of numbers whose metadata.yaml names `file` in place of its own.
fn bag_that_names(folder: &Path, file: &str) -> PathBuf {
    let bag = folder.join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    write_numbers(&mut writer, 3);
    writer.finish().unwrap();
    let yaml = fs::read_to_string(bag.join("metadata.yaml")).unwrap();
    fs::write(bag.join("metadata.yaml"), yaml.replace("bag_0.mcap", file)).unwrap();
    bag
}

#[test]
fn a_file_outside_the_bag_is_not_read_whatever_its_metadata_names() {
    for name in ["../other.mcap", "/tmp/other.mcap", "x/../../other.mcap"] {
        let folder = tempfile::tempdir().unwrap();
        let bag = bag_that_names(folder.path(), name);
        fs::copy(bag.join("bag_0.mcap"), folder.path().join("other.mcap")).unwrap();
        let error = Reader::open(&bag).unwrap_err();
        assert!(matches!(error, ReaderError::Outside { .. }), "{name}: {error}");
    }
}

#[cfg(unix)]
#[test]
fn a_link_out_of_the_bag_is_not_followed() {
    let folder = tempfile::tempdir().unwrap();
    let bag = bag_that_names(folder.path(), "link.mcap");
    fs::rename(bag.join("bag_0.mcap"), folder.path().join("other.mcap")).unwrap();
    std::os::unix::fs::symlink("../other.mcap", bag.join("link.mcap")).unwrap();
    let error = Reader::open(&bag).unwrap_err().to_string();
    assert!(error.contains("link.mcap is not in the bag"), "{error}");
    // A link within the bag is permitted, and the bag itself may be a link.
    fs::rename(folder.path().join("other.mcap"), bag.join("here.mcap")).unwrap();
    fs::remove_file(bag.join("link.mcap")).unwrap();
    std::os::unix::fs::symlink("here.mcap", bag.join("link.mcap")).unwrap();
    std::os::unix::fs::symlink("bag", folder.path().join("also")).unwrap();
    assert_eq!(messages(&Reader::open(folder.path().join("also")).unwrap()).len(), 3);
}

#[cfg(unix)]
#[test]
fn a_pipe_in_place_of_a_file_is_refused_without_blocking() {
    for name in ["bag_0.mcap", "metadata.yaml"] {
        let folder = tempfile::tempdir().unwrap();
        let bag = bag_that_names(folder.path(), "bag_0.mcap");
        fs::remove_file(bag.join(name)).unwrap();
        let made = std::process::Command::new("mkfifo").arg(bag.join(name)).status().unwrap();
        assert!(made.success());
        let error = Reader::open(&bag).unwrap_err();
        assert!(matches!(error, ReaderError::NotAFile { .. }), "{name}: {error}");
    }
}

#[test]
fn odd_quality_of_service_of_one_topic_does_not_make_a_bag_unreadable() {
    let bag = fixture("qos_map_text");
    let reader = Reader::open(&bag).unwrap();
    assert_eq!(messages(&reader).len(), 5);
    let oddities: Vec<_> = reader.oddities().collect();
    assert!(oddities[0].starts_with("/chatter: its offered_qos_profiles is odd"), "{oddities:?}");
    // In the channel of a file without metadata.yaml.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("odd.mcap");
    let mut writer = WriterOptions::new().create(folder.path().join("bag")).unwrap();
    write_numbers(&mut writer, 3);
    writer.finish().unwrap();
    let whole = fs::read(folder.path().join("bag/bag_0.mcap")).unwrap();
    let odd = replaced(&whole, b"- history: keep_last", b"  history: keep_last");
    fs::write(&path, odd).unwrap();
    let reader = Reader::open(&path).unwrap();
    assert_eq!(messages(&reader).len(), 3);
    assert_eq!(reader.topics()[0].info.name, "/numbers");
    assert!(
        reader.oddities().any(|oddity| oddity.starts_with("/numbers: ")),
        "{:?}",
        reader.oddities().collect::<Vec<_>>()
    );
}

/// Replaces every `from` in the bytes.
fn replaced(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    let mut bytes = bytes.to_vec();
    for at in 0..bytes.len() - from.len() {
        if bytes[at..].starts_with(from) {
            bytes[at..at + from.len()].copy_from_slice(to);
        }
    }
    bytes
}
