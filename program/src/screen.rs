//! The terminal: log lines above, a continuously updated block below.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::mem;
use std::sync::{Arc, LazyLock};
use std::thread;
use std::time::{Duration, Instant};

use console::Term;
use parking_lot::{Condvar, Mutex};

use super::logging::Stream;
use super::stop::requested;
use downbeat_msgs::printable;

/// Standard error, shared by the log and the status block. The block is only drawn on terminals.
///
/// A thread writes, since a terminal that was halted (Ctrl-S) and a pipe whose reader does not read block
/// writers: they must not halt the module that logs.
#[derive(Clone)]
pub(crate) struct Screen {
    shared: Arc<Shared>,
}

struct Shared {
    /// Only for its properties.
    terminal: Term,
    pending: Mutex<Pending>,
    changed: Condvar,
}

/// What is to be written.
#[derive(Default)]
struct Pending {
    texts: VecDeque<Text>,
    /// The bytes of `texts`.
    bytes: usize,
    /// The next block, if it changed.
    block: Option<Vec<String>>,
    has_thread: bool,
    is_writing: bool,
    /// Counts what was written.
    written: u64,
}

#[derive(Debug, PartialEq, Eq)]
enum Text {
    Of(Stream, String),
    /// Texts that were dropped at this place.
    Dropped(u64),
}

/// The most texts that wait, and their bytes; further ones are dropped and counted.
const WAITING: usize = 4096;
const WAITING_BYTES: usize = 1 << 20;

/// Texts that are written at once.
const AT_ONCE: usize = 64;

/// How long a program that was asked to stop waits for a terminal that takes nothing.
const PATIENCE: Duration = Duration::from_millis(500);

impl Screen {
    /// The screen of this process.
    pub(crate) fn of_process() -> &'static Self {
        static SCREEN: LazyLock<Screen> = LazyLock::new(|| {
            let (terminal, pending) = (Term::stderr(), Mutex::default());
            Screen { shared: Arc::new(Shared { terminal, pending, changed: Condvar::new() }) }
        });
        &SCREEN
    }

    pub(crate) fn is_terminal(&self) -> bool {
        self.shared.terminal.is_term()
    }

    /// The maximum size of a block: lines, and characters per line.
    pub(crate) fn block_size(&self) -> (usize, usize) {
        block_size(&self.shared.terminal)
    }

    /// Draws the block, replacing the last one; an empty block removes it.
    pub(crate) fn show(&self, block: Vec<String>) {
        if self.is_terminal() {
            self.shared.put(|pending| pending.block = Some(block));
        }
    }

    /// Writes lines of the log above the block. Never blocks: lines that the terminal does not take are
    /// dropped, and counted.
    pub(crate) fn log(&self, stream: Stream, lines: String) {
        self.shared.put(|pending| pending.add(stream, lines));
    }

    /// Waits until everything is written. Commands that handle stop requests give up on a terminal that takes
    /// nothing.
    pub(crate) fn flush(&self) {
        let mut pending = self.shared.pending.lock();
        let (mut written, mut since) = (pending.written, Instant::now());
        while !pending.is_idle() {
            self.shared.changed.wait_for(&mut pending, PATIENCE / 10);
            if pending.written != written {
                (written, since) = (pending.written, Instant::now());
            } else if requested::is_handled() && since.elapsed() >= PATIENCE {
                return;
            }
        }
    }

    /// Waits until everything is written, but not longer.
    pub(crate) fn flush_until(&self, end: Instant) {
        let mut pending = self.shared.pending.lock();
        self.shared.changed.wait_while_until(&mut pending, |pending| !pending.is_idle(), end);
    }
}

impl Shared {
    fn put(self: &Arc<Self>, add: impl FnOnce(&mut Pending)) {
        let mut pending = self.pending.lock();
        add(&mut pending);
        if !mem::replace(&mut pending.has_thread, true) {
            let shared = Arc::clone(self);
            let started = thread::Builder::new().name("screen".to_owned()).spawn(move || shared.write_all());
            if started.is_err() {
                pending.has_thread = false;
                let (texts, block) = pending.take();
                // A closed terminal is no reason to stop a robot.
                let _ = Drawn::new().update(&texts, block);
            }
        }
        drop(pending);
        self.changed.notify_all();
    }

    /// Writes until the process ends.
    fn write_all(&self) {
        let mut drawn = Drawn::new();
        let mut pending = self.pending.lock();
        loop {
            self.changed.wait_while(&mut pending, |pending| pending.is_idle());
            let (texts, block) = pending.take();
            pending.is_writing = true;
            drop(pending);
            // A closed terminal is no reason to stop a robot.
            let _ = drawn.update(&texts, block);
            pending = self.pending.lock();
            pending.is_writing = false;
            pending.written += 1;
            self.changed.notify_all();
        }
    }
}

impl Pending {
    fn is_idle(&self) -> bool {
        self.texts.is_empty() && self.block.is_none() && !self.is_writing
    }

    fn add(&mut self, stream: Stream, text: String) {
        if self.texts.len() < WAITING && self.bytes + text.len() <= WAITING_BYTES {
            self.bytes += text.len();
            self.texts.push_back(Text::Of(stream, text));
        } else if let Some(Text::Dropped(count)) = self.texts.back_mut() {
            *count += 1;
        } else {
            self.texts.push_back(Text::Dropped(1));
        }
    }

    /// The next texts and the block to draw.
    fn take(&mut self) -> (Vec<Text>, Option<Vec<String>>) {
        let count = self.texts.len().min(AT_ONCE);
        let texts: Vec<_> = self.texts.drain(..count).collect();
        self.bytes -=
            texts.iter().map(|text| if let Text::Of(_, text) = text { text.len() } else { 0 }).sum::<usize>();
        (texts, self.block.take())
    }
}

/// What the terminal shows.
struct Drawn {
    terminal: Term,
    block: Vec<String>,
}

impl Drawn {
    fn new() -> Self {
        Self { terminal: Term::stderr(), block: Vec::new() }
    }

    fn update(&mut self, texts: &[Text], block: Option<Vec<String>>) -> io::Result<()> {
        // One of the streams may still be open.
        let _ = self.terminal.clear_last_lines(self.block.len());
        for text in texts {
            let _ = match text {
                Text::Of(Stream::Error, text) => (&self.terminal).write_all(text.as_bytes()),
                Text::Of(Stream::Output, text) => {
                    io::stdout().write_all(text.as_bytes()).and_then(|()| io::stdout().flush())
                }
                Text::Dropped(count) => {
                    writeln!(
                        &self.terminal,
                        "({count} lines are missing here: what reads them was halted or too slow)"
                    )
                }
            };
        }
        let (height, width) = block_size(&self.terminal);
        if let Some(mut block) = block {
            block.truncate(height);
            self.block = block;
        }
        let mut lines = self.block.iter();
        lines.try_for_each(|line| {
            self.terminal.write_line(&console::truncate_str(&printable(line), width, "…"))
        })
    }
}

fn block_size(terminal: &Term) -> (usize, usize) {
    // Where the terminal does not know it, `console` assumes 24 lines of 79 characters.
    let (height, width) = terminal.size();
    // Lines that scrolled off the top cannot be erased, and wrapped lines would take two.
    (usize::from(height).saturating_sub(1), usize::from(width).saturating_sub(1))
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

    #[test]
    fn texts_that_are_not_taken_are_dropped_and_counted_in_their_place() {
        let mut pending = Pending::default();
        let add = |pending: &mut Pending, count: usize, length: usize| {
            (0..count).for_each(|_| pending.add(Stream::Error, "x".repeat(length)));
        };
        add(&mut pending, WAITING + 3, 1);
        let count = |pending: &mut Pending| {
            let (mut texts, mut dropped) = (0, Vec::new());
            while !pending.texts.is_empty() {
                for text in pending.take().0 {
                    match text {
                        Text::Of(..) => texts += 1,
                        Text::Dropped(count) => dropped.push((texts, count)),
                    }
                }
            }
            (texts, dropped)
        };
        assert_eq!(count(&mut pending), (WAITING, vec![(WAITING, 3)]));
        add(&mut pending, 5, WAITING_BYTES / 2);
        pending.take();
        assert_eq!(pending.bytes, 0);
        add(&mut pending, 3, WAITING_BYTES);
        assert_eq!(count(&mut pending), (1, vec![(1, 2)]));
    }

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
