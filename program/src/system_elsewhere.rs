//! The same names where there is no Unix: what cannot be known stays unknown, and nothing is refused for it.

use std::fs::Metadata;
use std::path::Path;

pub(crate) fn identity_of_output() -> Option<String> {
    None
}

pub(crate) fn identity_of_error() -> Option<String> {
    None
}

pub(crate) fn raise_open_files(_needed: u64) -> u64 {
    u64::MAX
}

pub(crate) fn free_bytes(_folder: &Path) -> Option<u64> {
    None
}

pub(crate) fn may_read(_file: &Path) -> bool {
    true
}

pub(crate) fn may_write(_file: &Path) -> bool {
    true
}

/// The folder for temporary files belongs to the user here.
#[cfg(feature = "football")]
pub(crate) fn private_folder(prefix: &str) -> std::io::Result<tempfile::TempDir> {
    tempfile::Builder::new().prefix(prefix).tempdir()
}

pub(crate) fn mode_and_group(_metadata: &Metadata) -> (u32, u32) {
    (0, 0)
}

pub(crate) fn user() -> Option<u32> {
    None
}

pub(crate) fn highest_priority() -> u64 {
    0
}
