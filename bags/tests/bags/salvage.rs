//! What can be read of damaged chunks and records, and what is said about the rest.

use std::fs;
use std::path::Path;

use downbeat_bags::{
    Compression, Copy, McapOptions, Reader, Selection, TopicDescription, WriterOptions, check,
};

use crate::support::{messages, number, topic, value};

const COUNT: i64 = 500;

/// A file with one chunk of 500 messages of two topics.
fn one_chunk(folder: &Path, storage: McapOptions) -> Vec<u8> {
    let bag = folder.join("whole");
    let mut writer = WriterOptions::new().storage(storage).create(&bag).unwrap();
    let ids = ["/even", "/odd"].map(|name| {
        let topic = TopicDescription { name: name.to_owned(), ..topic("/") };
        writer.add_topic(topic).unwrap()
    });
    for n in 0..COUNT {
        let time = 1_795_230_923_000_000_000 + 1_000_000 * n;
        writer.write(ids[n as usize % 2], time, time, &number(n)).unwrap();
    }
    writer.finish().unwrap();
    let bytes = fs::read(bag.join("whole_0.mcap")).unwrap();
    fs::remove_dir_all(&bag).unwrap();
    bytes
}

fn plain() -> McapOptions {
    McapOptions { is_compression_forced: true, ..McapOptions::default() }
}

/// Opcode, offset and length of the records, headers included.
fn records(bytes: &[u8], mut offset: usize) -> Vec<(u8, usize, usize)> {
    let mut found = Vec::new();
    while let Some(length) = bytes.get(offset + 1..offset + 9) {
        let length = 9 + u64::from_le_bytes(length.try_into().unwrap()) as usize;
        found.push((bytes[offset], offset, length));
        offset += length;
    }
    found
}

/// The chunk, and the offsets of the records in it if it is not compressed.
fn chunk(bytes: &[u8]) -> (usize, usize, Vec<(u8, usize, usize)>) {
    let chunk = records(bytes, 8).into_iter().find(|(opcode, ..)| *opcode == 6).unwrap();
    let content = chunk.1 + 9 + 28 + 4 + 8;
    (chunk.1, chunk.2, records(&bytes[..chunk.1 + chunk.2], content))
}

fn read(bytes: &[u8]) -> (Vec<i64>, Vec<String>) {
    let reader = Reader::from_bytes("damaged.mcap", bytes.to_vec()).unwrap();
    let mut errors: Vec<String> = reader.truncation().map(ToString::to_string).collect();
    let mut read = Vec::new();
    for item in reader.messages(Selection::all()).unwrap() {
        match item {
            Ok(message) => read.push(value(&message)),
            Err(error) => errors.push(error.to_string()),
        }
    }
    (read, errors)
}

/// The damaged file without its summary, as after an interrupted recording.
fn without_end(damaged: &[u8], whole: &[u8]) -> Vec<u8> {
    let end = records(whole, 8).into_iter().find(|(opcode, ..)| *opcode == 15).unwrap().1;
    damaged[..end].to_vec()
}

#[test]
fn a_flipped_bit_loses_at_most_its_own_message() {
    let folder = tempfile::tempdir().unwrap();
    let whole = one_chunk(folder.path(), plain());
    let (_, _, content) = chunk(&whole);
    let messages: Vec<_> = content.into_iter().filter(|(opcode, ..)| *opcode == 5).collect();
    assert_eq!(messages.len() as i64, COUNT);
    let (_, offset, _) = messages[250];
    // Opcode, length, channel, log time, and the highest byte of the value.
    for (at, bit) in
        [(0, 1), (0, 0x80), (1, 1), (1, 0x40), (3, 4), (8, 0x80), (9, 1), (10, 8), (15, 1), (20, 1), (42, 1)]
    {
        for is_interrupted in [false, true] {
            let mut damaged = whole.clone();
            damaged[offset + at] ^= bit;
            if is_interrupted {
                damaged = without_end(&damaged, &whole);
            }
            let (read, errors) = read(&damaged);
            let others: Vec<i64> = read.iter().filter(|n| **n < COUNT && **n != 250).copied().collect();
            let expected: Vec<i64> = (0..COUNT).filter(|n| *n != 250).collect();
            assert_eq!(others, expected, "byte {at}: {errors:?}");
            let told: Vec<_> = errors.iter().filter(|error| error.contains("damaged: ")).collect();
            assert_eq!(told.len(), 1, "byte {at}: {errors:?}");
            if at < 9 {
                assert!(
                    told[0].ends_with(
                        "499 of 500 messages are read, 1 are lost: 1 of /even at 1795230923.250000000"
                    ),
                    "byte {at}: {}",
                    told[0]
                );
            } else {
                // The index has channel and time, so they are restored.
                assert_eq!(read.len() as i64, COUNT, "byte {at}");
                assert!(told[0].contains("all its 500 messages are read"), "{}", told[0]);
            }
        }
    }
}

#[test]
fn damage_is_found_by_the_index_where_chunks_have_no_checksum() {
    let folder = tempfile::tempdir().unwrap();
    let whole = one_chunk(folder.path(), McapOptions { has_chunk_crc: false, ..plain() });
    let (_, _, content) = chunk(&whole);
    let (_, offset, _) = content.into_iter().filter(|(opcode, ..)| *opcode == 5).nth(7).unwrap();
    for opcode in [0x85, 0x15, 6, 7, 0, 3] {
        let mut damaged = whole.clone();
        damaged[offset] = opcode;
        let (read, errors) = read(&damaged);
        assert_eq!(read, (0..COUNT).filter(|n| *n != 7).collect::<Vec<_>>(), "opcode {opcode}");
        assert_eq!(errors.len(), 1, "opcode {opcode}: {errors:?}");
        assert!(errors[0].contains("499 of 500 messages are read"), "opcode {opcode}: {}", errors[0]);
    }
}

#[test]
fn what_precedes_the_damage_in_a_compressed_chunk_is_read() {
    let folder = tempfile::tempdir().unwrap();
    for compression in [Compression::Lz4, Compression::Zstd] {
        let whole = one_chunk_of_noise(folder.path(), McapOptions { compression, ..plain() });
        let (start, length, _) = chunk(&whole);
        let mut damaged = whole.clone();
        // Overwritten, so that the block cannot be decoded.
        damaged[start + length * 4 / 5..start + length * 4 / 5 + 300].fill(0xff);
        for bytes in [damaged.clone(), without_end(&damaged, &whole)] {
            let reader = Reader::from_bytes("damaged.mcap", bytes).unwrap();
            let read = messages(&reader).len();
            assert!((100..400).contains(&read), "{compression:?}: {read} messages");
        }
    }
}

/// A file with one chunk of 400 messages of 1 KiB that hardly compress.
fn one_chunk_of_noise(folder: &Path, storage: McapOptions) -> Vec<u8> {
    let bag = folder.join("noise");
    let mut writer = WriterOptions::new().storage(storage).create(&bag).unwrap();
    let id = writer.add_topic(topic("/noise")).unwrap();
    let mut state = 1_u32;
    for n in 0..400 {
        let data: Vec<u8> = (0..1024)
            .map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 24) as u8 & 0x7f
            })
            .collect();
        writer.write(id, n, n, &data).unwrap();
    }
    writer.finish().unwrap();
    let bytes = fs::read(bag.join("noise_0.mcap")).unwrap();
    fs::remove_dir_all(&bag).unwrap();
    bytes
}

#[test]
fn a_damaged_record_header_of_a_chunk_loses_nothing() {
    let folder = tempfile::tempdir().unwrap();
    for compression in [Compression::None, Compression::Lz4, Compression::Zstd] {
        let whole = one_chunk(folder.path(), McapOptions { compression, ..plain() });
        let (start, ..) = chunk(&whole);
        // Opcode, length, and the fields of the chunk: times, size, checksum, compression, length of the
        // content.
        for at in (0..49).filter(|at| compression_is_named(compression) || *at < 41) {
            for bit in [1, 0x10, 0x80] {
                for is_interrupted in [false, true] {
                    let mut damaged = whole.clone();
                    damaged[start + at] ^= bit;
                    if is_interrupted {
                        damaged = without_end(&damaged, &whole);
                    }
                    let (read, errors) = read(&damaged);
                    assert_eq!(read.len() as i64, COUNT, "{compression:?}, byte {at}, bit {bit}: {errors:?}");
                }
            }
        }
    }
}

fn compression_is_named(compression: Compression) -> bool {
    !matches!(compression, Compression::None)
}

#[test]
fn a_chunk_within_a_chunk_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let whole = one_chunk(folder.path(), plain());
    let (start, length, content) = chunk(&whole);
    let inner = &whole[start..start + length];
    let first = content[0].1;
    let content = [&whole[first..start + length], inner].concat();
    let mut body = whole[start + 9..start + 9 + 16].to_vec();
    body.extend((content.len() as u64).to_le_bytes());
    body.extend([0; 4 + 4]);
    body.extend((content.len() as u64).to_le_bytes());
    body.extend(&content);
    let mut file = whole[..start].to_vec();
    file.push(6);
    file.extend((body.len() as u64).to_le_bytes());
    file.extend(body);
    let reader = Reader::from_bytes("nested.mcap", file).unwrap();
    let found = check(&reader, |_| {}).unwrap();
    assert_eq!(found.messages as i64, COUNT);
    assert!(
        found.problems.iter().any(|problem| problem.to_string().contains("a chunk within")),
        "{:?}",
        found.problems
    );
}

#[test]
fn an_index_that_points_elsewhere_does_not_hide_messages() {
    let folder = tempfile::tempdir().unwrap();
    let whole = one_chunk(folder.path(), McapOptions { has_summary_crc: false, ..plain() });
    let index = records(&whole, 8).into_iter().find(|(opcode, ..)| *opcode == 8).unwrap().1;
    for (field, value) in [(16, 100_u64), (24, 60), (16, u64::MAX), (24, 1 << 60), (16, 8)] {
        let mut damaged = whole.clone();
        damaged[index + 9 + field..index + 17 + field].copy_from_slice(&value.to_le_bytes());
        let (read, errors) = read(&damaged);
        assert_eq!(read.len() as i64, COUNT, "{field} {value}: {errors:?}");
        assert!(!errors.is_empty(), "{field} {value}");
    }
}

#[test]
fn a_copy_of_a_damaged_bag_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    for compression in [Compression::None, Compression::Lz4, Compression::Zstd] {
        let whole = one_chunk(folder.path(), McapOptions { compression, ..plain() });
        for position in (8..whole.len()).step_by(whole.len() / 60) {
            let mut damaged = whole.clone();
            damaged[position] ^= 0x10;
            let bags = [Reader::from_bytes("damaged.mcap", damaged).unwrap()];
            let copy = Copy::of(&bags, |_| true).unwrap();
            let target = folder.path().join("copy");
            let copied = copy.into_writer(WriterOptions::new().create(&target).unwrap(), |_| {}).unwrap();
            let found = check(&Reader::open(&target).unwrap(), |_| {}).unwrap();
            fs::remove_dir_all(&target).unwrap();
            let is_plain = matches!(compression, Compression::None);
            let read = copied.summary.message_count() as i64;
            assert!(read >= COUNT - 1 || !is_plain, "byte {position}: {read}");
            if copied.undecodable.is_empty() {
                assert_eq!(found.problems, [], "{compression:?}, byte {position}");
            }
        }
    }
}

#[test]
fn lz4_blocks_behind_a_damaged_one_are_read() {
    const MANY: i64 = 17_000;
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("whole");
    let storage = McapOptions { compression: Compression::Lz4, chunk_size: 1 << 20, ..plain() };
    let mut writer = WriterOptions::new().storage(storage).create(&bag).unwrap();
    let id = writer.add_topic(topic("/numbers")).unwrap();
    for n in 0..MANY {
        let time = 1_795_230_923_000_000_000 + 1_000_000 * n;
        writer.write(id, time, time, &number(n)).unwrap();
    }
    writer.finish().unwrap();
    let whole = fs::read(bag.join("whole_0.mcap")).unwrap();
    let chunk = records(&whole, 8).into_iter().find(|(opcode, ..)| *opcode == 6).unwrap();
    // Its header, the name of its compression, and the length of its data are before the frame, whose header
    // has a size.
    let first = chunk.1 + 9 + 28 + (4 + 3) + 8 + (7 + 8);
    let size_at =
        |at: usize| u32::from_le_bytes(whole[at..at + 4].try_into().unwrap()) as usize & 0x7fff_ffff;
    let blocks: Vec<usize> = std::iter::successors(Some(first), |at| {
        let next = at + 4 + size_at(*at);
        (size_at(next) > 0).then_some(next)
    })
    .collect();
    assert!(blocks.len() >= 3, "{blocks:?}");
    for (number, block) in blocks.iter().enumerate() {
        let mut damaged = whole.clone();
        // A sequence that refers to what is before the block.
        damaged[block + 4..block + 8].copy_from_slice(&[0x0f, 0xff, 0xff, 0xff]);
        let (read, errors) = read(&damaged);
        assert!(read.is_sorted() && read.windows(2).all(|pair| pair[0] < pair[1]), "block {number}");
        let lost = MANY as usize - read.len();
        // A block has 256 KiB of messages of at least 40 bytes; two are at its ends.
        assert!(lost > 0 && lost <= (256 << 10) / 40 + 2, "block {number}: {lost}, {errors:?}");
        assert!(number == 0 || read[0] == 0, "block {number}");
        assert!(number == blocks.len() - 1 || read.last() == Some(&(MANY - 1)), "block {number}");
        let told: Vec<_> =
            errors.iter().filter(|error| error.contains(&format!("{lost} are lost"))).collect();
        assert_eq!(told.len(), 1, "block {number}: {errors:?}");
    }
}
