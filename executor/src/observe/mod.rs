//! Observation of a running core: counters, times, traces and the graph.
//!
//! Counters are exact. Times come from *sampled* cycles: reading a clock twice can take longer than a small
//! module's run, so a [`Sampler`](sampler::Sampler) limits the cost of measuring to 0.5 % of the cycles'
//! time. In a core whose modules take microseconds, every cycle is measured.

mod badge;
mod counters;
mod graph;
mod histogram;
mod inspector;
mod markup;
mod sampler;
mod snapshot;
mod span;
mod timing;
mod trace;

pub(crate) use badge::Badge;
pub use badge::{running_module, running_modules};
pub(crate) use counters::{ModuleMeter, TopicMeter};
pub use graph::{Graph, GraphEdge, GraphModule, GraphOutlet, GraphService, GraphTopic};
pub(crate) use histogram::nanoseconds;
pub(crate) use inspector::{CycleInfo, Inspector};
pub use snapshot::{
    CycleStatistics, ModuleState, ModuleStatistics, OutletStatistics, Snapshot, TimeStatistics,
    TopicStatistics,
};
pub(crate) use span::{Measuring, Span, Stopwatch, spans_are_on};
pub(crate) use timing::SharedTiming;
pub use timing::{LoopTiming, Timing};
pub use trace::{CycleTrace, TraceCause, TraceEvent, TraceEventKind};
