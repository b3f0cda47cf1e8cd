//! The mechanism "timers": has modules run when their timers, tasks and time-outs are due.

use crate::context::Asked;
use crate::core::SyncPhase;
use crate::mechanism::{Mechanism, Version};

pub(crate) struct Timers;

impl Mechanism for Timers {
    type View = ();
    type Request = ();

    const NAME: &'static str = "timers";
    const VERSION: Version = Version::new(1, 0);

    fn view(&self) {}

    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        let SyncPhase { stage, world, .. } = phase;
        for ready in &world.asked {
            if let Some(cell) = stage.cell(ready.slot)
                && (cell.io.asked.has(Asked::STATE) || cell.io.asked.has(Asked::CALLS))
            {
                world.agenda.wake_at(ready.slot, cell.next_due());
            }
        }
    }
}
