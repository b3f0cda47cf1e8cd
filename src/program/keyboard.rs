//! Keys that are pressed while a command runs.

use std::io::{self, Read};
use std::sync::mpsc::{self, Receiver};
use std::sync::{Mutex, PoisonError};

use rustix::process::getpgrp;
use rustix::termios::{LocalModes, OptionalActions, Termios, tcgetattr, tcgetpgrp, tcsetattr};

/// A key that means something to some command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Key {
    Space,
    Right,
    Up,
    Down,
}

/// Gives each key as it is pressed, until it is dropped. The terminal still ends the program with Ctrl-C.
pub(crate) struct Keyboard {
    keys: Receiver<Key>,
}

/// How the terminal was while a [`Keyboard`] is open.
static BEFORE: Mutex<Option<Termios>> = Mutex::new(None);

/// Makes the terminal as it was: also for an end of the process that drops nothing.
pub(crate) fn restore_terminal() {
    if let Some(before) = BEFORE.lock().unwrap_or_else(PoisonError::into_inner).take() {
        // A terminal that is gone needs no repair.
        let _ = tcsetattr(io::stdin(), OptionalActions::Now, &before);
    }
}

impl Keyboard {
    /// Nothing where standard input is no terminal, or one that another process has in the foreground.
    pub(crate) fn open() -> Option<Self> {
        let is_in_foreground = tcgetpgrp(io::stdin()).is_ok_and(|group| group == getpgrp());
        let before = is_in_foreground.then(|| tcgetattr(io::stdin()).ok()).flatten()?;
        let mut by_key = before.clone();
        by_key.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
        let (sender, keys) = mpsc::channel();
        *BEFORE.lock().unwrap_or_else(PoisonError::into_inner) = Some(before);
        let keyboard = Self { keys };
        tcsetattr(io::stdin(), OptionalActions::Now, &by_key).ok()?;
        let read = move || forward(io::stdin(), |key| sender.send(key).is_ok());
        // It waits for keys until the process ends.
        let started = std::thread::Builder::new().name("keyboard".to_owned()).spawn(read);
        started.is_ok().then_some(keyboard)
    }

    /// A key that was pressed since the last look.
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
            // The beginning of what a cursor key sends (ECMA-48, CSI).
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
    fn cursor_keys_are_told_from_others() {
        let mut keys = Vec::new();
        forward(&b"x \x1b[A\x1b[D\x1b[B\x1b \x1b[C[A"[..], |key| {
            keys.push(key);
            true
        });
        assert_eq!(keys, [Key::Space, Key::Up, Key::Down, Key::Space, Key::Right]);
    }
}
