//! The signals that ask a process to end. On other systems than Unix, `signals_elsewhere.rs`.

use std::io;
use std::thread;

use signal_hook::consts::{SIGHUP, SIGINT, SIGQUIT, SIGTERM};
use signal_hook::iterator::Signals;

/// Handles the signals that ask a process to end, except a SIGHUP that whoever started this process wants to
/// be ignored (`nohup`).
pub(crate) fn on_signals(handle: impl Fn(i32) + Send + 'static) -> io::Result<()> {
    let all = [SIGINT, SIGTERM, SIGQUIT, SIGHUP];
    let handled = all.into_iter().filter(|&signal| signal != SIGHUP || !is_ignored(signal));
    let mut signals = Signals::new(handled)?;
    let wait = move || signals.forever().for_each(handle);
    thread::Builder::new().name("signals".to_owned()).spawn(wait).map(drop)
}

/// Whether the signal also asks what runs.
pub(super) fn asks_what_runs(signal: i32) -> bool {
    signal == SIGQUIT
}

/// Whether the process was started with this signal ignored. Safe code can find out on Linux only.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask & (1 << (signal - 1)) != 0
}
