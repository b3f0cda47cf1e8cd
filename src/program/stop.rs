//! The end of long-running commands: Ctrl-C, SIGTERM, or a time limit.

use std::io::{self, Read};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Context;
use parking_lot::{Condvar, Mutex};
use rustix::process::getpgrp;
use rustix::termios::{LocalModes, OptionalActions, Termios, tcgetattr, tcgetpgrp, tcsetattr};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

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
                    restore_terminal();
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

    /// Also stops at the end of standard input, if the process that started this one keeps the other end of it: then this one ends with it,
    /// however that ends. If stopping takes longer than `patience`, the process exits.
    #[cfg(feature = "football")]
    pub(crate) fn at_end_of_input(self, patience: Duration) -> anyhow::Result<Self> {
        let signalled = Arc::clone(&self.signalled);
        let wait = move || {
            // Nothing is said, and an error is an end too.
            let _ = io::copy(&mut io::stdin().lock(), &mut io::sink());
            signalled.set();
            thread::sleep(patience);
            std::process::exit(1);
        };
        thread::Builder::new().name("input".to_owned()).spawn(wait).context("cannot watch standard input")?;
        Ok(self)
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
        *self.is_set.lock()
    }

    /// Returns whether it was set before.
    fn set(&self) -> bool {
        let before = std::mem::replace(&mut *self.is_set.lock(), true);
        self.changed.notify_all();
        before
    }

    fn wait_until(&self, until: Instant) {
        self.changed.wait_while_until(&mut self.is_set.lock(), |is_set| !*is_set, until);
    }
}

/// A key with a function in some command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Key {
    Space,
    Right,
    Up,
    Down,
}

/// Reads single keys until it is dropped. Ctrl-C still interrupts the program.
pub(crate) struct Keyboard {
    keys: Receiver<Key>,
}

/// The original state of the terminal while a [`Keyboard`] is open.
static BEFORE: Mutex<Option<Termios>> = Mutex::new(None);

/// Restores the terminal; also called when the process exits without dropping.
fn restore_terminal() {
    if let Some(before) = BEFORE.lock().take() {
        // A terminal that no longer exists need not be restored.
        let _ = tcsetattr(io::stdin(), OptionalActions::Now, &before);
    }
}

impl Keyboard {
    /// `None` if standard input is not a terminal, or another process is in its foreground.
    pub(crate) fn open() -> Option<Self> {
        let is_in_foreground = tcgetpgrp(io::stdin()).is_ok_and(|group| group == getpgrp());
        let before = is_in_foreground.then(|| tcgetattr(io::stdin()).ok()).flatten()?;
        let mut by_key = before.clone();
        by_key.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
        let (sender, keys) = mpsc::channel();
        *BEFORE.lock() = Some(before);
        let keyboard = Self { keys };
        tcsetattr(io::stdin(), OptionalActions::Now, &by_key).ok()?;
        let read = move || forward(io::stdin(), |key| sender.send(key).is_ok());
        // It waits for keys until the process exits.
        let started = std::thread::Builder::new().name("keyboard".to_owned()).spawn(read);
        started.is_ok().then_some(keyboard)
    }

    /// Returns a key pressed since the last call.
    pub(crate) fn pressed(&self) -> Option<Key> {
        self.keys.try_recv().ok()
    }
}

impl Drop for Keyboard {
    fn drop(&mut self) {
        restore_terminal();
    }
}

fn forward(mut input: impl Read, mut send: impl FnMut(Key) -> bool) {
    let (mut byte, mut sequence) = ([0], Vec::new());
    while input.read_exact(&mut byte).is_ok() {
        sequence.extend(byte);
        let key = match *sequence {
            // The start of the sequence of a cursor key (ECMA-48, CSI).
            [0x1b] | [0x1b, b'['] => continue,
            [0x1b, b'[', b'A'] => Some(Key::Up),
            [0x1b, b'[', b'B'] => Some(Key::Down),
            [0x1b, b'[', b'C'] => Some(Key::Right),
            [.., b' '] => Some(Key::Space),
            _ => None,
        };
        sequence.clear();
        if key.is_some_and(|key| !send(key)) {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cursor_keys_are_distinguished_from_others() {
        let mut keys = Vec::new();
        forward(&b"x \x1b[A\x1b[D\x1b[B\x1b \x1b[C[A"[..], |key| {
            keys.push(key);
            true
        });
        assert_eq!(keys, [Key::Space, Key::Up, Key::Down, Key::Space, Key::Right]);
    }
}
