//! Single keys from terminals of other systems, whose state is not changed.

use std::io::{self, IsTerminal};

use console::Term;

use super::key::Key;

/// Without an effect.
pub(in crate::stop) fn restore_terminal() {}

pub(super) fn prepare() -> Option<()> {
    (io::stdin().is_terminal() && io::stdout().is_terminal()).then_some(())
}

pub(super) fn forward_keys(mut send: impl FnMut(Key) -> bool) {
    let terminal = Term::stdout();
    while let Ok(key) = terminal.read_key() {
        let key = match key {
            console::Key::Char(' ') => Key::Space,
            console::Key::ArrowRight => Key::Right,
            console::Key::ArrowUp => Key::Up,
            console::Key::ArrowDown => Key::Down,
            _ => continue,
        };
        if !send(key) {
            return;
        }
    }
}
