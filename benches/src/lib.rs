//! Benchmarks of downbeat: what is measured, and against what. `README.md` says how to run them.
//!
//! Every contestant carries the same [`Reading`]s in the same batches to the same callback, so that what differs is
//! how a message gets from its publisher to its subscribers.

mod calls;
pub mod contestants;
mod football;
pub mod launchers;
pub mod measure;
mod relay;
pub mod table_ii;
mod workload;

pub use calls::Calls;
pub use football::Football;
pub use relay::Relay;
pub use workload::{Load, Reading, Sum};
