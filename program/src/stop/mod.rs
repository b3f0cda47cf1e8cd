//! The end of long-running commands: signals, a time limit, or the end of what started them.
//!
//! | request | effect |
//! | --- | --- |
//! | SIGINT, SIGTERM, SIGHUP | an orderly stop; all requests within [`ONE_REQUEST`] of the first are the same request. A command that waits for its standard output for that long ends as by a later one |
//! | SIGQUIT | the same, after printing what runs |
//! | a later one | the process closes its bags, leaves DDS and ends, within [`HURRY`] |
//! | a third one | the process ends at once |
//!
//! After an orderly stop the exit code is that of the command; otherwise it is 128 plus the number of the
//! last signal, as shells report it.

mod hurry;
mod keyboard;
pub(crate) mod requested;
mod requests;
#[cfg_attr(not(unix), path = "signals_elsewhere.rs")]
mod signals;
mod trace;

use std::io;
use std::sync::atomic::Ordering;
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Context;

use super::output;
#[cfg(doc)]
use hurry::HURRY;
use keyboard::restore_terminal;
pub(crate) use keyboard::{Key, Keyboard};
use requested::{ENDS_WITH_OUTPUT, HANDLED, REQUESTED};
use requests::{Meaning, ONE_REQUEST};
pub(super) use signals::on_signals;

/// A request to stop. All values share the requests of the process.
pub(crate) struct Stop {
    end: Option<Instant>,
}

impl Stop {
    /// Handles signals. Must be called before anything that requires cleanup.
    pub(crate) fn new() -> anyhow::Result<Self> {
        let handled = HANDLED.get_or_init(|| handle_signals().map_err(|error| error.to_string()));
        handled.clone().map_err(anyhow::Error::msg).context("cannot handle signals")?;
        Ok(Self { end: None })
    }

    /// Also stops after this time, counted from now.
    pub(crate) fn after(self, duration: Option<Duration>) -> Self {
        Self { end: duration.map(|duration| Instant::now() + duration) }
    }

    /// Also stops when standard output cannot be written: for commands that only print.
    pub(crate) fn at_end_of_output(self) -> Self {
        ENDS_WITH_OUTPUT.store(true, Ordering::Relaxed);
        self
    }

    /// Also stops at the end of the process that started this one, however that ends: that process keeps the
    /// other end of standard input. If stopping takes longer than `patience`, this process ends in a hurry.
    #[cfg(any(feature = "football", feature = "view"))]
    pub(crate) fn with_parent(self, patience: Duration) -> anyhow::Result<Self> {
        downbeat_library_host::parent::terminate_at_its_end()
            .context("cannot watch the process that started this one")?;
        let wait = move || {
            // Nothing is said, and an error is an end too.
            let _ = io::copy(&mut io::stdin().lock(), &mut io::sink());
            // On Linux a signal comes as well, which is then the same request.
            if REQUESTED.requests.lock().begin(Instant::now()) {
                REQUESTED.set();
            }
            thread::sleep(patience);
            hurry::end(1);
        };
        thread::Builder::new().name("input".to_owned()).spawn(wait).context("cannot watch standard input")?;
        Ok(self)
    }

    pub(crate) fn is_due(&self) -> bool {
        *REQUESTED.is_set.lock() || self.end.is_some_and(|end| Instant::now() >= end)
    }

    /// Sleeps for `time`, or until the stop request if that is earlier.
    pub(crate) fn sleep(&self, time: Duration) {
        let until = Instant::now() + time;
        let until = self.end.map_or(until, |end| end.min(until));
        REQUESTED.changed.wait_while_until(&mut REQUESTED.is_set.lock(), |is_set| !*is_set, until);
    }
}

fn handle_signals() -> io::Result<()> {
    on_signals(|signal| {
        let meaning = REQUESTED.requests.lock().take(Instant::now());
        if meaning != Meaning::End && signals::asks_what_runs(signal) {
            print_trace();
        }
        match meaning {
            Meaning::Stop => {
                REQUESTED.set();
                in_background("output", move || end_if_halted(128 + signal));
            }
            Meaning::Same => {}
            Meaning::Hurry => in_background("hurry", move || hurry::end(128 + signal)),
            Meaning::End => end_now(128 + signal),
        }
    })
}

/// Ends the process if the command does not notice the request, since it writes to a terminal that was halted
/// or a pipe that nobody reads.
fn end_if_halted(code: i32) {
    let begun = output::write_in_progress();
    thread::sleep(ONE_REQUEST);
    if begun.is_some() && output::write_in_progress() == begun {
        hurry::end(code);
    }
}

/// Prints what runs, before the stop begins. A terminal that takes no output does not keep it waiting.
fn print_trace() {
    const PATIENCE: Duration = Duration::from_millis(100);
    let (sender, printed) = mpsc::channel();
    in_background("trace", move || {
        trace::print();
        // If nobody waits any more, it has taken too long.
        let _ = sender.send(());
    });
    let _ = printed.recv_timeout(PATIENCE);
}

/// Runs `task` while this thread waits for further signals.
fn in_background(name: &str, task: impl FnOnce() + Send + 'static) {
    if let Err(error) = thread::Builder::new().name(name.to_owned()).spawn(task) {
        output::print_error(format_args!("downbeat: cannot start a thread: {error}\n"));
    }
}

/// Ends the process without waiting for anything.
pub(super) fn end_now(code: i32) -> ! {
    restore_terminal();
    signal_hook::low_level::exit(code)
}
