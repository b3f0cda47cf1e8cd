//! Measuring a running core from outside.

use std::time::Duration;

use crate::Time;

/// Is told of every cycle and of every run of a detached module, on the thread where it ran.
///
/// Where there is no probe, the core measures nothing.
///
/// ```
/// use std::sync::Arc;
/// use std::sync::atomic::{AtomicU64, Ordering};
/// use downbeat_executor::{Core, CycleReport, ManualClock, Probe, StepReport, Time};
///
/// #[derive(Default)]
/// struct Longest(AtomicU64);
///
/// impl Probe for Longest {
///     fn cycle(&self, report: &CycleReport) {
///         let nanoseconds = (report.process + report.sync).as_nanos() as u64;
///         self.0.fetch_max(nanoseconds, Ordering::Relaxed);
///     }
///
///     fn step(&self, _: &StepReport<'_>) {}
/// }
///
/// let longest = Arc::new(Longest::default());
/// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO)).with_probe(longest.clone());
/// core.cycle()?;
/// println!("no cycle took longer than {} ns", longest.0.load(Ordering::Relaxed));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait Probe: Send + Sync {
    /// A cycle has ended.
    fn cycle(&self, report: &CycleReport);
    /// A detached module has run.
    fn step(&self, report: &StepReport<'_>);
}

/// What a cycle took.
#[derive(Clone, Copy, Debug)]
pub struct CycleReport {
    /// Counts the cycles from 0.
    pub cycle: u64,
    /// The time its modules were given.
    pub time: Time,
    /// How long it began after the timer it began for; nothing if it began for another reason.
    pub lateness: Option<Duration>,
    /// How many modules ran.
    pub modules: usize,
    /// The process phase.
    pub process: Duration,
    /// The sync phase.
    pub sync: Duration,
}

/// What a run of a detached module took.
#[derive(Clone, Copy, Debug)]
pub struct StepReport<'a> {
    /// The module's name.
    pub module: &'a str,
    /// Counts its runs from 0.
    pub step: u64,
    /// The time it was given.
    pub time: Time,
    /// How long it began after the timer it began for; nothing if it began for another reason.
    pub lateness: Option<Duration>,
    /// The run.
    pub duration: Duration,
}
