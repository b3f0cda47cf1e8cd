//! Benchmarks of downbeat and their contestants. `README.md` says how to run them.
//!
//! Every contestant passes the same [`Reading`]s in the same batches to the same callback, so that only the
//! path of a message from its publisher to its subscribers differs.

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
