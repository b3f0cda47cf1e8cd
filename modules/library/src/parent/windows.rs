//! Processes of Windows, which has no signals: closing the standard input of a child asks it to stop.

use std::io;
use std::os::windows::process::CommandExt;
use std::process::{Child, Command};

/// Does nothing: the end of the pipe to its parent says that the parent has ended.
///
/// # Errors
/// Never.
pub fn terminate_at_its_end() -> io::Result<()> {
    Ok(())
}

/// Starts a process in a group of its own: Ctrl-C in the terminal is for this process only.
pub fn in_own_group(command: &mut Command) -> &mut Command {
    const CREATE_NEW_PROCESS_GROUP: u32 = 0x200;
    command.creation_flags(CREATE_NEW_PROCESS_GROUP)
}

/// Asks a child to stop, by the end of its standard input: it has to be started with a pipe as standard
/// input, which the parent has not taken out of [`Child`], and to stop at its end.
pub fn ask_to_stop(child: &mut Child) {
    child.stdin = None;
}
