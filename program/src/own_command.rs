//! This program as a command, for processes of its own.

use std::path::PathBuf;
#[cfg(unix)]
use std::process::Command;

use anyhow::Context;

/// This program, as it was started, and its arguments before `command`: in Python it is an interpreter with a
/// script.
pub(crate) fn own_command(command: &str) -> anyhow::Result<(PathBuf, Vec<String>)> {
    let program = std::env::current_exe().context("cannot find this program")?;
    let is_interpreter = program.file_name().is_some_and(|name| name.to_string_lossy().starts_with("python"));
    let line: Vec<String> = std::fs::read("/proc/self/cmdline")
        .map(|line| {
            line.split(|&byte| byte == 0).map(|word| String::from_utf8_lossy(word).into_owned()).collect()
        })
        .unwrap_or_else(|_| std::env::args().collect());
    if !is_interpreter {
        return Ok((program, Vec::new()));
    }
    let mut line = line.into_iter();
    // In a virtual environment, the file of the program is the interpreter outside of it.
    let interpreter = line.next().filter(|name| !name.is_empty()).map_or(program, PathBuf::from);
    Ok((interpreter, line.take_while(|word| word != command).collect()))
}

/// This program with the command line with which it was started.
#[cfg(unix)]
pub(crate) fn this_command() -> anyhow::Result<Command> {
    let (program, script) = own_command("bag")?;
    let mut command = Command::new(program);
    command.args(script).args(std::env::args_os().skip_while(|word| word != "bag"));
    Ok(command)
}
