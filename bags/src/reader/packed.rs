//! Files that rosbag2 compressed as a whole when they were full (`--compression-mode file`): `run_0.mcap.zstd`.

use std::io::{self, BufReader};

use super::source::{Source, Spool};
use crate::zstd;

/// What a Zstandard frame begins with (RFC 8878 section 3.1.1).
pub(super) const MAGIC: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];

/// More than that times its length no file of messages comes to,
const LARGEST_RATIO: u64 = 10_000;
/// and if it comes to more than `ALWAYS` bytes no more than that: a disk is filled sooner than a lie is noticed.
const LARGEST_RATIO_OF_LARGE: u64 = 100;
const ALWAYS: u64 = 1 << 30;

/// Decompresses a file. Where that is not possible to the end, what came out is kept: how much, and the problem.
pub(super) fn unpack(packed: &Source) -> io::Result<(Source, Option<(u64, String)>)> {
    let length = packed.length()?;
    let of_large = length.saturating_mul(LARGEST_RATIO_OF_LARGE).max(ALWAYS);
    let limit = length.saturating_mul(LARGEST_RATIO).min(of_large);
    let mut content = Spool::new();
    let too_many = || format!("it comes to more than {} times its length", limit / length.max(1));
    let unpacked = zstd::unpack(&mut BufReader::new(packed.open()?), &mut content, limit, too_many);
    let content = content.into_source()?;
    let length = content.length()?;
    Ok((content, unpacked.err().map(|found| (length, found))))
}
