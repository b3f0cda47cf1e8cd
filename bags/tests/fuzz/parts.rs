//! A bag file in parts, which are changed individually and assembled again with correct lengths, offsets and
//! checksums, so that readers get as far as the change.
//!
//! # References
//! The records are those of <https://mcap.dev/spec>.

use std::borrow::Cow;
use std::io::{Read, Write};

use lz4_flex::frame::{FrameDecoder, FrameEncoder};
use mcap::MAGIC;
use mcap::records::{Record, op};
use ruzstd::decoding::StreamingDecoder;

/// The parts before the summary, and those of the summary except the indexes, which are recreated.
#[derive(Clone)]
pub struct Parts {
    pub data: Vec<Part>,
    pub summary: Vec<(u8, Vec<u8>)>,
    pub has_summary: bool,
}

#[derive(Clone)]
pub enum Part {
    Record(u8, Vec<u8>),
    Chunk(Chunk),
}

#[derive(Clone)]
pub struct Chunk {
    pub first: u64,
    pub last: u64,
    pub compression: String,
    pub content: Content,
    /// 0 means none.
    pub checksum: u32,
    /// Its declared length, if that is wrong.
    pub told_length: Option<u64>,
}

#[derive(Clone)]
pub enum Content {
    Plain(Vec<u8>),
    /// The compressed content, and its uncompressed length.
    Compressed(Vec<u8>, u64),
}

impl Parts {
    pub fn of(file: &[u8]) -> Self {
        let mut parts = Self { data: Vec::new(), summary: Vec::new(), has_summary: false };
        let mut records = records(&file[MAGIC.len()..file.len() - MAGIC.len()]).into_iter();
        for (opcode, body) in records.by_ref().take_while(|(opcode, _)| *opcode != op::DATA_END) {
            parts.data.push(match opcode {
                op::CHUNK => Part::Chunk(Chunk::of(&body)),
                _ => Part::Record(opcode, body),
            });
        }
        let indexes =
            [op::CHUNK_INDEX, op::METADATA_INDEX, op::ATTACHMENT_INDEX, op::SUMMARY_OFFSET, op::FOOTER];
        parts.summary = records.filter(|(opcode, _)| !indexes.contains(opcode)).collect();
        parts.has_summary = !parts.summary.is_empty();
        parts
    }

    pub fn to_file(&self) -> Vec<u8> {
        let mut file = MAGIC.to_vec();
        let mut indexes = Vec::new();
        for part in &self.data {
            let start = file.len() as u64;
            match part {
                Part::Record(opcode, body) => add(&mut file, *opcode, body),
                Part::Chunk(chunk) => add(&mut file, op::CHUNK, &chunk.body()),
            }
            let place = [start.to_le_bytes(), (file.len() as u64 - start).to_le_bytes()].concat();
            match part {
                Part::Chunk(chunk) => indexes.push((op::CHUNK_INDEX, chunk.index(&place))),
                Part::Record(op::METADATA, _) => {
                    indexes.push((op::METADATA_INDEX, [place.as_slice(), &text("rosbag2")].concat()));
                }
                Part::Record(..) => {}
            }
        }
        add(&mut file, op::DATA_END, &[0; 4]);
        let mut summary_start = 0;
        if self.has_summary {
            summary_start = file.len() as u64;
            let opcodes = indexes.iter().chain(&self.summary).map(|(opcode, _)| *opcode);
            let chunks = opcodes.filter(|opcode| *opcode == op::CHUNK_INDEX).count() as u32;
            for (opcode, body) in &self.summary {
                let mut body = Cow::from(body);
                if *opcode == op::STATISTICS
                    && let Some(count) = body.to_mut().get_mut(22..26)
                {
                    count.copy_from_slice(&chunks.to_le_bytes());
                }
                add(&mut file, *opcode, &body);
            }
            indexes.iter().for_each(|(opcode, body)| add(&mut file, *opcode, body));
        }
        add(&mut file, op::FOOTER, &[&summary_start.to_le_bytes()[..], &[0; 12]].concat());
        file.extend_from_slice(MAGIC);
        file
    }
}

impl Chunk {
    /// A chunk of uncompressed records.
    pub fn new(compression: &str, (first, last): (u64, u64), content: Content) -> Self {
        Self { first, last, compression: compression.to_owned(), content, checksum: 0, told_length: None }
    }

    fn of(body: &[u8]) -> Self {
        let Ok(Record::Chunk { header, data }) = mcap::parse_record(op::CHUNK, body) else {
            panic!("a seed has an invalid chunk")
        };
        Self {
            first: header.message_start_time,
            last: header.message_end_time,
            compression: header.compression,
            content: Content::Compressed(data.into_owned(), header.uncompressed_size),
            checksum: header.uncompressed_crc,
            told_length: None,
        }
    }

    /// Its records for mutation: they are compressed again, and the checksum is updated.
    pub fn plain(&mut self) -> &mut Vec<u8> {
        if let Content::Compressed(data, _) = &self.content {
            let mut plain = Vec::new();
            let read = match self.compression.as_str() {
                "lz4" => FrameDecoder::new(data.as_slice()).read_to_end(&mut plain),
                "zstd" => StreamingDecoder::new(data.as_slice())
                    .map_or(Ok(0), |mut zstd| zstd.read_to_end(&mut plain)),
                _ => {
                    plain.clone_from(data);
                    Ok(0)
                }
            };
            // An already damaged chunk yields what can be decompressed.
            drop(read);
            self.content = Content::Plain(plain);
        }
        match &mut self.content {
            Content::Plain(plain) | Content::Compressed(plain, _) => plain,
        }
    }

    fn body(&self) -> Vec<u8> {
        let (data, length, checksum) = match &self.content {
            Content::Compressed(data, length) => (Cow::from(data), *length, self.checksum),
            Content::Plain(plain) => {
                let checksum = if self.checksum == 0 { 0 } else { crc32fast::hash(plain) };
                (self.compress(plain), plain.len() as u64, checksum)
            }
        };
        let mut body =
            [self.first, self.last, self.told_length.unwrap_or(length)].map(u64::to_le_bytes).concat();
        body.extend_from_slice(&checksum.to_le_bytes());
        body.extend_from_slice(&text(&self.compression));
        body.extend_from_slice(&(data.len() as u64).to_le_bytes());
        body.extend_from_slice(&data);
        body
    }

    fn compress<'a>(&self, plain: &'a [u8]) -> Cow<'a, [u8]> {
        match self.compression.as_str() {
            "lz4" => {
                let mut encoder = FrameEncoder::new(Vec::new());
                encoder.write_all(plain).unwrap();
                encoder.finish().unwrap().into()
            }
            // Compressed seeds exercise the decoder; only the content matters here.
            "zstd" => zstd(plain).into(),
            _ => plain.into(),
        }
    }

    fn index(&self, place: &[u8]) -> Vec<u8> {
        let mut body = [self.first, self.last].map(u64::to_le_bytes).concat();
        body.extend_from_slice(place);
        body.extend_from_slice(&[0; 4 + 8]); // no indexes of messages
        body.extend_from_slice(&text(&self.compression));
        body.extend_from_slice(&[0; 8 + 8]); // sizes, which are also in the chunk
        body
    }
}

/// A quickly created Zstandard frame: `ruzstd` allocates and clears much more memory.
pub fn zstd(plain: &[u8]) -> Vec<u8> {
    zstd_with_zeros(plain, 0)
}

/// A Zstandard frame of those bytes and `zeros` zeros, which take 4 bytes per 128 KiB (RFC 8878 section
/// 3.1.1).
pub fn zstd_with_zeros(plain: &[u8], zeros: usize) -> Vec<u8> {
    const BLOCK: usize = 128 * 1024;
    const RAW: u32 = 0;
    const RUN: u32 = 1;
    // The magic number, no checksum and no length, a window of 128 KiB.
    let mut frame = vec![0x28, 0xb5, 0x2f, 0xfd, 0x00, 7 << 3];
    let mut block = |size: usize, kind: u32, is_last: bool, content: &[u8]| {
        let header = (size as u32) << 3 | kind << 1 | u32::from(is_last);
        frame.extend_from_slice(&header.to_le_bytes()[..3]);
        frame.extend_from_slice(content);
    };
    plain.chunks(BLOCK).for_each(|content| block(content.len(), RAW, false, content));
    (0..zeros / BLOCK).for_each(|_| block(BLOCK, RUN, false, &[0]));
    block(zeros % BLOCK, RUN, true, &[0]);
    frame
}

/// The complete records in `bytes`: opcodes and bodies.
pub fn records(bytes: &[u8]) -> Vec<(u8, Vec<u8>)> {
    let mut found = Vec::new();
    let mut rest = bytes;
    while let Some((header, behind)) = rest.split_at_checked(9) {
        let length = u64::from_le_bytes(header[1..].try_into().unwrap());
        let Some((body, behind)) =
            usize::try_from(length).ok().and_then(|length| behind.split_at_checked(length))
        else {
            break;
        };
        found.push((header[0], body.to_vec()));
        rest = behind;
    }
    found
}

/// Adds a record.
pub fn add(file: &mut Vec<u8>, opcode: u8, body: &[u8]) {
    file.push(opcode);
    file.extend_from_slice(&(body.len() as u64).to_le_bytes());
    file.extend_from_slice(body);
}

/// A string as in records.
pub fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
}
