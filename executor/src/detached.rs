//! Modules on a thread and at a pace of their own.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam::channel::{Receiver, RecvTimeoutError, Sender, bounded};
use crossbeam::sync::{Parker, Unparker};

use crate::cell::{Delivery, ModuleCell};
use crate::guard::drop_guarded;
use crate::join::{JoinQueue, Request};
use crate::outbox::AnyOutbox;
use crate::probe::{Probe, StepReport};
use crate::{Clock, Inbox, Role, SettingValue, Time};

/// What a run of a detached module brings to the next sync phase.
pub(crate) struct StepOutcome {
    pub(crate) module: usize,
    pub(crate) time: Time,
    pub(crate) step: u64,
    pub(crate) is_stop: bool,
    pub(crate) inputs: Vec<Input>,
    pub(crate) outboxes: Vec<Box<dyn AnyOutbox>>,
}

#[derive(Clone, Copy)]
pub(crate) struct Input {
    pub(crate) topic: usize,
    pub(crate) skipped: u32,
    pub(crate) received: u32,
}

/// A detached module as the core sees it.
pub(crate) struct DetachedModule {
    pub(crate) name: Arc<str>,
    role: Role,
    cell: Option<ModuleCell>,
    mailbox: Arc<Mailbox>,
    parker: Option<Parker>,
    thread: Option<Thread>,
}

struct Thread {
    handle: JoinHandle<()>,
    /// Disconnected when the thread is about to end.
    ended: Receiver<()>,
}

/// After how long, and how often then, it is told that the end waits for a module.
const PATIENCE: Duration = Duration::from_secs(1);

/// What the core has sent to the thread of a detached module.
struct Mailbox {
    contents: Mutex<Contents>,
    owner: Unparker,
    capacity: Inbox,
}

#[derive(Default)]
struct Contents {
    deliveries: VecDeque<Delivery>,
    skipped: Vec<(usize, u32)>,
    settings: Vec<(String, SettingValue)>,
    stop: bool,
}

impl DetachedModule {
    pub(crate) fn new(cell: ModuleCell, capacity: Inbox, role: Role) -> Self {
        let parker = Parker::new();
        let owner = parker.unparker().clone();
        let mailbox = Arc::new(Mailbox { contents: Mutex::default(), owner, capacity });
        let (name, parker) = (Arc::clone(cell.name()), Some(parker));
        Self { name, role, cell: Some(cell), mailbox, parker, thread: None }
    }

    pub(crate) fn cell(&self) -> Option<&ModuleCell> {
        self.cell.as_ref()
    }

    pub(crate) fn start(
        &mut self,
        module: usize,
        clock: Arc<dyn Clock>,
        queue: Arc<JoinQueue>,
        probe: Option<Arc<dyn Probe>>,
    ) -> std::io::Result<()> {
        let (Some(cell), Some(parker)) = (self.cell.take(), self.parker.take()) else { return Ok(()) };
        let mailbox = Arc::clone(&self.mailbox);
        let (alive, ended) = bounded(0);
        let role = self.role;
        let runner =
            Runner { module, role, cell, mailbox, parker, clock, queue, probe, step: 0, _alive: alive };
        let builder = std::thread::Builder::new().name(self.name.to_string());
        self.thread = Some(Thread { handle: builder.spawn(move || runner.run())?, ended });
        Ok(())
    }

    pub(crate) fn deliver(&self, delivery: Delivery) {
        let mut contents = self.mailbox.lock();
        if let Inbox::KeepLast(limit) = self.mailbox.capacity {
            contents.make_room(delivery.topic, limit.get());
        }
        contents.deliveries.push_back(delivery);
        drop(contents);
        self.mailbox.owner.unpark();
    }

    pub(crate) fn set(&self, setting: String, value: SettingValue) {
        self.mailbox.lock().settings.push((setting, value));
        self.mailbox.owner.unpark();
    }

    /// Waits for the current run and for the module's last callback, however long they take: a thread cannot
    /// be ended from outside. Says in the log whom it waits for.
    pub(crate) fn stop(&mut self) {
        self.mailbox.lock().stop = true;
        self.mailbox.owner.unpark();
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

impl Mailbox {
    fn lock(&self) -> std::sync::MutexGuard<'_, Contents> {
        self.contents.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Contents {
    /// Drops the oldest batch of the topic if `limit` of them wait.
    fn make_room(&mut self, topic: usize, limit: usize) {
        let mut waiting = (0..self.deliveries.len()).filter(|&index| self.deliveries[index].topic == topic);
        let (oldest, others) = (waiting.next(), waiting.count());
        if let Some(oldest) = oldest
            && others + 1 >= limit
            && let Some(dropped) = self.deliveries.remove(oldest)
        {
            self.skip(topic, dropped.messages);
        }
    }

    fn skip(&mut self, topic: usize, messages: u32) {
        match self.skipped.iter_mut().find(|(known, _)| *known == topic) {
            Some((_, count)) => *count += messages,
            None => self.skipped.push((topic, messages)),
        }
    }
}

/// The thread's side.
struct Runner {
    module: usize,
    role: Role,
    cell: ModuleCell,
    mailbox: Arc<Mailbox>,
    parker: Parker,
    clock: Arc<dyn Clock>,
    queue: Arc<JoinQueue>,
    probe: Option<Arc<dyn Probe>>,
    step: u64,
    /// The last field, so that it is dropped after the module.
    _alive: Sender<()>,
}

impl Runner {
    fn run(mut self) {
        self.step(VecDeque::new(), Vec::new(), self.clock.now(), Time::MAX);
        loop {
            let contents = std::mem::take(&mut *self.mailbox.lock());
            for (setting, value) in contents.settings {
                if let Err(refusal) = self.cell.set(&setting, value) {
                    tracing::warn!(module = &**self.cell.name(), setting, "setting not changed: {refusal}");
                }
            }
            let (now, due) = (self.clock.now(), self.cell.next_due());
            let is_due = self.cell.has_work() || !contents.deliveries.is_empty() || due <= now;
            if is_due && !self.cell.has_ended() {
                self.step(contents.deliveries, contents.skipped, now, due);
            }
            if contents.stop {
                let now = self.clock.now();
                self.cell.stop(now);
                self.send(now, Vec::new(), true);
                return;
            }
            self.wait();
        }
    }

    fn step(&mut self, deliveries: VecDeque<Delivery>, skipped: Vec<(usize, u32)>, now: Time, due: Time) {
        let inputs = inputs_of(&deliveries, skipped);
        let started = Instant::now();
        self.cell.run_detached(&deliveries, self.role, now);
        // Frees the batches for the cycles to come.
        drop_guarded("a message", || drop(deliveries));
        if let Some(probe) = &self.probe {
            let lateness = (due <= now).then(|| now.saturating_since(due));
            let (module, step) = (&**self.cell.name(), self.step);
            probe.step(&StepReport { module, step, time: now, lateness, duration: started.elapsed() });
        }
        self.send(now, inputs, false);
    }

    fn send(&mut self, time: Time, inputs: Vec<Input>, is_stop: bool) {
        let mut outboxes = Vec::new();
        self.cell.drain_outboxes(|outbox| outboxes.push(outbox.split_off()));
        let (module, step) = (self.module, self.step);
        self.step += 1;
        self.queue.push(Request::Step(StepOutcome { module, time, step, is_stop, inputs, outboxes }));
    }

    fn wait(&self) {
        if self.cell.has_work() {
            return;
        }
        match self.cell.next_due() {
            Time::MAX => self.parker.park(),
            due => {
                let remaining = due.saturating_since(self.clock.now());
                if remaining > Duration::ZERO {
                    self.parker.park_timeout(remaining);
                }
            }
        }
    }
}

fn inputs_of(deliveries: &VecDeque<Delivery>, skipped: Vec<(usize, u32)>) -> Vec<Input> {
    let mut inputs: Vec<_> =
        skipped.into_iter().map(|(topic, skipped)| Input { topic, skipped, received: 0 }).collect();
    for delivery in deliveries {
        match inputs.iter_mut().find(|input| input.topic == delivery.topic) {
            Some(input) => input.received += delivery.messages,
            None => inputs.push(Input { topic: delivery.topic, skipped: 0, received: delivery.messages }),
        }
    }
    inputs
}
