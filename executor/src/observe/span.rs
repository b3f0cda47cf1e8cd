//! The time of a module's run, measured where it runs.

use std::thread::Thread;
use std::time::{Duration, Instant};

use tracing::level_filters::LevelFilter;

/// The level of detail measured in a cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Measuring {
    /// Nothing: the clock is not read.
    #[default]
    Nothing,
    /// The begin and end of each run.
    Times,
    /// As `Times`, with the thread of each run.
    Trace,
}

impl Measuring {
    #[inline]
    pub(crate) fn is_on(self) -> bool {
        self != Self::Nothing
    }
}

/// Whether a subscriber receives `tracing` spans of cycles and runs. Creating and dropping an unused span
/// takes as long as a small module's run.
#[inline]
pub(crate) fn spans_are_on() -> bool {
    LevelFilter::current() >= LevelFilter::TRACE
}

/// A run of a module.
#[derive(Clone, Debug)]
pub(crate) struct Span {
    pub(crate) begin: Instant,
    pub(crate) end: Instant,
    /// The thread of the run, in a traced cycle.
    pub(crate) thread: Option<Thread>,
    /// The processor time of the run, if known; a detached module may wait in its runs.
    pub(crate) processor: Option<Duration>,
}

impl Span {
    #[inline]
    pub(crate) fn duration(&self) -> Duration {
        self.end.saturating_duration_since(self.begin)
    }
}

/// Measures consecutive runs on one thread. The end of one run is the beginning of the next, so that each run
/// costs one reading of the clock; nothing is read if nothing is measured.
pub(crate) struct Stopwatch {
    last: Option<Instant>,
    thread: Option<Thread>,
}

impl Stopwatch {
    #[inline]
    pub(crate) fn start(measuring: Measuring) -> Self {
        match measuring {
            Measuring::Nothing => Self { last: None, thread: None },
            Measuring::Times => Self { last: Some(Instant::now()), thread: None },
            Measuring::Trace => Self { last: Some(Instant::now()), thread: Some(std::thread::current()) },
        }
    }

    /// The time since the start or the last lap.
    #[inline]
    pub(crate) fn lap(&mut self) -> Option<Span> {
        let begin = self.last?;
        let end = Instant::now();
        self.last = Some(end);
        Some(Span { begin, end, thread: self.thread.clone(), processor: None })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn runs_that_follow_each_other_leave_no_gap() {
        let mut stopwatch = Stopwatch::start(Measuring::Times);
        let (first, second) = (stopwatch.lap().unwrap(), stopwatch.lap().unwrap());
        assert_eq!(first.end, second.begin);
        assert!(first.thread.is_none());
    }

    #[test]
    fn a_traced_run_knows_its_thread() {
        let span = Stopwatch::start(Measuring::Trace).lap().unwrap();
        assert_eq!(span.thread.unwrap().id(), std::thread::current().id());
    }

    #[test]
    fn nothing_is_taken_down_where_nothing_is_measured() {
        assert!(Stopwatch::start(Measuring::Nothing).lap().is_none());
    }
}
