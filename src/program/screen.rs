//! The terminal: log lines above, a continuously updated block below.

use std::io::{self, Write};
use std::sync::Arc;

use console::Term;
use parking_lot::Mutex;

use super::logging::Stream;
use crate::msgs::printable;

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
        self.shared.lock().terminal.is_term()
    }

    /// The maximum size of a block: lines, and characters per line.
    pub(crate) fn block_size(&self) -> (usize, usize) {
        self.shared.lock().block_size()
    }

    /// Draws the block, replacing the last one; an empty block removes it.
    pub(crate) fn show(&self, mut block: Vec<String>) {
        let mut shared = self.shared.lock();
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
        let shared = self.shared.lock();
        let _ = shared.erase();
        let _ = match stream {
            Stream::Error => (&shared.terminal).write_all(line.as_bytes()),
            Stream::Output => io::stdout().write_all(line.as_bytes()).and_then(|()| io::stdout().flush()),
        };
        let _ = shared.draw();
    }
}

impl Shared {
    fn block_size(&self) -> (usize, usize) {
        // Where the terminal does not know it, `console` assumes 24 lines of 79 characters.
        let (height, width) = self.terminal.size();
        // Lines that scrolled off the top cannot be erased, and wrapped lines would take two.
        (usize::from(height).saturating_sub(1), usize::from(width).saturating_sub(1))
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

/// A line of the terminal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Line {
    pub(crate) text: String,
    /// The number of entries that end in this line.
    pub(crate) entries: usize,
}

/// Arranges `entries` in lines of at most `width` characters, separated by `separator`.
///
/// An entry that is longer than a line is on a separate line.
pub(crate) fn wrap<T: AsRef<str>>(
    entries: impl IntoIterator<Item = T>,
    separator: &str,
    width: usize,
) -> Vec<Line> {
    let mut lines: Vec<Line> = Vec::new();
    for entry in entries {
        let entry = entry.as_ref();
        match lines.last_mut() {
            Some(line) if length(&line.text) + length(separator) + length(entry) <= width => {
                line.text.push_str(separator);
                line.text.push_str(entry);
                line.entries += 1;
            }
            _ => lines.push(Line { text: entry.to_owned(), entries: 1 }),
        }
    }
    lines
}

/// The text of at most `most` lines; the last one contains the number of omitted entries.
pub(crate) fn shorten(lines: Vec<Line>, most: usize) -> Vec<String> {
    let kept = if lines.len() > most { most.saturating_sub(1) } else { lines.len() };
    let more: usize = lines[kept..].iter().map(|line| line.entries).sum();
    let mut texts: Vec<_> = lines.into_iter().take(kept).map(|line| line.text).collect();
    if more > 0 {
        texts.push(format!("+{more} more"));
    }
    texts
}

/// The number of characters, each assumed to fill one cell.
pub(crate) fn length(text: &str) -> usize {
    text.chars().count()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wrapped(width: usize) -> Vec<Line> {
        wrap(["imu 100/s", "joint_states 125/s", "µs 1/s"], "  ", width)
    }

    #[test]
    fn entries_are_never_split() {
        assert_eq!(shorten(wrapped(29), 3), ["imu 100/s  joint_states 125/s", "µs 1/s"]);
        assert_eq!(shorten(wrapped(28), 3), ["imu 100/s", "joint_states 125/s  µs 1/s"]);
        assert_eq!(shorten(wrapped(3), 3), ["imu 100/s", "joint_states 125/s", "µs 1/s"]);
        assert!(wrap([""; 0], " ", 10).is_empty());
    }

    #[test]
    fn omitted_entries_are_counted() {
        assert_eq!(shorten(wrapped(28), 1), ["+3 more"]);
        assert_eq!(shorten(wrapped(3), 2), ["imu 100/s", "+2 more"]);
        assert_eq!(shorten(wrapped(3), 0), ["+3 more"]);
    }
}
