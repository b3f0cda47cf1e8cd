//! The child process, seen from the robot.

use super::wire::Channel;
use crate::parent;
use parking_lot::{Condvar, Mutex};
use std::ffi::OsString;
use std::io::{self, PipeReader, Read, pipe};
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::sync::mpsc::channel;
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How long a child may take to destroy its module before it is killed.
pub(super) const FAREWELL: Duration = Duration::from_secs(1);

const NOT_A_CHILD: &str = "its program does not run libraries; let it run `downbeat::App::main`, or call `set_child_command` before";

static COMMAND: OnceLock<Vec<OsString>> = OnceLock::new();

/// How long a child may take to start, to set its module up, or for a transition: it may read files, and the
/// machine may be busy.
pub(super) const PATIENCE: Duration = Duration::from_secs(20);

/// The command of the program that calls [`child`](super::child).
const ARGUMENT: &str = "library-child";

/// Sets the command that starts a child process: a program and its arguments, which calls
/// [`child`](super::child). The default is the program itself with the argument `library-child`, which the
/// command line of downbeat knows; a program with a command line of its own sets another. It is the same for
/// the whole process; the first call counts.
pub fn set_child_command(command: impl IntoIterator<Item = OsString>) {
    let _ = COMMAND.set(command.into_iter().collect());
}

/// A child process and the channel to it.
pub(super) struct Process {
    watched: Arc<Watched>,
    watch: Option<JoinHandle<()>>,
    path: PathBuf,
    pub channel: Channel,
}

/// A child, which is killed if a call takes too long. That closes its ends of the pipes, and ends the wait
/// for it.
struct Watched {
    child: Mutex<Child>,
    call: Mutex<Call>,
    changed: Condvar,
}

/// The call under way.
#[derive(Default)]
struct Call {
    /// `None` between calls.
    deadline: Option<Instant>,
    /// Whether the child was killed because a call took too long.
    is_overdue: bool,
    /// When the watching thread looks at the deadline by itself; `None` if it sleeps until it is woken.
    next_look: Option<Instant>,
    is_over: bool,
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
        parent::in_own_group(&mut command).stdin(its_input).stdout(its_output);
        let child = parent::spawn(command).map_err(failed)?;
        let greeted = read_within(reader, PATIENCE);
        let is_ready = greeted.as_ref().is_some_and(|(_, read)| *read > 0);
        let channel = match greeted {
            Some((reader, _)) => Channel::new(reader, writer),
            None => Channel::closed(),
        };
        let (call, changed) = (Mutex::default(), Condvar::new());
        let watched = Arc::new(Watched { child: Mutex::new(child), call, changed });
        let mut process = Self { watched: Arc::clone(&watched), watch: None, path: path.to_owned(), channel };
        let watch = std::thread::Builder::new().name("child".to_owned()).spawn(move || watched.watch());
        process.watch = Some(watch.map_err(failed)?);
        match is_ready {
            true => Ok(process),
            false => Err(format!("{} ({NOT_A_CHILD})", process.end("`main`", PATIENCE))),
        }
    }

    pub fn id(&self) -> u32 {
        self.watched.child.lock().id()
    }

    /// A call begins, which may take this long.
    pub fn begin(&self, limit: Duration) {
        let mut call = self.watched.call.lock();
        let deadline = Instant::now() + limit;
        call.deadline = Some(deadline);
        // It may still sleep until the deadline of an earlier call that was given longer, such as `setup`.
        if call.next_look.is_none_or(|next| deadline < next) {
            self.watched.changed.notify_one();
        }
    }

    /// The call has ended, or waits for the robot.
    pub fn pause(&self) {
        self.watched.call.lock().deadline = None;
    }

    /// Ends the child. Returns why it does not answer the call of `function`, for which it had `limit`.
    pub fn end(&mut self, function: &str, limit: Duration) -> String {
        let is_overdue = self.watched.call.lock().is_overdue;
        let mut child = self.watched.child.lock();
        let (id, path) = (child.id(), self.path.display());
        // Without an effect on one that has ended.
        let _ = child.kill();
        match child.wait() {
            Ok(_) if is_overdue => format!(
                "the child process {id} of {path} did not return from {function} within {limit:?} and was killed"
            ),
            Ok(status) => format!("the child process {id} of {path} ended in {function}: {status}"),
            Err(error) => format!("the child process {id} of {path} ended in {function}: {error}"),
        }
    }
}

impl Watched {
    /// The watching thread. It wakes when a deadline may be over, and not while there are no calls.
    fn watch(&self) {
        let mut call = self.call.lock();
        while !call.is_over {
            match call.deadline {
                None => {
                    call.next_look = None;
                    self.changed.wait(&mut call);
                }
                Some(deadline) if Instant::now() < deadline => {
                    call.next_look = Some(deadline);
                    self.changed.wait_until(&mut call, deadline);
                }
                Some(_) => {
                    call.deadline = None;
                    call.is_overdue = true;
                    // It may have ended by itself.
                    let _ = self.child.lock().kill();
                }
            }
        }
    }
}

impl Drop for Process {
    /// Lets the child destroy its module.
    fn drop(&mut self) {
        let reader = self.channel.close();
        // Its end closes the other end.
        let has_ended = reader.is_none_or(|reader| matches!(read_within(reader, FAREWELL), Some((_, 0))));
        self.watched.call.lock().is_over = true;
        self.watched.changed.notify_one();
        if let Some(watch) = self.watch.take() {
            // It does not panic.
            let _ = watch.join();
        }
        let mut child = self.watched.child.lock();
        if !has_ended {
            let _ = child.kill();
        }
        let _ = child.wait();
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
