//! Keys that are pressed while a recording runs.

use std::io::{self, Read, Stdin};
use std::sync::mpsc::{self, Receiver};

use rustix::termios::{LocalModes, OptionalActions, Termios, tcgetattr, tcsetattr};

/// Gives each key as it is pressed, until it is dropped. The terminal still ends the program with Ctrl-C.
pub(super) struct Keyboard {
    before: Termios,
    keys: Receiver<u8>,
}

impl Keyboard {
    /// Nothing where standard input is no terminal.
    pub(super) fn open() -> Option<Self> {
        let before = tcgetattr(io::stdin()).ok()?;
        let mut by_key = before.clone();
        by_key.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
        tcsetattr(io::stdin(), OptionalActions::Now, &by_key).ok()?;
        let (sender, keys) = mpsc::channel();
        let read = move || forward(io::stdin(), |key| sender.send(key).is_ok());
        // It waits for keys until the process ends.
        let started = std::thread::Builder::new().name("keyboard".to_owned()).spawn(read);
        let keyboard = Self { before, keys };
        started.is_ok().then_some(keyboard)
    }

    /// A key that was pressed since the last look.
    pub(super) fn pressed(&self) -> Option<u8> {
        self.keys.try_recv().ok()
    }
}

impl Drop for Keyboard {
    fn drop(&mut self) {
        // A terminal that is gone needs no repair.
        let _ = tcsetattr(io::stdin(), OptionalActions::Now, &self.before);
    }
}

fn forward(mut input: Stdin, mut send: impl FnMut(u8) -> bool) {
    let mut key = [0];
    while input.read_exact(&mut key).is_ok() && send(key[0]) {}
}
