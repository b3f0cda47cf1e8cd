//! Copies of the process as it is, for checkpoints.

#![expect(unsafe_code, reason = "the only way to a copy of a process")]

use std::io;

/// Which of the two processes this is.
pub(super) enum Forked {
    Original,
    Copy,
}

/// Makes a copy of this process, in which only the calling thread lives. Memory is shared until one of the
/// two writes to it.
///
/// A copy must end with [`end`]: what this process has, such as temporary files, is not the copy's to clean
/// up.
pub(super) fn fork() -> io::Result<Forked> {
    // SAFETY: engines run everything on the calling thread. A thread that another part of the process keeps,
    // such as that of a log file, does not live in the copy; a lock that it holds at this moment stays locked
    // there, which can halt the copy, but harms no memory. The C library handles the locks of its allocator.
    match unsafe { libc::fork() } {
        -1 => Err(io::Error::last_os_error()),
        0 => Ok(Forked::Copy),
        _ => Ok(Forked::Original),
    }
}

/// Ends a copy without cleaning up.
pub(super) fn end() -> ! {
    // SAFETY: ends the process at once, without running anything of it.
    unsafe { libc::_exit(0) }
}

/// Lets the system clean up after copies that end before this process.
pub(super) fn forget_copies() {
    use rustix::process::{WaitOptions, wait};
    while let Ok(Some(_)) = wait(WaitOptions::NOHANG) {}
}
