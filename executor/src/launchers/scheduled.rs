//! Where the core's own thread runs.

use std::sync::Arc;

use crate::{Launcher, Stage, ThreadError, ThreadOptions};

/// A launcher whose core has its thread on the CPUs, and at the priority, that options say.
///
/// ```
/// use downbeat_executor::{Core, Linear, Scheduled, ThreadOptions};
///
/// let options = ThreadOptions { cpus: vec![0], ..ThreadOptions::default() };
/// let core = Core::new().with_launcher(Scheduled::new(Linear, options));
/// ```
///
/// The thread that runs the core keeps them when the core has stopped.
#[derive(Clone, Debug)]
pub struct Scheduled<L> {
    launcher: L,
    options: ThreadOptions,
}

impl<L: Launcher> Scheduled<L> {
    /// The launcher, with options for the core's thread alone.
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
