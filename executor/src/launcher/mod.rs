//! How the process phase runs.

mod linear;
mod pool;

use std::sync::Arc;

pub use linear::Linear;
pub use pool::{Pool, PoolError};

use crate::Stage;

/// Runs the modules of a cycle. Which launcher it is never changes what the modules compute.
pub trait Launcher: Send {
    /// Runs every runnable module of the stage once.
    ///
    /// When it returns, no clone of `stage` may be left: the sync phase changes what it holds.
    fn process(&mut self, stage: &mut Arc<Stage>);

    /// The module in this slot was removed; another one may be put there.
    fn slot_freed(&mut self, _slot: usize) {}
}
