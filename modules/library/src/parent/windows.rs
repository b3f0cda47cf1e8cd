//! Processes of Windows, which has no signals: the end of a pipe says all.

use std::io;
use std::os::windows::process::CommandExt;
use std::process::{Child, Command};

/// Without an effect.
///
/// # Errors
/// None.
pub fn terminate_at_its_end() -> io::Result<()> {
    Ok(())
}

/// Starts a process in a group of its own: Ctrl-C in the terminal is for this process only.
pub fn in_own_group(command: &mut Command) -> &mut Command {
    const CREATE_NEW_PROCESS_GROUP: u32 = 0x200;
    command.creation_flags(CREATE_NEW_PROCESS_GROUP)
}

/// Asks a child to stop, by the end of its standard input.
pub fn ask_to_stop(child: &mut Child) {
    child.stdin = None;
}
