//! Deadlines: reports runs and cycles that take too long, while they last.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::threads::{reason, unpoisoned};

/// A run or cycle that exceeds its deadline; see [`Core::on_overrun`](crate::Core::on_overrun).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Overrun {
    /// The name of the module, or "the cycle".
    pub what: Arc<str>,
    /// The longest allowed duration.
    pub deadline: Duration,
    /// The duration so far.
    pub running_for: Duration,
    /// True if the run has ended.
    pub has_ended: bool,
    /// The number of overruns of this module or cycle, including this one.
    pub overruns: u64,
}

pub(crate) type Report = Arc<dyn Fn(&Overrun) + Send + Sync>;

/// Writes the overrun to the log.
pub(crate) fn log(overrun: &Overrun) {
    let Overrun { what, deadline, running_for, has_ended, overruns } = overrun;
    if *has_ended {
        tracing::warn!(overruns, "{what} took {running_for:?}; its deadline is {deadline:?}");
    } else {
        tracing::warn!(
            overruns,
            "{what} has been running for {running_for:?} and still does; its deadline is {deadline:?}"
        );
    }
}

/// The interval until the second report of a run that still lasts; it doubles with each report.
const PATIENCE: Duration = Duration::from_secs(1);

/// Checks deadlines on a separate thread. The thread wakes once per shortest deadline while something runs,
/// and sleeps when nothing has run for that long.
pub(crate) struct Watchdog {
    shared: Arc<Shared>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

struct Shared {
    base: Instant,
    report: Mutex<Report>,
    watched: Mutex<Vec<Weak<Watched>>>,
    sleeps: AtomicBool,
    is_over: AtomicBool,
    /// The watchdog's thread, once it is started.
    thread: Mutex<Option<std::thread::Thread>>,
}

struct Watched {
    what: Arc<str>,
    deadline: Duration,
    /// Nanoseconds since the base, plus one; 0 while nothing runs.
    begun: AtomicU64,
    overruns: AtomicU64,
}

impl Watchdog {
    pub(crate) fn new() -> Self {
        let shared = Shared {
            base: Instant::now(),
            report: Mutex::new(Arc::new(log)),
            watched: Mutex::default(),
            sleeps: AtomicBool::new(false),
            is_over: AtomicBool::new(false),
            thread: Mutex::default(),
        };
        Self { shared: Arc::new(shared), thread: Mutex::default() }
    }

    pub(crate) fn report_to(&self, report: Report) {
        *unpoisoned(self.shared.report.lock()) = report;
    }

    /// Watches something with a deadline. Starts the thread if it is not running.
    pub(crate) fn watch(&self, what: Arc<str>, deadline: Duration) -> std::io::Result<Watch> {
        let (begun, overruns) = (AtomicU64::new(0), AtomicU64::new(0));
        let watched = Arc::new(Watched { what, deadline, begun, overruns });
        unpoisoned(self.shared.watched.lock()).push(Arc::downgrade(&watched));
        let mut thread = unpoisoned(self.thread.lock());
        if thread.is_none() {
            let shared = Arc::clone(&self.shared);
            let handle =
                std::thread::Builder::new().name("watchdog".into()).spawn(move || shared.look_after())?;
            *unpoisoned(self.shared.thread.lock()) = Some(handle.thread().clone());
            *thread = Some(handle);
        }
        Ok(Watch { shared: Arc::clone(&self.shared), watched })
    }
}

impl Drop for Watchdog {
    fn drop(&mut self) {
        self.shared.is_over.store(true, Ordering::SeqCst);
        self.shared.wake();
        if let Some(thread) = unpoisoned(self.thread.lock()).take() {
            // The thread catches panics of reports, and does not panic otherwise.
            let _ = thread.join();
        }
    }
}

/// A watched run or cycle.
pub(crate) struct Watch {
    shared: Arc<Shared>,
    watched: Arc<Watched>,
}

impl Watch {
    pub(crate) fn begin(&self) {
        self.watched.begun.store(self.shared.now() + 1, Ordering::SeqCst);
        if self.shared.sleeps.load(Ordering::SeqCst) {
            self.shared.wake();
        }
    }

    /// Ends the measurement; true if the deadline was exceeded.
    pub(crate) fn end(&self) -> bool {
        let begun = self.watched.begun.swap(0, Ordering::SeqCst);
        let running_for = Duration::from_nanos((self.shared.now() + 1).saturating_sub(begun));
        if begun == 0 || running_for <= self.watched.deadline {
            return false;
        }
        let overruns = self.watched.overruns.fetch_add(1, Ordering::Relaxed) + 1;
        if is_reported(overruns, running_for) {
            self.shared.report(&self.watched.overrun(running_for, true, overruns));
        }
        true
    }
}

/// Repeated overruns are reported at growing intervals, unless they are long.
fn is_reported(overruns: u64, running_for: Duration) -> bool {
    overruns.is_power_of_two() || running_for >= PATIENCE
}

impl Watched {
    fn overrun(&self, running_for: Duration, has_ended: bool, overruns: u64) -> Overrun {
        Overrun { what: Arc::clone(&self.what), deadline: self.deadline, running_for, has_ended, overruns }
    }
}

impl Shared {
    fn now(&self) -> u64 {
        u64::try_from(self.base.elapsed().as_nanos()).unwrap_or(u64::MAX - 1)
    }

    fn wake(&self) {
        if let Some(thread) = &*unpoisoned(self.thread.lock()) {
            thread.unpark();
        }
    }

    fn report(&self, overrun: &Overrun) {
        let report = Arc::clone(&*unpoisoned(self.report.lock()));
        if let Err(panic) = catch_unwind(AssertUnwindSafe(|| report(overrun))) {
            tracing::error!("the report of an overrun panicked: {}", reason(&*panic));
        }
    }

    /// The loop of the thread.
    fn look_after(&self) {
        // The runs that were reported last: what ran, when it began, and when it is reported again.
        let mut reported: Vec<(Weak<Watched>, u64, Duration)> = Vec::new();
        let mut was_idle = false;
        while !self.is_over.load(Ordering::SeqCst) {
            let look = self.look(&mut reported);
            match look.next {
                Some(next) if !(look.is_idle && was_idle) => std::thread::park_timeout(next),
                _ => self.sleep(),
            }
            was_idle = look.is_idle;
        }
    }

    fn look(&self, reported: &mut Vec<(Weak<Watched>, u64, Duration)>) -> Look {
        let watched: Vec<_> = {
            let mut watched = unpoisoned(self.watched.lock());
            watched.retain(|watched| watched.strong_count() > 0);
            watched.iter().filter_map(Weak::upgrade).collect()
        };
        reported.retain(|(watched, ..)| watched.strong_count() > 0);
        let mut look = Look { is_idle: true, next: None };
        for watched in watched {
            let begun = watched.begun.load(Ordering::SeqCst);
            if begun == 0 {
                look.after(watched.deadline);
                continue;
            }
            look.is_idle = false;
            let running_for = Duration::from_nanos((self.now() + 1).saturating_sub(begun));
            let known = reported.iter().position(|(of, ..)| std::ptr::eq(of.as_ptr(), Arc::as_ptr(&watched)));
            let due = match known {
                Some(known) if reported[known].1 == begun => reported[known].2,
                _ => watched.deadline,
            };
            if running_for <= due {
                look.after(due - running_for + Duration::from_micros(1));
                continue;
            }
            let overruns = watched.overruns.load(Ordering::Relaxed) + 1;
            if is_reported(overruns, running_for) {
                self.report(&watched.overrun(running_for, false, overruns));
            }
            let next = if running_for < PATIENCE { PATIENCE } else { running_for * 2 };
            let entry = (Arc::downgrade(&watched), begun, next);
            match known {
                Some(known) => reported[known] = entry,
                None => reported.push(entry),
            }
            look.after(next - running_for);
        }
        look
    }

    /// Sleeps until a run begins.
    fn sleep(&self) {
        self.sleeps.store(true, Ordering::SeqCst);
        // A run that began before the sleep flag was set sends no wake-up.
        let runs = |watched: &Weak<Watched>| {
            watched.upgrade().is_some_and(|watched| watched.begun.load(Ordering::SeqCst) != 0)
        };
        let is_needed = unpoisoned(self.watched.lock()).iter().any(runs);
        if !is_needed && !self.is_over.load(Ordering::SeqCst) {
            std::thread::park();
        }
        self.sleeps.store(false, Ordering::SeqCst);
    }
}

struct Look {
    /// True if nothing runs.
    is_idle: bool,
    /// The time until the next deadline can pass; `None` if nothing runs.
    next: Option<Duration>,
}

impl Look {
    fn after(&mut self, time: Duration) {
        self.next = Some(self.next.map_or(time, |next| next.min(time)));
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::sync::mpsc::{Receiver, channel};

    use super::*;

    const LONG: Duration = Duration::from_secs(60);
    const SHORT: Duration = Duration::from_millis(1);

    fn watchdog() -> (Watchdog, Receiver<Overrun>) {
        let (sender, reports) = channel();
        let watchdog = Watchdog::new();
        let sender = Mutex::new(sender);
        watchdog.report_to(Arc::new(move |overrun| {
            let _ = sender.lock().unwrap().send(overrun.clone());
        }));
        (watchdog, reports)
    }

    #[test]
    fn what_takes_too_long_is_told_while_it_runs_and_when_it_has_ended() {
        let (watchdog, reports) = watchdog();
        let watch = watchdog.watch(Arc::from("slow"), SHORT).unwrap();
        watch.begin();
        let running = reports.recv_timeout(LONG).unwrap();
        assert!(!running.has_ended && running.running_for > SHORT && *running.what == *"slow");
        assert!(watch.end());
        // The queue may still hold reports from while it was running.
        let ended = reports.iter().find(|overrun| overrun.has_ended).unwrap();
        assert!(ended.running_for >= running.running_for && ended.overruns == 1);
    }

    #[test]
    fn what_ends_in_time_is_not_told() {
        let (watchdog, reports) = watchdog();
        let watch = watchdog.watch(Arc::from("quick"), LONG).unwrap();
        for _ in 0..100 {
            watch.begin();
            assert!(!watch.end());
        }
        drop(watchdog);
        assert!(reports.try_recv().is_err());
    }

    #[test]
    fn a_watchdog_that_sleeps_wakes_when_something_begins() {
        let (watchdog, reports) = watchdog();
        let watch = watchdog.watch(Arc::from("rare"), SHORT).unwrap();
        let begin = Instant::now();
        while !watchdog.shared.sleeps.load(Ordering::SeqCst) {
            assert!(begin.elapsed() < LONG, "the watchdog does not go to sleep");
            std::thread::yield_now();
        }
        watch.begin();
        assert_eq!(*reports.recv_timeout(LONG).unwrap().what, *"rare");
    }

    #[test]
    fn a_report_that_panics_does_not_end_the_watch() {
        let (sender, reports) = channel();
        let sender = Mutex::new(sender);
        let watchdog = Watchdog::new();
        watchdog.report_to(Arc::new(move |overrun| {
            unpoisoned(sender.lock()).send(overrun.has_ended).unwrap();
            panic!("a report that panics, as this test wants it");
        }));
        let watch = watchdog.watch(Arc::from("slow"), SHORT).unwrap();
        for _ in 0..2 {
            watch.begin();
            assert_eq!(reports.recv_timeout(LONG), Ok(false));
            assert!(watch.end());
            assert_eq!(reports.recv_timeout(LONG), Ok(true));
        }
    }

    #[test]
    fn what_overruns_in_every_run_is_told_less_and_less_often() {
        let reported = (1..=1000).filter(|&overruns| is_reported(overruns, SHORT)).count();
        assert_eq!(reported, 10);
        assert!(is_reported(1000, PATIENCE));
    }
}
