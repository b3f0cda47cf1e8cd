//! The queue between the threads that log and the publisher.

use super::LogLine;
use super::of_modules::OfModules;
use crate::worker::Mailbox;
use crossbeam::queue::ArrayQueue;
use parking_lot::Mutex;
use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use tracing::{Event, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;

/// How many lines wait for a node or its publisher; as many as `/rosout` keeps for late subscriptions.
const WAITING: usize = 1000;

thread_local! {
    static PUBLISHES: Cell<bool> = const { Cell::new(false) };
}

/// Collects lines from all threads for `/rosout`. Clones share the lines.
///
/// It keeps the first 1000 lines until there is a node, which then publishes them. Lines that do not fit are
/// dropped and counted; a line on `/rosout` reports how many are missing.
#[derive(Clone)]
pub struct Rosout {
    pub(super) shared: Arc<Shared>,
}

/// Counts of lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RosoutStatus {
    /// Lines that were published.
    pub published: u64,
    /// Lines that were dropped since too many waited.
    pub dropped: u64,
    /// Lines that the middleware refused.
    pub failed: u64,
}

/// Passes the events of `tracing` to a [`Rosout`], but for those of publishing itself: a line about a failed
/// line would fail, too.
pub struct RosoutLayer {
    rosout: Rosout,
}

pub(super) struct Shared {
    pub(super) queue: ArrayQueue<LogLine>,
    pub(super) is_off: AtomicBool,
    pub(super) of_modules: OfModules,
    pub(super) published: AtomicU64,
    pub(super) dropped: AtomicU64,
    pub(super) failed: AtomicU64,
    /// Notifies the publisher of lines; `None` while no node publishes.
    pub(super) waiting: Mutex<Option<Mailbox<()>>>,
}

impl Rosout {
    /// Nothing collected yet.
    #[must_use]
    pub fn new() -> Self {
        Self {
            shared: Arc::new(Shared {
                queue: ArrayQueue::new(WAITING),
                is_off: AtomicBool::new(false),
                of_modules: OfModules::default(),
                published: AtomicU64::new(0),
                dropped: AtomicU64::new(0),
                failed: AtomicU64::new(0),
                waiting: Mutex::new(None),
            }),
        }
    }

    /// A layer that collects the events of a subscriber of `tracing`.
    #[must_use]
    pub fn layer(&self) -> RosoutLayer {
        RosoutLayer { rosout: self.clone() }
    }

    /// Queues a line to publish. Never blocks.
    pub fn log(&self, line: LogLine) {
        let shared = &*self.shared;
        if shared.is_off.load(Ordering::Relaxed) || PUBLISHES.get() {
            return;
        }
        if shared.queue.push(line).is_err() {
            shared.dropped.fetch_add(1, Ordering::Relaxed);
        }
        if let Some(waiting) = &*shared.waiting.lock() {
            // Refused if the publisher is notified already.
            let _ = waiting.push(());
        }
    }

    /// Drops all lines and collects no more: for a program without `/rosout`.
    pub fn turn_off(&self) {
        self.shared.is_off.store(true, Ordering::Relaxed);
        while self.take().is_some() {}
    }

    /// Counts of lines so far.
    #[must_use]
    pub fn status(&self) -> RosoutStatus {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let Shared { published, dropped, failed, .. } = &*self.shared;
        RosoutStatus { published: read(published), dropped: read(dropped), failed: read(failed) }
    }

    pub(super) fn take(&self) -> Option<LogLine> {
        self.shared.queue.pop()
    }
}

impl Default for Rosout {
    fn default() -> Self {
        Self::new()
    }
}

impl<S: Subscriber> Layer<S> for RosoutLayer {
    fn on_event(&self, event: &Event<'_>, _ctx: Context<'_, S>) {
        // Checked before the line is formatted.
        if !PUBLISHES.get() && !self.rosout.shared.is_off.load(Ordering::Relaxed) {
            self.rosout.log(LogLine::of(event));
        }
    }
}

/// While it exists this thread publishes, and its events are not collected.
pub(super) struct Publishing;

impl Publishing {
    pub(super) fn begin() -> Self {
        PUBLISHES.set(true);
        Self
    }
}

impl Drop for Publishing {
    fn drop(&mut self) {
        PUBLISHES.set(false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rosout::Severity;
    use tracing_subscriber::prelude::*;

    #[test]
    fn what_does_not_fit_is_dropped_and_counted() {
        let rosout = Rosout::new();
        for number in 0..WAITING + 5 {
            rosout.log(LogLine::now(Severity::Info, number.to_string()));
        }
        assert_eq!(rosout.status(), RosoutStatus { dropped: 5, ..RosoutStatus::default() });
        assert_eq!(rosout.take().map(|line| line.message), Some("0".to_owned()), "the first lines are kept");
    }

    #[test]
    fn nothing_is_kept_after_it_was_turned_off() {
        let rosout = Rosout::new();
        rosout.log(LogLine::now(Severity::Info, "before".into()));
        rosout.turn_off();
        rosout.log(LogLine::now(Severity::Info, "after".into()));
        assert_eq!(rosout.take(), None);
    }

    #[test]
    fn what_the_thread_that_publishes_logs_is_left_out() {
        let rosout = Rosout::new();
        let layer = rosout.layer();
        let logged = std::thread::spawn(move || {
            tracing::subscriber::with_default(tracing_subscriber::registry().with(layer), || {
                tracing::info!("first");
                let _publishing = Publishing::begin();
                tracing::warn!("the first could not be sent");
            });
        });
        assert!(logged.join().is_ok());
        assert_eq!(rosout.take().map(|line| line.message), Some("first".to_owned()));
        assert_eq!(rosout.take(), None);
    }
}
