//! Mutations of bag files: of arbitrary bytes, and of single parts in otherwise valid files.

use fuzzing::Random;
use mcap::records::op;

use crate::parts::{self, Part, Parts};

/// Changes some bytes, lengths and ranges.
pub fn bytes(bytes: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..=random.below(4) {
        let at = random.below(bytes.len());
        match random.below(7) {
            0 if at < bytes.len() => bytes[at] ^= 1 << random.below(8),
            1 if at < bytes.len() => bytes[at] = *random.choose(&[0, 1, 0x7f, 0x80, 0xff]),
            2 => bytes.truncate(at),
            3 => {
                let length = bytes.len() as u64;
                let special =
                    [0, 1, length, u64::from(u32::MAX), 1 << 30, 1 << 31, i64::MAX as u64, u64::MAX];
                let value = random.choose(&special).to_le_bytes();
                let width = *random.choose(&[2, 4, 8]);
                for (byte, new) in bytes[at..].iter_mut().zip(&value[..width]) {
                    *byte = *new;
                }
            }
            4 => {
                let length = random.below(200).min(bytes.len() - at);
                bytes.drain(at..at + length);
            }
            5 => {
                let from = random.below(bytes.len());
                let length = random.below(200).min(bytes.len() - from);
                let stretch = bytes[from..from + length].to_vec();
                bytes.splice(at..at, stretch);
            }
            _ => bytes.insert(at, random.bits() as u8),
        }
    }
}

/// Changes some parts; their declared sizes and checksums are correct.
pub fn parts(parts: &mut Parts, random: &mut Random) {
    for _ in 0..=random.below(3) {
        let at = random.below(parts.data.len());
        match random.below(10) {
            0 if parts.data.len() > 1 => drop(parts.data.remove(at)),
            1 => parts.data.insert(at, parts.data[at].clone()),
            2 => {
                let other = random.below(parts.data.len());
                parts.data.swap(at, other);
            }
            3 => parts.has_summary ^= true,
            4 if !parts.summary.is_empty() => {
                let record = random.below(parts.summary.len());
                bytes(&mut parts.summary[record].1, random);
            }
            _ => part(&mut parts.data[at], random),
        }
    }
}

fn part(part: &mut Part, random: &mut Random) {
    let chunk = match part {
        Part::Record(opcode, body) => {
            if random.one_in(8) {
                *opcode = random.bits() as u8;
            }
            return bytes(body, random);
        }
        Part::Chunk(chunk) => chunk,
    };
    match random.below(12) {
        0 => chunk.told_length = Some(random.bits() >> random.below(64)),
        1 => chunk.compression = (*random.choose(&["", "lz4", "zstd", "xz"])).to_owned(),
        2 => {
            (chunk.first, chunk.last) = (random.bits() >> random.below(64), random.bits() >> random.below(64))
        }
        3 => chunk.checksum ^= random.bits() as u32,
        4 => bytes(chunk.plain(), random),
        _ => record_within(chunk.plain(), random),
    }
}

/// Changes the body of one of the records and corrects its length.
fn record_within(content: &mut Vec<u8>, random: &mut Random) {
    let mut records = parts::records(content);
    if records.is_empty() {
        return;
    }
    let at = random.below(records.len());
    match random.below(8) {
        0 => drop(records.remove(at)),
        1 => records.insert(at, records[at].clone()),
        2 => {
            records[at].0 = *random.choose(&[op::SCHEMA, op::CHANNEL, op::MESSAGE, op::CHUNK, op::FOOTER, 0])
        }
        _ => bytes(&mut records[at].1, random),
    }
    content.clear();
    records.iter().for_each(|(opcode, body)| parts::add(content, *opcode, body));
}
