//! The child process, seen from the robot.

use super::wire::Channel;
use std::ffi::OsString;
use std::io::{self, Read};
use std::net::Shutdown;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
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
        let (own, its) = UnixStream::pair().map_err(failed)?;
        // In a group of its own: Ctrl-C is for the robot, which ends its children.
        let child =
            command.stdin(Stdio::from(OwnedFd::from(its))).process_group(0).spawn().map_err(failed)?;
        let mut process = Self { child, path: path.to_owned(), channel: Channel::new(own) };
        process.greet().map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => process.end("main"),
            _ => failed(io::Error::other(NOT_A_CHILD)),
        })?;
        Ok(process)
    }

    /// Waits until the child is ready for its first call.
    fn greet(&mut self) -> io::Result<()> {
        self.channel.stream.set_read_timeout(Some(PATIENCE))?;
        self.channel.receive()?;
        self.channel.stream.set_read_timeout(None)
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
        let stream = &mut self.channel.stream;
        let _ = stream.shutdown(Shutdown::Write);
        let _ = stream.set_read_timeout(Some(FAREWELL));
        // Its end closes the other end.
        if !matches!(stream.read(&mut [0]), Ok(0)) {
            let _ = self.child.kill();
        }
        let _ = self.child.wait();
    }
}
