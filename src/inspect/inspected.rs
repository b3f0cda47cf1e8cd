//! What can be looked at.

use std::time::Duration;

use downbeat_executor::{CoreHandle, CycleTrace, Graph, Snapshot};

/// How long a core may take to come to the end of a cycle.
const PATIENCE: Duration = Duration::from_secs(5);

/// How long the cycles of a trace may take to come. What there is by then is the trace.
const PATIENCE_WITH_TRACE: Duration = Duration::from_secs(30);

/// A running robot, as the socket shows it. Called from threads of the socket's clients.
pub trait Inspected: Send + Sync + 'static {
    /// The robot's counters between two cycles.
    ///
    /// # Errors
    /// If the core does not answer.
    fn snapshot(&self) -> Result<Snapshot, Unavailable>;

    /// What runs in the next cycles.
    ///
    /// # Errors
    /// If the core does not answer.
    fn trace(&self, cycles: u32) -> Result<CycleTrace, Unavailable>;

    /// Who publishes, subscribes, serves and calls what.
    ///
    /// # Errors
    /// If the core does not answer.
    fn graph(&self) -> Result<Graph, Unavailable>;

    /// Holds the robot: no cycle runs until it is resumed.
    fn pause(&self);

    /// Lets the robot go on.
    fn resume(&self);

    /// Has a held robot run one cycle.
    fn step(&self);
}

/// Why there is no answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unavailable {
    /// The core has stopped, or is in a cycle that does not end.
    #[error("the core does not answer: it has stopped, or a module does not return")]
    NoAnswer,
}

impl Inspected for CoreHandle {
    fn snapshot(&self) -> Result<Snapshot, Unavailable> {
        self.snapshot().wait(PATIENCE).ok_or(Unavailable::NoAnswer)
    }

    fn trace(&self, cycles: u32) -> Result<CycleTrace, Unavailable> {
        let trace = self.trace(cycles);
        let complete = trace.wait(PATIENCE_WITH_TRACE);
        let cut = || {
            self.finish_trace();
            trace.wait(PATIENCE)
        };
        complete.or_else(cut).ok_or(Unavailable::NoAnswer)
    }

    fn graph(&self) -> Result<Graph, Unavailable> {
        self.graph().wait(PATIENCE).ok_or(Unavailable::NoAnswer)
    }

    fn pause(&self) {
        self.pause();
    }

    fn resume(&self) {
        self.resume();
    }

    fn step(&self) {
        self.step();
    }
}
