//! Keys of the terminal, read one by one.

use std::io::{self, Read};
use std::sync::mpsc::{self, Receiver};

use parking_lot::Mutex;
use rustix::process::getpgrp;
use rustix::termios::{LocalModes, OptionalActions, Termios, tcgetattr, tcgetpgrp, tcsetattr};

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
pub(super) fn restore_terminal() {
    // In the background, the terminal belongs to another process, and changing it would halt this one
    // (SIGTTOU).
    if let Some(before) = BEFORE.lock().take().filter(|_| is_in_foreground()) {
        // A terminal that no longer exists need not be restored.
        let _ = tcsetattr(io::stdin(), OptionalActions::Now, &before);
    }
}

fn is_in_foreground() -> bool {
    tcgetpgrp(io::stdin()).is_ok_and(|group| group == getpgrp())
}

impl Keyboard {
    /// `None` if standard input is not a terminal, or another process is in its foreground.
    pub(crate) fn open() -> Option<Self> {
        let before = is_in_foreground().then(|| tcgetattr(io::stdin()).ok()).flatten()?;
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
