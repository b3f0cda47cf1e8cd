//! The mechanism "jobs": starts the work that modules asked for, and brings its results.

use std::sync::Arc;

use crate::asked::Asked;
use crate::core::{JobResult, SyncPhase};
use crate::detached::Parcel;
use crate::event::ModuleEventKind;
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
        let mut results = std::mem::take(&mut phase.world.joined.results);
        if let Some(mut held) = phase.world.held_results.take() {
            results = held.release(phase, results);
            phase.world.held_results = Some(held);
        }
        for result in results {
            deliver(phase, result);
        }
    }
}

/// Results that have come and are not released yet, and releases of those that have not come.
#[derive(Default)]
pub(crate) struct HeldResults {
    results: Vec<JobResult>,
    /// By the name of the module, its job and the number of the result.
    pub(crate) releases: Vec<(Arc<str>, u32, u64)>,
}

impl HeldResults {
    /// Takes new results over; returns those that are released, in the order of the releases.
    fn release(&mut self, phase: &SyncPhase<'_>, new: Vec<JobResult>) -> Vec<JobResult> {
        self.results.extend(new);
        let Self { results, releases } = self;
        let mut released = Vec::new();
        releases.retain(|(module, port, number)| {
            let found = results.iter().position(|result| {
                (result.port, result.number) == (*port, *number)
                    && phase.module_name(result.module) == Some(&**module)
            });
            released.extend(found.map(|position| results.remove(position)));
            found.is_none()
        });
        released
    }
}

fn deliver(phase: &mut SyncPhase<'_>, JobResult { module, port, number, result }: JobResult) {
    phase.note_event_of(module, |name| ModuleEventKind::JobResult { module: name, job: port, number });
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
