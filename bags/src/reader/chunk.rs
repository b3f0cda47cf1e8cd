//! The content of a chunk, decompressed as far as possible.

use std::borrow::Cow::{self, Borrowed, Owned};
use std::ops::Range;

use super::records::RECORD_HEADER;
use super::source::PACKED_MAGIC;
use crate::{lz4, zstd};

/// The content of a chunk.
pub(super) struct Unpacked<'a> {
    pub(super) content: Cow<'a, [u8]>,
    /// Ranges of the content that could not be decompressed, in order.
    pub(super) holes: Vec<Range<usize>>,
    /// Why it is incomplete or wrong, as the end of a sentence about the chunk.
    pub(super) problem: Option<String>,
    /// The content differs from its checksum.
    pub(super) is_checksum_wrong: bool,
    /// The log times of its first and last message, as the chunk declares them.
    pub(super) times: Option<(u64, u64)>,
}

impl<'a> Unpacked<'a> {
    /// The content of records outside of chunks.
    pub(super) fn of_run(bytes: &'a [u8]) -> Self {
        let content = Borrowed(bytes);
        Self { content, holes: Vec::new(), problem: None, is_checksum_wrong: false, times: None }
    }
}

/// The parts of a chunk record. See <https://mcap.dev/spec#chunk-op0x06>.
struct Parts<'a> {
    first: u64,
    last: u64,
    uncompressed_size: u64,
    checksum: u32,
    compression: Cow<'a, str>,
    data: &'a [u8],
    problem: Option<String>,
}

/// The fields before the name of the compression, and the lengths of that name and of the data.
const FIXED: usize = 8 + 8 + 8 + 4;
const NAME_LENGTH: usize = 4;
const DATA_LENGTH: usize = 8;
/// The longest name of a compression.
const LONGEST_NAME: usize = 64;
/// The first bytes of an LZ4 frame.
const LZ4_MAGIC: &[u8] = &[0x04, 0x22, 0x4d, 0x18];

/// The bytes at the start of a chunk's body from which [`length_of`] determines its length.
pub(super) const LONGEST_HEAD: usize = FIXED + NAME_LENGTH + LONGEST_NAME + DATA_LENGTH;

/// The length of the body that starts with `head`, if this is that of a chunk: the chunk declares the length
/// of its content, apart from the length of the record.
pub(super) fn length_of(head: &[u8]) -> Option<u64> {
    let name_length = number(head, FIXED, NAME_LENGTH)?;
    let name = head.get(FIXED + NAME_LENGTH..)?.get(..usize::try_from(name_length).ok()?)?;
    let is_known = ["", "lz4", "zstd"].iter().any(|known| known.as_bytes() == name);
    let data_length = number(head, FIXED + NAME_LENGTH + name.len(), DATA_LENGTH)?;
    let around = (FIXED + NAME_LENGTH + name.len() + DATA_LENGTH) as u64;
    let times = (number(head, 0, 8)?, number(head, 8, 8)?);
    if is_known && times.0 <= times.1 { around.checked_add(data_length) } else { None }
}

/// Reads a number of `width` bytes.
fn number(bytes: &[u8], at: usize, width: usize) -> Option<u64> {
    let bytes = bytes.get(at..at.checked_add(width)?)?;
    Some(bytes.iter().rev().fold(0, |sum, byte| sum << 8 | u64::from(*byte)))
}

impl<'a> Parts<'a> {
    /// `None` if there are no bytes of content.
    fn of(body: &'a [u8]) -> Option<Self> {
        let name_length = number(body, FIXED, NAME_LENGTH)?;
        let mut problem = None;
        // The content lasts until the end of the record, which tells how long the name is if that is damaged.
        let fits = |length: &usize| {
            let declared = number(body, FIXED + NAME_LENGTH + length, DATA_LENGTH);
            declared
                == Some(
                    (body.len() as u64).saturating_sub((FIXED + NAME_LENGTH + length + DATA_LENGTH) as u64),
                )
        };
        let declared = usize::try_from(name_length).ok().filter(|length| *length <= LONGEST_NAME);
        let name_length = declared.filter(fits).or_else(|| {
            let other = [0, "lz4".len(), "zstd".len()].into_iter().find(fits);
            if other.is_some() {
                problem = Some("its header has an invalid length".to_owned());
            }
            other
        });
        let name_length = match name_length {
            Some(length) => length,
            None => {
                let length = declared?;
                let after = body.len().checked_sub(FIXED + NAME_LENGTH + length + DATA_LENGTH)?;
                let told = number(body, FIXED + NAME_LENGTH + length, DATA_LENGTH)?;
                problem = Some(format!("its header declares {told} bytes of content, found {after}"));
                length
            }
        };
        let name = body.get(FIXED + NAME_LENGTH..FIXED + NAME_LENGTH + name_length)?;
        Some(Self {
            first: number(body, 0, 8)?,
            last: number(body, 8, 8)?,
            uncompressed_size: number(body, 16, 8)?,
            checksum: u32::try_from(number(body, 24, 4)?).ok()?,
            compression: String::from_utf8_lossy(name),
            data: body.get(FIXED + NAME_LENGTH + name_length + DATA_LENGTH..)?,
            problem,
        })
    }
}

/// Decompresses the content of a chunk and verifies its checksum. `bytes` is the whole record.
pub(super) fn unpack(bytes: &[u8]) -> Unpacked<'_> {
    let body = bytes.get(RECORD_HEADER as usize..).unwrap_or_default();
    let Some(parts) = Parts::of(body) else {
        let problem = Some(format!("its header is incomplete or invalid, in {} bytes", body.len()));
        return Unpacked { problem, ..Unpacked::of_run(&[]) };
    };
    let Parts { first, last, uncompressed_size, checksum, compression, data, problem } = parts;
    let mut problem = problem;
    let compression = match &*compression {
        known @ ("" | "zstd" | "lz4") => known,
        other => {
            let sniffed = [(PACKED_MAGIC, "zstd"), (LZ4_MAGIC, "lz4")];
            let sniffed = sniffed.into_iter().find(|(magic, _)| data.starts_with(magic));
            let found = format!("it is compressed with {other:?}; supported are lz4, zstd and none");
            problem.get_or_insert(found);
            sniffed.map_or(UNKNOWN, |(_, name)| name)
        }
    };
    let limit = limit(uncompressed_size, data.len() as u64);
    let (mut content, failure) = match compression {
        "" => (Borrowed(data), None),
        "zstd" => owned(zstd::decompress_prefix(data, limit)),
        "lz4" => owned(lz4::decompress_prefix(data, limit)),
        _ => (Borrowed(&[][..]), None),
    };
    let mut holes = Vec::new();
    if let Some(failure) = failure {
        problem.get_or_insert(failure);
        if compression == "lz4" {
            let (blocks, missing) = lz4::decompress_whole_blocks(data, uncompressed_size, limit);
            if blocks.len() > content.len() {
                (content, holes) = (Owned(blocks), missing);
            }
        }
    }
    let most = zstd::most_from(data.len() as u64);
    if !compression.is_empty() && uncompressed_size > most {
        problem = Some(format!(
            "its header declares {uncompressed_size} bytes of content, too many for {} compressed bytes: at most {most} are \
             decompressed",
            data.len()
        ));
    } else if content.len() as u64 != uncompressed_size && compression != UNKNOWN {
        let more = if content.len() as u64 > uncompressed_size { "more: " } else { "" };
        let length = content.len();
        problem.get_or_insert(format!(
            "its header declares {uncompressed_size} bytes of uncompressed content, found {more}{length}"
        ));
    }
    // 0 means no checksum, as written by the real recorder.
    let is_checksum_wrong = checksum != 0 && crc32fast::hash(&content) != checksum;
    if is_checksum_wrong {
        problem.get_or_insert_with(|| "its content does not match its checksum".to_owned());
    }
    let times = (first <= last && last > 0).then_some((first, last));
    Unpacked { content, holes, problem, is_checksum_wrong, times }
}

const UNKNOWN: &str = "?";

fn owned<'a>((content, problem): (Vec<u8>, Option<String>)) -> (Cow<'a, [u8]>, Option<String>) {
    (Owned(content), problem)
}

/// The most bytes to decompress: what the header declares, if that is possible, and else what typical data
/// decompresses to, since the declaration may be what is damaged.
fn limit(declared: u64, compressed: u64) -> u64 {
    const TYPICAL_RATIO: u64 = 30;
    const ALWAYS: u64 = 64 * 1024;
    let typical = compressed.saturating_mul(TYPICAL_RATIO).saturating_add(ALWAYS);
    if declared <= zstd::most_from(compressed) { declared.max(typical) } else { typical }
}
