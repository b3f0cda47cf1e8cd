//! What the operating system offers for sockets of one user.

use std::fs::{self, DirBuilder};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};

pub(super) use std::os::unix::net::{UnixListener, UnixStream};

use super::error::DirectoryError;

/// The directory where the program looks for sockets.
pub(super) fn default_directory() -> PathBuf {
    let runtime = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
    match runtime.filter(|path| path.is_absolute()) {
        Some(runtime) => runtime.join("downbeat"),
        None => std::env::temp_dir().join(format!("downbeat-{}", user())),
    }
}

/// Creates a directory that only its user can access, if it does not exist, and checks that it is one.
pub(super) fn create_private(path: &Path) -> Result<(), DirectoryError> {
    let io_error = |source| DirectoryError::Io { path: path.to_owned(), source };
    match DirBuilder::new().mode(0o700).create(path) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(io_error(error)),
        Ok(()) | Err(_) => {}
    }
    // Does not follow a link, which another user may have created.
    let metadata = fs::symlink_metadata(path).map_err(io_error)?;
    if !metadata.is_dir() {
        return Err(io_error(io::ErrorKind::NotADirectory.into()));
    }
    let (owner, mode) = (metadata.uid(), metadata.mode() & 0o777);
    if owner != user() || mode & 0o077 != 0 {
        return Err(DirectoryError::NotPrivate { path: path.to_owned(), owner, mode });
    }
    Ok(())
}

/// Whether there is a process with this id.
pub(super) fn is_alive(pid: u32) -> bool {
    let pid = i32::try_from(pid).ok().and_then(rustix::process::Pid::from_raw);
    pid.is_some_and(|pid| rustix::process::test_kill_process(pid).is_ok())
}

fn user() -> u32 {
    rustix::process::getuid().as_raw()
}
