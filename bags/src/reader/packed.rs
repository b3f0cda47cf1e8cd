//! Files that rosbag2 compressed as a whole when they were full (`--compression-mode file`): `run_0.mcap.zstd`.

use std::fs::File;
use std::io::{BufReader, BufWriter, Write};
use std::path::Path;

use tempfile::{NamedTempFile, TempPath};

use super::error::ReaderError;
use crate::zstd;

/// What a Zstandard frame begins with (RFC 8878 section 3.1.1).
pub(super) const MAGIC: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];

/// More than that times its length no file of messages comes to.
const LARGEST_RATIO: u64 = 10_000;

/// Decompresses a file into a temporary one. Where that is not possible to the end, what came out is kept: how much, and
/// the problem.
pub(super) fn unpack(path: &Path) -> Result<(TempPath, Option<(u64, String)>), ReaderError> {
    let failed = |source| ReaderError::Read { path: path.to_owned(), source };
    let file = File::open(path).map_err(failed)?;
    let limit = file.metadata().map_err(failed)?.len().saturating_mul(LARGEST_RATIO);
    let mut content = BufWriter::new(NamedTempFile::new().map_err(failed)?);
    let too_many = || format!("it comes to more than {LARGEST_RATIO} times its length");
    let unpacked = zstd::unpack(&mut BufReader::new(file), &mut content, limit, too_many);
    content.flush().map_err(failed)?;
    let content = content.into_inner().map_err(|error| failed(error.into_error()))?;
    let length = content.as_file().metadata().map_err(failed)?.len();
    Ok((content.into_temp_path(), unpacked.err().map(|found| (length, found))))
}
