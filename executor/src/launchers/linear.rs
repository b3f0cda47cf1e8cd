//! The launcher without threads.

use std::sync::Arc;

use crate::{Launcher, Stage};

/// Runs the modules one after another on the thread of the core. The fastest where the work of a cycle is
/// less than the cost of waking a thread. [`Scheduled`](crate::Scheduled) gives that thread CPUs and a priority.
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
