//! How long the expressions of a chart may take for one event.

use parking_lot::Mutex;
use rustix::time::{ClockId, clock_gettime};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time for all expressions that are evaluated for one event: far above what the bound of operations lets happen with small values, so that
/// it is only reached by what would stop the robot.
///
/// Where this bound is reached depends on the machine. Therefore it is a fault of the chart, which is reported and recorded.
pub(crate) const LIMIT: Duration = Duration::from_millis(500);

/// Operations between two looks at the clock.
const INTERVAL: u64 = 16;

/// The time that is left. Clones share it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Budget(Arc<Mutex<Spent>>);

#[derive(Debug, Default)]
struct Spent {
    begun: Option<Instant>,
    /// Processor time of the thread when [`LIMIT`] had passed by the clock: on a busy machine it may not have run at all by then.
    processor: Option<Duration>,
    is_over: bool,
}

impl Budget {
    /// An event begins.
    pub(crate) fn begin(&self) {
        *self.0.lock() = Spent { begun: Some(Instant::now()), ..Spent::default() };
    }

    /// Whether no time is left. Looks at the clock after some operations only, of which there were `count`.
    pub(crate) fn is_over_after(&self, count: u64) -> bool {
        count.is_multiple_of(INTERVAL) && self.is_over()
    }

    /// Whether no time is left.
    pub(crate) fn is_over(&self) -> bool {
        let mut spent = self.0.lock();
        if !spent.is_over && spent.begun.is_some_and(|begun| begun.elapsed() >= LIMIT) {
            let now = processor_time();
            let since = *spent.processor.get_or_insert(now);
            spent.is_over = now.saturating_sub(since) >= LIMIT;
        }
        spent.is_over
    }
}

/// The processor time of this thread.
fn processor_time() -> Duration {
    // Neither part of it is negative.
    Duration::try_from(clock_gettime(ClockId::ThreadCPUTime)).unwrap_or_default()
}
