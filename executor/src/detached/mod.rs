//! Modules on a thread and at a pace of their own.

mod mailbox;
mod outcome;
mod runner;

use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam::channel::{Receiver, RecvTimeoutError, bounded};
use crossbeam::sync::Parker;

use mailbox::Mailbox;
pub(crate) use mailbox::Parcel;
pub(crate) use outcome::StepOutcome;
use runner::Runner;

use crate::cell::{Delivery, ModuleCell};
use crate::core::{Pause, World};
use crate::inspect::ModuleMeter;
use crate::setting::SettingsChange;
use crate::{
    Inbox, LifecycleState, ModuleId, ModuleOptions, Role, SettingInfo, Synchrony, ThreadError, ThreadOptions,
};

/// A detached module as the core sees it.
pub(crate) struct DetachedModule {
    pub(crate) id: ModuleId,
    pub(crate) name: Arc<str>,
    /// As its last run left it.
    pub(crate) state: LifecycleState,
    pub(crate) is_paused: bool,
    pub(crate) meter: ModuleMeter,
    settings: Vec<SettingInfo>,
    role: Role,
    cell: Option<ModuleCell>,
    mailbox: Arc<Mailbox>,
    /// What this sync phase has for it so far.
    outgoing: Vec<Delivery>,
    parker: Option<Parker>,
    thread: Option<Thread>,
    options: ThreadOptions,
}

struct Thread {
    handle: JoinHandle<()>,
    /// Disconnected when the thread is about to end.
    ended: Receiver<()>,
}

/// After how long, and how often then, it is told that the end waits for a module.
const PATIENCE: Duration = Duration::from_secs(1);

impl DetachedModule {
    pub(crate) fn new(mut cell: ModuleCell, options: &ModuleOptions) -> Self {
        let capacity = match options.synchrony {
            Synchrony::Detached(inbox) => inbox,
            Synchrony::WhenDue | Synchrony::EveryCycle => Inbox::KeepAll,
        };
        let parker = Parker::new();
        let owner = parker.unparker().clone();
        Self {
            id: cell.io.id,
            name: Arc::clone(cell.name()),
            state: cell.state(),
            is_paused: false,
            meter: std::mem::take(&mut cell.meter),
            settings: cell.settings().to_vec(),
            role: options.role,
            cell: Some(cell),
            mailbox: Arc::new(Mailbox { contents: Mutex::default(), owner, capacity }),
            outgoing: Vec::new(),
            parker: Some(parker),
            thread: None,
            options: options.thread.clone(),
        }
    }

    /// The settings with the values they had after the module's last run.
    pub(crate) fn settings(&self) -> &[SettingInfo] {
        &self.settings
    }

    pub(crate) fn start(&mut self, world: &World) -> Result<(), ThreadError> {
        let (Some(cell), Some(parker)) = (self.cell.take(), self.parker.take()) else { return Ok(()) };
        self.mailbox.lock().is_held = world.pause != Pause::Running;
        let (alive, ended) = bounded(0);
        let runner = Runner {
            role: self.role,
            cell,
            mailbox: Arc::clone(&self.mailbox),
            parker,
            clock: Arc::clone(&world.clock),
            queue: Arc::clone(&world.queue),
            probe: world.probe.clone(),
            step: 0,
            last: crate::Time::from_nanos(i64::MIN),
            changed: Vec::new(),
            taken: 0,
            _alive: alive,
        };
        let handle = self.options.spawn(&*self.name, move || runner.run())?;
        self.thread = Some(Thread { handle, ended });
        Ok(())
    }

    /// Has the batch delivered with the next [`dispatch`](Self::dispatch).
    pub(crate) fn deliver(&mut self, delivery: Delivery) {
        self.outgoing.push(delivery);
    }

    /// Delivers all batches of a sync phase at once: the module wakes for all of them, and runs, and joins, once.
    pub(crate) fn dispatch(&mut self) {
        if self.outgoing.is_empty() {
            return;
        }
        let mut contents = self.mailbox.lock();
        for mut delivery in self.outgoing.drain(..) {
            if let Inbox::KeepLast(limit) = self.mailbox.capacity {
                delivery.missed = contents.make_room(delivery.topic, limit.get());
            }
            contents.deliveries.push_back(delivery);
        }
        drop(contents);
        self.mailbox.owner.unpark();
    }

    pub(crate) fn send(&self, parcel: Parcel) {
        self.mailbox.lock().parcels.push(parcel);
        self.mailbox.owner.unpark();
    }

    /// Has the module look at its clock.
    pub(crate) fn wake(&self) {
        self.mailbox.owner.unpark();
    }

    /// Keeps the module from running while the whole core is paused.
    pub(crate) fn hold(&self, is_held: bool) {
        self.mailbox.lock().is_held = is_held;
        self.mailbox.owner.unpark();
    }

    /// Takes over what the last run changed; tells which settings it had anew.
    pub(crate) fn note(&mut self, outcome: &mut StepOutcome) -> Option<SettingsChange> {
        self.state = outcome.state;
        self.meter.overran(outcome.overruns);
        let new = *outcome.settings.take()?;
        self.settings = new.all;
        let (module, settings) = (Arc::clone(&self.name), new.changed);
        Some(SettingsChange { time: outcome.time, module, step: Some(outcome.step), settings })
    }

    /// Messages that wait for it.
    pub(crate) fn waiting(&self) -> u64 {
        self.mailbox.lock().deliveries.iter().map(|delivery| u64::from(delivery.messages)).sum()
    }

    /// Has the module run its last callback, without waiting for it.
    pub(crate) fn request_stop(&self) {
        self.mailbox.lock().stop = true;
        self.mailbox.owner.unpark();
    }

    /// Waits for the current run and for the module's last callback, however long they take: a thread cannot
    /// be ended from outside. Says in the log whom it waits for.
    pub(crate) fn stop(&mut self) {
        self.request_stop();
        let Some(Thread { handle, ended }) = self.thread.take() else { return };
        let begin = Instant::now();
        while ended.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout) {
            let seconds = begin.elapsed().as_secs();
            tracing::warn!(module = &*self.name, "has not returned for {seconds} s, the stop waits for it");
        }
        if handle.join().is_err() {
            tracing::error!(module = &*self.name, "the thread of this detached module ended by a panic");
        }
    }
}

impl Drop for DetachedModule {
    fn drop(&mut self) {
        self.stop();
    }
}
