//! How long the expressions of a chart may take for one event.

use parking_lot::Mutex;
use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time for all expressions that are evaluated for one event: far above what the bound of operations lets
/// happen with small values, so that it is only reached by what would stop the robot.
///
/// Where this bound is reached depends on the machine. Therefore it is a fault of the chart, which is
/// reported and recorded.
pub(crate) const LIMIT: Duration = Duration::from_millis(500);

/// The same while the robot is asked to stop: expressions that are done soon are not interrupted, so that the
/// last cycle of a robot does not depend on when the request came.
const LIMIT_AT_STOP: Duration = Duration::from_millis(20);

/// Operations between two looks at the clock.
const INTERVAL: u64 = 16;

/// The time that is left. Clones share it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Budget(Arc<Mutex<Spent>>);

/// Whether the robot is asked to stop.
pub(crate) type IsStopping = Box<dyn Fn() -> bool + Send + Sync>;

/// Why no time is left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Over {
    Limit,
    Stop,
}

#[derive(Default)]
struct Spent {
    begun: Option<Instant>,
    /// Processor time of the thread when [`LIMIT`] had passed by the clock: on a busy machine it may not have
    /// run at all by then.
    processor: Option<Duration>,
    over: Option<Over>,
    is_stopping: Option<IsStopping>,
}

impl Budget {
    /// An event begins. Nothing begins after an interruption.
    pub(crate) fn begin(&self) {
        let mut spent = self.0.lock();
        let over = spent.over.filter(|over| *over == Over::Stop);
        *spent = Spent {
            begun: Some(Instant::now()),
            processor: None,
            over,
            is_stopping: spent.is_stopping.take(),
        };
    }

    /// Interrupts expressions that run for long when `is_stopping`.
    pub(crate) fn interrupt_when(&self, is_stopping: IsStopping) {
        self.0.lock().is_stopping = Some(is_stopping);
    }

    /// Whether no time is left. Looks at the clock after some operations only, of which there were `count`.
    pub(crate) fn is_over_after(&self, count: u64) -> bool {
        count.is_multiple_of(INTERVAL) && self.over().is_some()
    }

    /// Why no time is left.
    pub(crate) fn over(&self) -> Option<Over> {
        let mut spent = self.0.lock();
        if spent.over.is_none() {
            spent.over = spent.look();
        }
        spent.over
    }
}

impl Spent {
    fn look(&mut self) -> Option<Over> {
        let elapsed = self.begun?.elapsed();
        if elapsed >= LIMIT_AT_STOP && self.is_stopping.as_ref().is_some_and(|is_stopping| is_stopping()) {
            return Some(Over::Stop);
        }
        if elapsed < LIMIT {
            return None;
        }
        let now = processor_time();
        let since = *self.processor.get_or_insert(now);
        (now.saturating_sub(since) >= LIMIT).then_some(Over::Limit)
    }
}

impl fmt::Debug for Spent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Spent").field("begun", &self.begun).field("over", &self.over).finish_non_exhaustive()
    }
}

/// The processor time of this thread.
#[cfg(unix)]
fn processor_time() -> Duration {
    use rustix::time::{ClockId, clock_gettime};
    // Neither part of it is negative.
    Duration::try_from(clock_gettime(ClockId::ThreadCPUTime)).unwrap_or_default()
}

/// The time of the clock instead: on a busy machine, expressions have less time here.
#[cfg(not(unix))]
fn processor_time() -> Duration {
    static START: std::sync::LazyLock<Instant> = std::sync::LazyLock::new(Instant::now);
    START.elapsed()
}
