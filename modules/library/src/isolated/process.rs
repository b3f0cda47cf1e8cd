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

static COMMAND: OnceLock<Vec<OsString>> = OnceLock::new();

/// Sets the command that starts a child process: a program and its arguments, which calls [`child`](super::child). The default is
/// the program itself with the argument `library-child`. It is the same for the whole process; the first call counts.
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
        let mut command = match COMMAND.get().map(Vec::as_slice) {
            Some([program, arguments @ ..]) => {
                let mut command = Command::new(program);
                command.args(arguments);
                command
            }
            _ => {
                let mut command = Command::new(std::env::current_exe().map_err(failed)?);
                command.arg("library-child");
                command
            }
        };
        let (own, its) = UnixStream::pair().map_err(failed)?;
        // In a group of its own: Ctrl-C is for the robot, which ends its children.
        let child =
            command.stdin(Stdio::from(OwnedFd::from(its))).process_group(0).spawn().map_err(failed)?;
        Ok(Self { child, path: path.to_owned(), channel: Channel::new(own) })
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Why the child does not answer.
    pub fn end(&mut self, function: &str, error: &io::Error) -> String {
        let (id, path) = (self.id(), self.path.display());
        if error.kind() != io::ErrorKind::UnexpectedEof && error.kind() != io::ErrorKind::BrokenPipe {
            let _ = self.child.kill();
        }
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
