//! Processes of Unix.

use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;
use rustix::process::{Pid, Signal, getpid, getppid, kill_process};
use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};
use signal_hook::iterator::Signals;
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command};
use std::time::Duration;

/// Lets the system ask this process to end in order when its parent ends, if the parent started it with
/// [`spawn`](super::spawn). Without an effect except on Linux.
///
/// # Errors
/// If the system refuses.
pub fn terminate_at_its_end() -> io::Result<()> {
    #[cfg(target_os = "linux")]
    rustix::process::set_parent_process_death_signal(Some(Signal::TERM))?;
    Ok(())
}

/// Starts a process in a group of its own: Ctrl-C in the terminal is for this process only.
pub fn in_own_group(command: &mut Command) -> &mut Command {
    command.process_group(0)
}

/// Asks a child to stop, as Ctrl-C does. A child that has ended is left alone.
///
/// Where there are no signals, the end of its standard input asks it: the child has to be started with a pipe
/// as standard input, which the parent has not taken out of [`Child`], and to stop at its end.
pub fn ask_to_stop(child: &mut Child) {
    // The number of one that has ended may be that of another process.
    if !matches!(child.try_wait(), Ok(None)) {
        return;
    }
    if let Some(pid) = i32::try_from(child.id()).ok().and_then(Pid::from_raw) {
        let _ = kill_process(pid, Signal::INT);
    }
}

/// Kills this process `grace` after the end of its parent, whatever its other threads do then; `pipe` is the
/// one whose other end is in the parent. Other signals that ask it to end are ignored: supervisors send them
/// to all processes of a service, and the parent ends this one.
pub(crate) fn end_with_it(pipe: OwnedFd, grace: Duration) -> io::Result<()> {
    let parent = getppid();
    let mut signals = Signals::new([SIGTERM, SIGINT, SIGHUP, SIGQUIT])?;
    terminate_at_its_end()?;
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
