//! Files that rosbag2 compressed as a whole when they were full (`--compression-mode file`): `run_0.mcap.zstd`.

use std::io::{self, BufReader};

use super::source::{Source, Spool};
use crate::zstd;

/// What a Zstandard frame begins with (RFC 8878 section 3.1.1).
pub(super) const MAGIC: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];

/// More than that times its length no file of messages comes to.
const LARGEST_RATIO: u64 = 10_000;

/// Decompresses a file. Where that is not possible to the end, what came out is kept: how much, and the problem.
pub(super) fn unpack(packed: &Source) -> io::Result<(Source, Option<(u64, String)>)> {
    let limit = packed.length()?.saturating_mul(LARGEST_RATIO);
    let mut content = Spool::new();
    let too_many = || format!("it comes to more than {LARGEST_RATIO} times its length");
    let unpacked = zstd::unpack(&mut BufReader::new(packed.open()?), &mut content, limit, too_many);
    let content = content.into_source()?;
    let length = content.length()?;
    Ok((content, unpacked.err().map(|found| (length, found))))
}
