//! The last lines of the program's log, for the page.

use std::collections::VecDeque;
use std::sync::Arc;

use downbeat_bridge::rosout::LogLine;
use parking_lot::Mutex;

/// Lines that are kept.
const MOST_LINES: usize = 1000;

/// The last lines of the log.
#[derive(Clone, Default)]
pub struct LogTail {
    state: Arc<Mutex<State>>,
}

#[derive(Default)]
struct State {
    lines: VecDeque<(LogLine, String)>,
    /// The number of the line that comes next.
    next: u64,
}

impl LogTail {
    /// Adds a line of this logger.
    pub fn push(&self, line: LogLine, logger: &str) {
        let mut state = self.state.lock();
        if state.lines.len() >= MOST_LINES {
            state.lines.pop_front();
        }
        state.lines.push_back((line, logger.to_owned()));
        state.next += 1;
    }

    /// The lines from this number on that are still there, with their numbers and loggers, and how many are
    /// gone.
    #[cfg(feature = "view")]
    pub(super) fn since(&self, number: u64) -> (Vec<(u64, LogLine, String)>, u64) {
        let state = self.state.lock();
        let first = state.next - state.lines.len() as u64;
        let skipped = number.saturating_sub(first);
        let numbered = (first..).zip(&state.lines).skip(usize::try_from(skipped).unwrap_or(usize::MAX));
        let lines = numbered.map(|(number, (line, logger))| (number, line.clone(), logger.clone())).collect();
        (lines, first.saturating_sub(number))
    }
}
