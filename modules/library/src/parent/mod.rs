//! Child processes that end with their parent, however that ends.
//!
//! A child holds a pipe whose other end is in its parent: its end is noticed on every system. On Linux, a
//! child also asks the system for a signal, which comes even if another process has inherited that end of the
//! pipe.

#[cfg_attr(unix, path = "unix.rs")]
#[cfg_attr(windows, path = "windows.rs")]
mod system;

use std::io;
use std::process::{Child, Command};
use std::sync::OnceLock;
use std::sync::mpsc::{Sender, channel};

#[cfg(unix)]
pub(crate) use system::end_with_it;
pub use system::{ask_to_stop, in_own_group, terminate_at_its_end};

type Request = (Command, Sender<io::Result<Child>>);

/// The thread that starts child processes.
static STARTER: OnceLock<Sender<Request>> = OnceLock::new();

/// Starts a child process from a thread that lives as long as this process. For [`terminate_at_its_end`],
/// Linux counts as the parent the *thread* that started the child.
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
