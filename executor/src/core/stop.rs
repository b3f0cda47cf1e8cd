//! The end of a core.

use std::panic::{AssertUnwindSafe, catch_unwind};

use super::{Core, Place};
use crate::Role;
use crate::agenda::{Asker, Ready};
use crate::guard::{end_of, reason};

impl Core {
    /// Runs the modules' last callbacks: parts in the reverse order of registration, then observers in the
    /// order of registration. What each publishes last is delivered before the next one stops; what had come
    /// before is delivered before the first one does.
    ///
    /// Outlets come after all of them: their sinks take what waits, and are dropped.
    ///
    /// It waits for sinks, and for detached modules that are in a callback, and logs which. A stopped core does not start
    /// again.
    pub fn stop(&mut self) {
        if !self.world.is_running || self.world.has_stopped {
            self.world.has_stopped = true;
            return self.end();
        }
        // Nobody would take what came from now on.
        self.world.queue.close();
        self.world.queue.request_stop();
        self.settle();
        let parts = self.world.members.iter().rev().filter(|member| member.role() == Role::Part);
        let observers = self.world.members.iter().filter(|member| member.role() == Role::Observer);
        let order: Vec<_> = parts.chain(observers).map(|member| member.id).collect();
        for id in order {
            match id.place {
                Place::Attached(slot) => self.shut_down(Ready { order: id.order, slot }),
                Place::Detached(slot) => {
                    if let Some(module) = &mut self.world.detached[slot] {
                        module.stop();
                    }
                }
            }
            self.settle();
        }
        self.world.has_stopped = true;
        self.world.is_running = false;
        // Those who wait for an answer from outside are told that there will be none.
        self.sync(self.world.clock.now());
        self.end();
    }

    /// Ends what modules outlive: outlets take what waits for them.
    fn end(&mut self) {
        self.world.outlets.stop();
        self.world.queue.end();
        for then in std::mem::take(&mut self.world.at_end) {
            if let Err(panic) = catch_unwind(AssertUnwindSafe(then)) {
                tracing::error!("panicked when the core had stopped: {}", end_of(panic));
            }
        }
    }

    /// A cycle at whose end the module runs its last callback. It and the others receive what was on its way before:
    /// a sync phase alone would make that stale.
    fn shut_down(&mut self, module: Ready) {
        let now = self.world.clock.now();
        self.process(now);
        let stage = self.stage.exclusive();
        if let (Some(cell), shared) = stage.cell_and_shared(module.slot) {
            cell.shutdown(Some(shared), now);
            let asked = cell.take_asked();
            if let Some(panic) = cell.take_panic() {
                tracing::error!(module = &**cell.name(), "panicked in its shutdown: {panic}");
            }
            stage.note_asker(Asker { module, asked });
        }
        self.sync(now);
    }

    /// One cycle takes the last messages over, the next delivers them.
    fn settle(&mut self) {
        for _ in 0..2 {
            let now = self.world.clock.now();
            self.process_and_sync(now);
        }
    }
}

impl Drop for Core {
    /// Stops a core that still runs.
    fn drop(&mut self) {
        if self.world.is_running
            && let Err(panic) = catch_unwind(AssertUnwindSafe(|| self.stop()))
        {
            tracing::error!("panicked while it was stopped: {}", reason(&*panic));
        }
        if let Some(stage) = self.stage.get_mut() {
            // Guarded, unlike the drop of the topics themselves.
            stage.shared.topics.retire_all();
        }
        self.world.queue.request_stop();
        self.world.queue.end();
    }
}
