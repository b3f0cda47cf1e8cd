//! The same names where a process is asked to end by Ctrl-C only.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use signal_hook::consts::SIGINT;

/// How late a request may be noticed; several within this time are one.
const LOOK: Duration = Duration::from_millis(20);

pub(crate) fn on_signals(handle: impl Fn(i32) + Send + 'static) -> io::Result<()> {
    let is_set = Arc::new(AtomicBool::new(false));
    signal_hook::flag::register(SIGINT, Arc::clone(&is_set))?;
    let wait = move || {
        loop {
            thread::sleep(LOOK);
            if is_set.swap(false, Ordering::Relaxed) {
                handle(SIGINT);
            }
        }
    };
    thread::Builder::new().name("signals".to_owned()).spawn(wait).map(drop)
}

/// No signal asks what runs.
pub(super) fn asks_what_runs(_signal: i32) -> bool {
    false
}
