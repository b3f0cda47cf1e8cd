//! The mechanism "jobs": starts the work that modules asked for, and brings its results.

use crate::asked::Asked;
use crate::core::{JobResult, SyncPhase};
use crate::detached::Parcel;
use crate::job::Workers;
use crate::management::Place;
use crate::mechanism::{Mechanism, Version};

/// Results come in the order in which the work ended; they are with their modules before the messages of the cycle.
pub(crate) struct Jobs;

impl Mechanism for Jobs {
    type View = ();
    type Request = ();

    const NAME: &'static str = "jobs";
    const VERSION: Version = Version::new(1, 0);

    fn view(&self) {}

    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        phase.for_each_that_asked(Asked::WORK, |io, world| world.joined.work.append(&mut io.work));
        let works_inside = !phase.world.clock.runs_by_itself();
        let work = std::mem::take(&mut phase.world.joined.work);
        let has_worked = works_inside && !work.is_empty();
        for work in work {
            if works_inside {
                Workers::run(work);
            } else {
                phase.world.workers.start(work);
            }
        }
        if has_worked {
            phase.world.join();
            phase.asked.add(Asked::JOINED);
        }
        for result in std::mem::take(&mut phase.world.joined.results) {
            deliver(phase, result);
        }
    }
}

fn deliver(phase: &mut SyncPhase<'_>, JobResult { module, port, result }: JobResult) {
    match module.place {
        Place::Attached(_) => {
            if let Some(job) = phase.attached(module).and_then(|cell| cell.io.jobs.get_mut(port as usize)) {
                job.accept(result);
            }
            phase.wake(module);
        }
        Place::Detached(slot) => {
            if let Some(detached) = phase.world.detached[slot].as_ref().filter(|known| known.id == module) {
                detached.send(Parcel::Job { port, result });
            }
        }
    }
}
