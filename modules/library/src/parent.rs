//! Child processes that end with their parent, however that ends.
//!
//! A child holds a pipe whose other end is in its parent: its end is noticed on every system. On Linux, a
//! child also asks the system for a signal, which comes even if another process has inherited that end of the
//! pipe.

use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;
use rustix::process::{Signal, getpid, getppid, kill_process};
use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};
use signal_hook::iterator::Signals;
use std::io;
use std::os::fd::OwnedFd;
use std::process::{Child, Command};
use std::sync::OnceLock;
use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

/// Asks a process to end in order.
pub const TERMINATE: Signal = Signal::TERM;

type Request = (Command, Sender<io::Result<Child>>);

/// The thread that starts child processes.
static STARTER: OnceLock<Sender<Request>> = OnceLock::new();

/// Starts a child process from a thread that lives as long as this process. For [`signal_at_its_end`], Linux
/// counts as the parent the *thread* that started the child.
///
/// # Errors
/// If the process, or the thread, cannot be started.
pub fn spawn(command: Command) -> io::Result<Child> {
    let starter = match STARTER.get() {
        Some(starter) => starter,
        None => {
            let (sender, requests) = channel::<Request>();
            let start = move || {
                for (mut command, answer) in requests {
                    let started = command.spawn();
                    // With it the child's ends of pipes, so that its death is noticed.
                    drop(command);
                    // If nobody waits any more, the child has no parent that would end it.
                    if let Err(unsent) = answer.send(started)
                        && let Ok(mut child) = unsent.0
                    {
                        let _ = child.kill();
                        let _ = child.wait();
                    }
                }
            };
            std::thread::Builder::new().name("children".to_owned()).spawn(start)?;
            // If another thread was faster, the thread above ends with its sender.
            STARTER.get_or_init(|| sender)
        }
    };
    let (sender, answer) = channel();
    let ended = |_| io::Error::other("the thread that starts child processes has ended");
    starter.send((command, sender)).map_err(|_| ended(()))?;
    answer.recv().map_err(|_| ended(()))?
}

/// Lets the system signal this process when its parent ends, if the parent started it with [`spawn`]. Without
/// an effect except on Linux.
///
/// # Errors
/// If the system refuses.
pub fn signal_at_its_end(signal: Signal) -> io::Result<()> {
    #[cfg(target_os = "linux")]
    rustix::process::set_parent_process_death_signal(Some(signal))?;
    #[cfg(not(target_os = "linux"))]
    let _ = signal;
    Ok(())
}

/// Kills this process `grace` after the end of its parent, whatever its other threads do then; `pipe` is the
/// one whose other end is in the parent. Other signals that ask it to end are ignored: supervisors send them
/// to all processes of a service, and the parent ends this one.
pub(crate) fn end_with_it(pipe: OwnedFd, grace: Duration) -> io::Result<()> {
    let parent = getppid();
    let mut signals = Signals::new([SIGTERM, SIGINT, SIGHUP, SIGQUIT])?;
    signal_at_its_end(TERMINATE)?;
    let end = move || {
        std::thread::sleep(grace);
        // Not an exit, which would run handlers of the library.
        let _ = kill_process(getpid(), Signal::KILL);
    };
    let hear = move || {
        // A process without its parent has another one.
        if signals.forever().any(|_| getppid() != parent) {
            end();
        }
    };
    let watch = move || {
        // The end of the pipe is reported without being asked for.
        let mut ends = [PollFd::new(&pipe, PollFlags::empty())];
        while matches!(poll(&mut ends, None), Ok(0) | Err(Errno::INTR)) {}
        end();
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(hear)?;
    std::thread::Builder::new().name("parent".to_owned()).spawn(watch)?;
    Ok(())
}
