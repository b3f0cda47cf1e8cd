//! The child process, seen from the robot.

use super::wire::Channel;
use std::ffi::OsString;
use std::io::{self, PipeReader, Read, pipe};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::sync::OnceLock;
use std::sync::mpsc::channel;
use std::time::Duration;

/// How long a child may take to destroy its module before it is killed.
const FAREWELL: Duration = Duration::from_secs(1);

const NOT_A_CHILD: &str = "its program does not run libraries; let it run `downbeat::App::main`, or call `set_child_command` before";

static COMMAND: OnceLock<Vec<OsString>> = OnceLock::new();

/// How long a child may take to start, on a busy machine.
const PATIENCE: Duration = Duration::from_secs(20);

/// The command of the program that calls [`child`](super::child).
const ARGUMENT: &str = "library-child";

/// Sets the command that starts a child process: a program and its arguments, which calls [`child`](super::child). The default is
/// the program itself with the argument `library-child`, which the command line of downbeat knows; a program with a command line
/// of its own sets another. It is the same for the whole process; the first call counts.
pub fn set_child_command(command: impl IntoIterator<Item = OsString>) {
    let _ = COMMAND.set(command.into_iter().collect());
}

/// A child process and the channel to it.
pub(super) struct Process {
    child: Child,
    path: PathBuf,
    pub channel: Channel,
}

impl Process {
    pub fn start(path: &Path) -> Result<Self, String> {
        let failed =
            |error: io::Error| format!("cannot start a child process for {}: {error}", path.display());
        // A program that does not know the command would start itself again and again.
        if std::env::args_os().any(|argument| argument == ARGUMENT) {
            return Err(failed(io::Error::other(NOT_A_CHILD)));
        }
        let mut command = match COMMAND.get().map(Vec::as_slice) {
            Some([program, arguments @ ..]) => {
                let mut command = Command::new(program);
                command.args(arguments);
                command
            }
            _ => {
                let mut command = Command::new(std::env::current_exe().map_err(failed)?);
                command.arg(ARGUMENT);
                command
            }
        };
        let (its_input, writer) = pipe().map_err(failed)?;
        let (reader, its_output) = pipe().map_err(failed)?;
        // In a group of its own: Ctrl-C is for the robot, which ends its children.
        let child = command.stdin(its_input).stdout(its_output).process_group(0).spawn().map_err(failed)?;
        // With it the child's ends of the pipes, so that its death is noticed.
        drop(command);
        let greeted = read_within(reader, PATIENCE);
        let is_ready = greeted.as_ref().is_some_and(|(_, read)| *read > 0);
        let channel = match greeted {
            Some((reader, _)) => Channel::new(reader, writer),
            None => Channel::closed(),
        };
        let mut process = Self { child, path: path.to_owned(), channel };
        match is_ready {
            true => Ok(process),
            false => Err(format!("{} ({NOT_A_CHILD})", process.end("main"))),
        }
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Why the child does not answer.
    pub fn end(&mut self, function: &str) -> String {
        let (id, path) = (self.id(), self.path.display());
        // Without an effect on one that has ended.
        let _ = self.child.kill();
        match self.child.wait() {
            Ok(status) => format!("the child process {id} of {path} ended in `{function}`: {status}"),
            Err(error) => format!("the child process {id} of {path} ended in `{function}`: {error}"),
        }
    }
}

impl Drop for Process {
    /// Lets the child destroy its module.
    fn drop(&mut self) {
        let reader = self.channel.close();
        // Its end closes the other end.
        let has_ended = reader.is_none_or(|reader| matches!(read_within(reader, FAREWELL), Some((_, 0))));
        if !has_ended {
            let _ = self.child.kill();
        }
        let _ = self.child.wait();
    }
}

/// Waits for the next bytes, at most four, or for the end of the pipe, which counts as none.
fn read_within(mut reader: PipeReader, patience: Duration) -> Option<(PipeReader, usize)> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        let read = reader.read(&mut [0; 4]).unwrap_or(0);
        let _ = sender.send((reader, read));
    });
    receiver.recv_timeout(patience).ok()
}
