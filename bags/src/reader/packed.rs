//! Files that rosbag2 compressed as a whole (`--compression-mode file`): `run_0.mcap.zstd`.

use std::io::{self, BufReader};

use super::source::{Source, Spool};
use crate::zstd;

/// The magic number of a Zstandard frame (RFC 8878 section 3.1.1).
pub(super) const MAGIC: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];

/// No file of messages decompresses to more than this times its length.
const LARGEST_RATIO: u64 = 10_000;
/// The limit for files that decompress to more than `ALWAYS` bytes, before they fill the disk.
const LARGEST_RATIO_OF_LARGE: u64 = 100;
const ALWAYS: u64 = 1 << 30;

/// Decompresses a file. If it is damaged, keeps the data before the error, and returns its length and the
/// problem.
pub(super) fn unpack(packed: &Source) -> io::Result<(Source, Option<(u64, String)>)> {
    let length = packed.length()?;
    let of_large = length.saturating_mul(LARGEST_RATIO_OF_LARGE).max(ALWAYS);
    let limit = length.saturating_mul(LARGEST_RATIO).min(of_large);
    let mut content = Spool::new();
    let too_many = || format!("it decompresses to more than {} times its length", limit / length.max(1));
    let unpacked = zstd::unpack(&mut BufReader::new(packed.open()?), &mut content, limit, too_many);
    let content = content.into_source()?;
    let length = content.length()?;
    Ok((content, unpacked.err().map(|found| (length, found))))
}
