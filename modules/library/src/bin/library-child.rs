//! Runs the library of a module with `isolate`: for tests, and for programs that have a command line of their
//! own (`set_child_command`).

use std::process::ExitCode;

fn main() -> ExitCode {
    downbeat_library_host::child()
}
