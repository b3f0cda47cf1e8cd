//! Launchers: the threads on which the process phase runs.

mod pool;
mod threads;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

pub use pool::{Pool, PoolError};
pub use threads::Threads;

use crate::threads::{drop_guarded, reason};
use crate::{Launcher, Stage, ThreadError, ThreadOptions};

/// Runs the modules one after another on the thread of the core. It is the fastest launcher if the work of a
/// cycle costs less than waking a thread, as that of most robots: [`Pool`] states the price.
/// [`Scheduled`](crate::Scheduled) sets the CPUs and the priority of that thread.
#[derive(Clone, Copy, Debug, Default)]
pub struct Linear;

impl Launcher for Linear {
    fn is_linear(&self) -> bool {
        true
    }

    fn process(&mut self, stage: &mut Arc<Stage>) {
        match Arc::get_mut(stage) {
            Some(stage) => stage.run_all(),
            None => while stage.run_next() {},
        }
    }
}

/// A launcher that sets the CPUs and the priority of the core's thread.
///
/// ```
/// use downbeat_executor::{Core, Linear, Scheduled, ThreadOptions};
///
/// let options = ThreadOptions { cpus: vec![0], ..ThreadOptions::default() };
/// let core = Core::new().with_launcher(Scheduled::new(Linear, options));
/// ```
///
/// The thread keeps these options after the core has stopped.
#[derive(Clone, Debug)]
pub struct Scheduled<L> {
    launcher: L,
    options: ThreadOptions,
}

impl<L: Launcher> Scheduled<L> {
    /// Wraps a launcher, with options that apply only to the core's thread.
    pub fn new(launcher: L, options: ThreadOptions) -> Self {
        Self { launcher, options }
    }
}

impl<L: Launcher> Launcher for Scheduled<L> {
    fn attach(&mut self) -> Result<(), ThreadError> {
        self.launcher.attach()?;
        self.options.apply()
    }

    fn process(&mut self, stage: &mut Arc<Stage>) {
        self.launcher.process(stage);
    }

    fn is_linear(&self) -> bool {
        self.launcher.is_linear()
    }

    fn slot_freed(&mut self, slot: usize) {
        self.launcher.slot_freed(slot);
    }
}

/// Runs a stage's modules on a worker's thread. Panics of modules are caught earlier; any other panic is
/// caught here, and neither ends the worker nor delays the cycle.
fn run_guarded(run: impl FnOnce()) {
    if let Err(panic) = catch_unwind(AssertUnwindSafe(run)) {
        tracing::error!("a thread of the launcher panicked and continues: {}", reason(&*panic));
        drop_guarded("the payload of a panic", || drop(panic));
    }
}
