//! Standard input, line by line, while something else goes on.

use std::io::BufRead;
use std::sync::mpsc::{self, Receiver};
use std::thread;

use anyhow::Context;

/// The lines of standard input, as they come. The sender is gone after the last one.
pub(crate) fn lines() -> anyhow::Result<Receiver<String>> {
    let (sender, lines) = mpsc::channel();
    let read = move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            if sender.send(line).is_err() {
                return;
            }
        }
    };
    thread::Builder::new().name("input".to_owned()).spawn(read).context("cannot read standard input")?;
    Ok(lines)
}
