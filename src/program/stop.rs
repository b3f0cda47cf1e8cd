//! When a command that goes on by itself ends: Ctrl-C, SIGTERM, or its time is over.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context;
use signal_hook::consts::{SIGINT, SIGTERM};

/// Asks for the end. A second signal ends the process at once.
pub(crate) struct Stop {
    signalled: Arc<AtomicBool>,
    end: Option<Instant>,
}

impl Stop {
    /// Takes over SIGINT and SIGTERM: to be done before others can see what has to be left in order.
    pub(crate) fn new() -> anyhow::Result<Self> {
        let signalled = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM] {
            // The order matters: the first signal finds the flag unset, sets it, and only a second one exits.
            signal_hook::flag::register_conditional_shutdown(signal, 130, Arc::clone(&signalled))
                .and_then(|_| signal_hook::flag::register(signal, Arc::clone(&signalled)))
                .context("cannot handle SIGINT and SIGTERM")?;
        }
        Ok(Self { signalled, end: None })
    }

    /// Ends after this time as well, counted from now.
    pub(crate) fn after(self, duration: Option<Duration>) -> Self {
        Self { end: duration.map(|duration| Instant::now() + duration), ..self }
    }

    pub(crate) fn is_due(&self) -> bool {
        self.signalled.load(Ordering::SeqCst) || self.end.is_some_and(|end| Instant::now() >= end)
    }

    /// Sleeps for `time`, or until the end if that comes first.
    pub(crate) fn sleep(&self, time: Duration) {
        let until = Instant::now() + time;
        while !self.is_due() {
            // A signal sets a flag and wakes nobody: look at it now and then.
            let rest = until.saturating_duration_since(Instant::now()).min(Duration::from_millis(50));
            let rest = self.end.map_or(rest, |end| rest.min(end.saturating_duration_since(Instant::now())));
            if rest.is_zero() {
                return;
            }
            std::thread::sleep(rest);
        }
    }
}
