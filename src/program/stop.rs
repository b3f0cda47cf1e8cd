//! The end of long-running commands: Ctrl-C, SIGTERM, or a time limit.

use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Context;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

use super::keyboard;

/// A request to stop. A second signal ends the process at once.
pub(crate) struct Stop {
    signalled: Arc<Signalled>,
    end: Option<Instant>,
}

#[derive(Default)]
struct Signalled {
    is_set: Mutex<bool>,
    changed: Condvar,
}

impl Stop {
    /// Handles SIGINT and SIGTERM. Must be called before anything that requires cleanup.
    pub(crate) fn new() -> anyhow::Result<Self> {
        let problem = "cannot handle SIGINT and SIGTERM";
        let mut signals = Signals::new([SIGINT, SIGTERM]).context(problem)?;
        let signalled = Arc::new(Signalled::default());
        let of_thread = Arc::clone(&signalled);
        let wait = move || {
            for _ in signals.forever() {
                if of_thread.set() {
                    keyboard::restore_terminal();
                    signal_hook::low_level::exit(130);
                }
            }
        };
        thread::Builder::new().name("signals".to_owned()).spawn(wait).context(problem)?;
        Ok(Self { signalled, end: None })
    }

    /// Also stops after this time, counted from now.
    pub(crate) fn after(self, duration: Option<Duration>) -> Self {
        Self { end: duration.map(|duration| Instant::now() + duration), ..self }
    }

    pub(crate) fn is_due(&self) -> bool {
        self.signalled.get() || self.end.is_some_and(|end| Instant::now() >= end)
    }

    /// Sleeps for `time`, or until the stop request if that is earlier.
    pub(crate) fn sleep(&self, time: Duration) {
        let until = Instant::now() + time;
        self.signalled.wait_until(self.end.map_or(until, |end| end.min(until)));
    }
}

impl Signalled {
    fn get(&self) -> bool {
        *self.is_set.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns whether it was set before.
    fn set(&self) -> bool {
        let before =
            std::mem::replace(&mut *self.is_set.lock().unwrap_or_else(PoisonError::into_inner), true);
        self.changed.notify_all();
        before
    }

    fn wait_until(&self, until: Instant) {
        let mut is_set = self.is_set.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            let rest = until.saturating_duration_since(Instant::now());
            if *is_set || rest.is_zero() {
                return;
            }
            is_set = self.changed.wait_timeout(is_set, rest).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}
