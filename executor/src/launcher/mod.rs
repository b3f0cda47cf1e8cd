//! How the process phase runs.

mod gate;
mod linear;
mod pool;
mod scheduled;
mod spin;
mod sync;
mod threads;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

pub use linear::Linear;
pub use pool::{Pool, PoolError};
pub use scheduled::Scheduled;
pub use spin::Spin;
pub use threads::Threads;

use crate::guard::{drop_guarded, reason};
use crate::{Stage, ThreadError};

/// Runs the modules of a cycle. Which launcher it is never changes what the modules compute.
///
/// [`Linear`] runs them on the core's thread, [`Pool`] on a fixed number of threads, [`Threads`] each on its own, and
/// a program can have its own way; `examples/executor_alone/src/bin/launcher.rs` has one with threads. This one shows that not even the
/// order matters:
///
/// ```
/// use std::sync::Arc;
/// use downbeat_executor::{Core, Launcher, Stage};
///
/// struct Backwards;
///
/// impl Launcher for Backwards {
///     fn process(&mut self, stage: &mut Arc<Stage>) {
///         (0..stage.runnable()).rev().for_each(|nth| stage.run_nth(nth));
///     }
/// }
///
/// let core = Core::new().with_launcher(Backwards);
/// ```
pub trait Launcher: Send {
    /// Called on the core's thread when the core starts, before the first cycle.
    ///
    /// # Errors
    /// If the core's thread cannot run as the launcher was told; then the core does not start.
    fn attach(&mut self) -> Result<(), ThreadError> {
        Ok(())
    }

    /// Runs every runnable module of the stage once: with [`Stage::run_all`], or with [`Stage::run_next`] on as
    /// many threads as there are, or with [`Stage::run_nth`] where it matters which runs where.
    ///
    /// When it returns, no clone of `stage` may be left: the sync phase changes what it holds.
    fn process(&mut self, stage: &mut Arc<Stage>);

    /// True if [`process`](Self::process) does no more than [`Stage::run_all`]; the core then calls that itself.
    fn is_linear(&self) -> bool {
        false
    }

    /// The module in this [slot](Stage::slot) was removed: what was kept for it can go. Another module may have
    /// the slot in a later cycle.
    fn slot_freed(&mut self, slot: usize) {
        let _ = slot;
    }
}

impl<L: Launcher + ?Sized> Launcher for Box<L> {
    fn attach(&mut self) -> Result<(), ThreadError> {
        (**self).attach()
    }

    fn process(&mut self, stage: &mut Arc<Stage>) {
        (**self).process(stage);
    }

    fn is_linear(&self) -> bool {
        (**self).is_linear()
    }
}

/// Runs a stage's modules on a worker's thread. Panics of modules do not come here; should there be one all the
/// same, it neither ends the worker nor holds up the cycle.
fn run_guarded(run: impl FnOnce()) {
    if let Err(panic) = catch_unwind(AssertUnwindSafe(run)) {
        tracing::error!("a thread of the launcher panicked and goes on: {}", reason(&*panic));
        drop_guarded("what a panic carried", || drop(panic));
    }
}
