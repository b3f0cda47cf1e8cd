//! What only Unix tells about files and limits of a process. On other systems, `system_elsewhere.rs`.

use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use rustix::fs::{Access, Stat};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Device and inode of standard output, as `JOURNAL_STREAM` has them.
pub(crate) fn identity_of_output() -> Option<String> {
    rustix::fs::fstat(std::io::stdout()).ok().as_ref().map(identity)
}

/// The same of standard error.
pub(crate) fn identity_of_error() -> Option<String> {
    rustix::fs::fstat(std::io::stderr()).ok().as_ref().map(identity)
}

fn identity(status: &Stat) -> String {
    format!("{}:{}", status.st_dev, status.st_ino)
}

/// Raises the limit of open files to the `needed` number, as far as the system allows it. Returns the limit.
pub(crate) fn raise_open_files(needed: u64) -> u64 {
    let mut limit = getrlimit(Resource::Nofile);
    if limit.current.is_some_and(|current| current < needed) {
        let raised = Rlimit { current: Some(limit.maximum.unwrap_or(needed).min(needed)), ..limit };
        if setrlimit(Resource::Nofile, raised).is_ok() {
            limit.current = raised.current;
        }
    }
    limit.current.unwrap_or(u64::MAX)
}

/// The bytes that the user may still write to the disk of a folder.
pub(crate) fn free_bytes(folder: &Path) -> Option<u64> {
    let free = rustix::fs::statvfs(folder).ok()?;
    Some(free.f_bavail.saturating_mul(free.f_frsize))
}

/// Whether the user may read a file.
pub(crate) fn may_read(file: &Path) -> bool {
    rustix::fs::access(file, Access::READ_OK).is_ok()
}

/// Whether the user may read and write a file.
pub(crate) fn may_write(file: &Path) -> bool {
    rustix::fs::access(file, Access::READ_OK | Access::WRITE_OK).is_ok()
}

/// A folder for temporary files that other users cannot enter.
#[cfg(feature = "football")]
pub(crate) fn private_folder(prefix: &str) -> std::io::Result<tempfile::TempDir> {
    let private = std::os::unix::fs::PermissionsExt::from_mode(0o700);
    tempfile::Builder::new().prefix(prefix).permissions(private).tempdir()
}

/// The permission bits of a file, and the number of its group.
pub(crate) fn mode_and_group(metadata: &Metadata) -> (u32, u32) {
    (metadata.mode(), metadata.gid())
}

/// The number of the user.
pub(crate) fn user() -> Option<u32> {
    Some(rustix::process::getuid().as_raw())
}

/// The highest priority of `SCHED_FIFO` that the user may take; 0 for none.
#[cfg(target_os = "linux")]
pub(crate) fn highest_priority() -> u64 {
    const HIGHEST: u64 = 99;
    if rustix::process::geteuid().is_root() {
        return HIGHEST;
    }
    getrlimit(Resource::Rtprio).current.map_or(HIGHEST, |limit| limit.min(HIGHEST))
}

/// None: threads have no such priority on this system.
#[cfg(not(target_os = "linux"))]
pub(crate) fn highest_priority() -> u64 {
    0
}
