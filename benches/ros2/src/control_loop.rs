//! A control loop with a period of 8 ms that measures how late its runs begin.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use downbeat_executor::{Module, Setup, SetupError};

use crate::payload;
use crate::peer::quantile_us;

pub const PERIOD: Duration = Duration::from_millis(8);

/// Publishes a message of 100 bytes on `ping` each period, whose number is the time since `start` in
/// nanoseconds.
pub struct ControlLoop {
    start: Instant,
    due: Option<Instant>,
    lateness: Times,
}

impl ControlLoop {
    pub fn new(lateness: &Times) -> Self {
        Self { start: Instant::now(), due: None, lateness: lateness.clone() }
    }

    #[cfg(feature = "zenoh")]
    pub fn start(&self) -> Instant {
        self.start
    }
}

impl Module for ControlLoop {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let ping = setup.publish("ping")?;
        setup.every(PERIOD, move |this: &mut Self, ctx| {
            let now = Instant::now();
            let due = this.due.unwrap_or(now);
            // A delay of several periods counts as one late run.
            let next = due + PERIOD;
            this.due = Some(if next < now { now + PERIOD } else { next });
            this.lateness.push(now.saturating_duration_since(due));
            ctx.publish(ping, payload::message((now - this.start).as_nanos() as u64, 100));
        })
    }
}

/// Durations that several threads add to and take.
#[derive(Clone, Default)]
pub struct Times(Arc<Mutex<Vec<Duration>>>);

impl Times {
    pub fn push(&self, time: Duration) {
        self.with(|times| times.push(time));
    }

    pub fn clear(&self) {
        self.with(Vec::clear);
    }

    /// Takes what was added, sorted.
    pub fn take(&self) -> Vec<Duration> {
        let mut times = self.with(std::mem::take);
        times.sort_unstable();
        times
    }

    /// Waits for the duration, and takes what was added in it.
    pub fn of(&self, part: Duration) -> Vec<Duration> {
        self.clear();
        std::thread::sleep(part);
        self.take()
    }

    fn with<T>(&self, call: impl FnOnce(&mut Vec<Duration>) -> T) -> T {
        call(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// The quantiles of sorted times, as cells of a table.
pub fn cells(times: &[Duration]) -> String {
    let [p50, p99, max] = [0.5, 0.99, 1.0].map(|part| quantile_us(times, part));
    format!("{p50:.0} µs | {p99:.0} µs | {max:.0} µs")
}
