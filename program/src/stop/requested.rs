//! What the process was asked for, and what that means for its output.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use parking_lot::{Condvar, Mutex};

use super::requests::Requests;

/// The requests of the process.
pub(super) static REQUESTED: Requested =
    Requested { requests: Mutex::new(Requests::NONE), is_set: Mutex::new(false), changed: Condvar::new() };

/// Whether signals are handled, or why not.
pub(super) static HANDLED: OnceLock<Result<(), String>> = OnceLock::new();

/// Whether the command has nothing to do once nobody reads its output.
pub(super) static ENDS_WITH_OUTPUT: AtomicBool = AtomicBool::new(false);

pub(super) struct Requested {
    pub(super) requests: Mutex<Requests>,
    pub(super) is_set: Mutex<bool>,
    pub(super) changed: Condvar,
}

impl Requested {
    pub(super) fn set(&self) {
        *self.is_set.lock() = true;
        self.changed.notify_all();
    }
}

/// Whether the command handles requests to stop.
pub(crate) fn is_handled() -> bool {
    matches!(HANDLED.get(), Some(Ok(())))
}

/// What a failed write to standard output means for the process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum OutputEnd {
    /// No command waits for a stop: the process can end.
    Exit,
    /// The command was asked to stop, or does not depend on its output.
    Continue,
}

/// Standard output cannot be written; `is_unread` if what read it has gone. A pipe that nobody reads ends
/// every command, as it ends `yes | head`; a terminal that was closed, or a full disk, only ends those that
/// do nothing but print.
pub(crate) fn output_failed(is_unread: bool) -> OutputEnd {
    if !is_handled() {
        return OutputEnd::Exit;
    }
    if is_unread || ENDS_WITH_OUTPUT.load(Ordering::Relaxed) {
        REQUESTED.set();
    }
    OutputEnd::Continue
}
