//! What can be looked at.

use std::time::Duration;

use downbeat_executor::{CoreHandle, CycleTrace, Graph, Snapshot};

use crate::robot::EndpointReport;

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

    /// What ROS 2 sees of the robot.
    ///
    /// # Errors
    /// If it has no ROS 2 node; in words.
    fn exposed(&self) -> Result<Vec<EndpointReport>, String> {
        Err(NO_NODE.to_owned())
    }

    /// Exposes more, as the keys `out` and `in` of `[expose]` in a robot file say it. Returns what was added.
    ///
    /// # Errors
    /// If what is asked for cannot be, or the robot has no ROS 2 node; in words.
    fn expose(&self, _entries: &str) -> Result<Vec<EndpointReport>, String> {
        Err(NO_NODE.to_owned())
    }

    /// Takes back what is exposed under these names or patterns. Returns what it was.
    ///
    /// # Errors
    /// If one of them is not exposed, or the robot has no ROS 2 node; in words.
    fn take_back(&self, _topics: &[String]) -> Result<Vec<EndpointReport>, String> {
        Err(NO_NODE.to_owned())
    }
}

const NO_NODE: &str = "it runs without a ROS 2 node";

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
