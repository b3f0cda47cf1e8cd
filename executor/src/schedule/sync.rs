//! The mechanism "timers": has modules run when their timers, tasks and time-outs are due.

use crate::asked::Asked;
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
        let waits = Asked::STATE.or(Asked::CALLS);
        for asker in world.askers.iter().filter(|asker| asker.asked.has(waits)) {
            let slot = asker.module.slot;
            if let Some(cell) = stage.cell(slot) {
                world.agenda.wake_at(slot, cell.next_due());
            }
        }
    }
}
