//! Keys of the terminal, read one by one.

mod key;
#[cfg_attr(not(unix), path = "terminal_elsewhere.rs")]
mod terminal;

use std::sync::mpsc::{self, Receiver};

pub(crate) use key::Key;
pub(super) use terminal::restore_terminal;

/// Reads single keys until it is dropped. Ctrl-C still interrupts the program.
pub(crate) struct Keyboard {
    keys: Receiver<Key>,
}

impl Keyboard {
    /// `None` if standard input is not a terminal, or another process is in its foreground.
    pub(crate) fn open() -> Option<Self> {
        let (sender, keys) = mpsc::channel();
        let keyboard = Self { keys };
        terminal::prepare()?;
        let read = move || terminal::forward_keys(|key| sender.send(key).is_ok());
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
