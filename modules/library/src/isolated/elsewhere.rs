//! The same names where a process cannot exchange its standard input and output: libraries run in the process
//! of the robot.

use crate::LibraryOptions;
use downbeat_edge::foreign::Foreign;
use std::ffi::OsString;
use std::process::ExitCode;

const UNSUPPORTED: &str = "libraries run in child processes on Linux and macOS only; here leave \"isolate\" out, and they run in the process of the robot";

/// Says that there are no child processes for libraries on this system.
#[must_use]
pub fn child() -> ExitCode {
    eprintln!("downbeat: {UNSUPPORTED}");
    ExitCode::FAILURE
}

/// Does nothing: libraries cannot run in child processes here.
pub fn set_child_command(_command: impl IntoIterator<Item = OsString>) {}

pub(crate) fn start(options: &LibraryOptions) -> Result<Box<dyn Foreign>, String> {
    Err(format!("cannot start a child process for {}: {UNSUPPORTED}", options.path.display()))
}
