//! Single keys from a terminal of Unix. On other systems, `terminal_elsewhere.rs`.

use std::io::{self, Read};

use parking_lot::Mutex;
use rustix::process::getpgrp;
use rustix::termios::{LocalModes, OptionalActions, Termios, tcgetattr, tcgetpgrp, tcsetattr};

use super::key::Key;

/// The original state of the terminal while its keys are read.
static BEFORE: Mutex<Option<Termios>> = Mutex::new(None);

/// Restores the terminal; also called when the process exits without dropping.
pub(in crate::stop) fn restore_terminal() {
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

/// Lets the terminal pass on single keys. `None` if standard input is not a terminal, or another process is
/// in its foreground.
pub(super) fn prepare() -> Option<()> {
    let before = is_in_foreground().then(|| tcgetattr(io::stdin()).ok()).flatten()?;
    let mut by_key = before.clone();
    by_key.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
    *BEFORE.lock() = Some(before);
    tcsetattr(io::stdin(), OptionalActions::Now, &by_key).ok()
}

/// Passes keys on until `send` returns false or the terminal ends.
pub(super) fn forward_keys(send: impl FnMut(Key) -> bool) {
    forward(io::stdin(), send);
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
