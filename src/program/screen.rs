//! The terminal: log lines above, a continuously updated block below.

use std::io::{self, Write};
use std::sync::{Arc, Mutex, PoisonError};

use console::Term;

use crate::msgs::printable;

use super::logging::Stream;

/// Standard error, shared by the log and the status block. The block is only drawn on terminals.
#[derive(Clone)]
pub(crate) struct Screen {
    shared: Arc<Mutex<Shared>>,
}

struct Shared {
    terminal: Term,
    block: Vec<String>,
}

impl Screen {
    pub(crate) fn new() -> Self {
        let shared = Shared { terminal: Term::stderr(), block: Vec::new() };
        Self { shared: Arc::new(Mutex::new(shared)) }
    }

    pub(crate) fn is_terminal(&self) -> bool {
        self.lock().terminal.is_term()
    }

    /// The maximum size of a block: lines, and characters per line.
    pub(crate) fn block_size(&self) -> (usize, usize) {
        self.lock().block_size()
    }

    /// Draws the block, replacing the last one; an empty block removes it.
    pub(crate) fn show(&self, mut block: Vec<String>) {
        let mut shared = self.lock();
        if !shared.terminal.is_term() {
            return;
        }
        // A closed terminal is no reason to stop a robot.
        let _ = shared.erase();
        block.truncate(shared.block_size().0);
        shared.block = block;
        let _ = shared.draw();
    }

    /// Writes a line of the log above the block.
    pub(crate) fn log(&self, stream: Stream, line: &str) {
        let shared = self.lock();
        let _ = shared.erase();
        let _ = match stream {
            Stream::Error => (&shared.terminal).write_all(line.as_bytes()),
            Stream::Output => io::stdout().write_all(line.as_bytes()).and_then(|()| io::stdout().flush()),
        };
        let _ = shared.draw();
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Shared> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Shared {
    fn block_size(&self) -> (usize, usize) {
        let (height, width) = self.terminal.size();
        // Lines that scrolled off the top cannot be erased, and wrapped lines would take two.
        (usize::from(height).saturating_sub(1), usize::from(width).max(20) - 1)
    }

    fn erase(&self) -> io::Result<()> {
        self.terminal.clear_last_lines(self.block.len())
    }

    fn draw(&self) -> io::Result<()> {
        let (_, width) = self.block_size();
        self.block.iter().try_for_each(|line| {
            self.terminal.write_line(&console::truncate_str(&printable(line), width, "…"))
        })
    }
}
