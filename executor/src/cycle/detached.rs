//! Detached modules, each with a separate thread and its own timing.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam::channel::{Receiver, RecvTimeoutError, Sender, bounded};
use crossbeam::sync::{Parker, Unparker};

use crate::module::{Causes, Delivery, Input, Link, ModuleCell, Post, StepOutcome, TopicInput};
use crate::observe::{Measuring, ModuleMeter, Span, Stopwatch};
use crate::threads::{PromptTimers, drop_guarded, processor_time, unpoisoned};
use crate::{
    Clock, Inbox, LifecycleState, ModuleId, ModuleOptions, Role, Synchrony, ThreadError, ThreadOptions, Time,
};

/// The core's side of a detached module.
pub(crate) struct DetachedModule {
    pub(crate) id: ModuleId,
    pub(crate) name: Arc<str>,
    /// The state after the module's last run.
    pub(crate) state: LifecycleState,
    pub(crate) is_paused: bool,
    pub(crate) meter: ModuleMeter,
    role: Role,
    /// The cell until the thread starts.
    cell: Option<(ModuleCell, Parker)>,
    mailbox: Arc<Mailbox>,
    /// Batches of this sync phase that are not delivered yet.
    outgoing: Vec<Delivery>,
    thread: Option<Thread>,
    options: ThreadOptions,
}

struct Thread {
    handle: JoinHandle<()>,
    /// Disconnected shortly before the thread ends.
    ended: Receiver<()>,
}

/// The interval of warnings while the shutdown of the core waits for a module.
const PATIENCE: Duration = Duration::from_secs(1);

/// The input of a detached module's thread from the core.
struct Mailbox {
    contents: Mutex<Contents>,
    owner: Unparker,
    capacity: Inbox,
}

#[derive(Default)]
struct Contents {
    deliveries: VecDeque<Delivery>,
    /// The number of dropped messages by topic.
    skipped: Vec<(usize, u32)>,
    parcels: Vec<Parcel>,
    /// True while the whole core is paused.
    is_held: bool,
    stop: bool,
}

/// A change that a mechanism makes to the cell of a module on another thread.
pub(crate) struct Parcel {
    /// The reasons for the module to run.
    pub(crate) causes: Causes,
    /// The number of events of the topic `executor/events` that the change stands for.
    pub(crate) events: u32,
    pub(crate) apply: Box<dyn FnOnce(&mut ModuleCell) + Send>,
}

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
            role: options.role,
            cell: Some((cell, parker)),
            mailbox: Arc::new(Mailbox { contents: Mutex::default(), owner, capacity }),
            outgoing: Vec::new(),
            thread: None,
            options: options.thread.clone(),
        }
    }

    pub(crate) fn start(
        &mut self,
        clock: &Arc<dyn Clock>,
        link: &Arc<Link>,
        is_held: bool,
    ) -> Result<(), ThreadError> {
        let Some((cell, parker)) = self.cell.take() else { return Ok(()) };
        self.mailbox.lock().is_held = is_held;
        let (alive, ended) = bounded(0);
        let runner = Runner {
            role: self.role,
            cell,
            mailbox: Arc::clone(&self.mailbox),
            parker,
            clock: Arc::clone(clock),
            link: Arc::clone(link),
            step: 0,
            last: Time::from_nanos(i64::MIN),
            taken: 0,
            _alive: alive,
        };
        let handle = self.options.spawn(&*self.name, move || runner.run())?;
        self.thread = Some(Thread { handle, ended });
        Ok(())
    }

    /// Queues the batch for the next [`dispatch`](Self::dispatch).
    pub(crate) fn deliver(&mut self, delivery: Delivery) {
        self.outgoing.push(delivery);
    }

    /// Delivers all batches of a sync phase at once, so that the module wakes, runs and joins only once.
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

    /// Makes the module read its clock.
    pub(crate) fn wake(&self) {
        self.mailbox.owner.unpark();
    }

    /// Pauses or resumes the module together with the whole core.
    pub(crate) fn hold(&self, is_held: bool) {
        self.mailbox.lock().is_held = is_held;
        self.mailbox.owner.unpark();
    }

    /// The number of waiting messages.
    pub(crate) fn waiting(&self) -> u64 {
        self.mailbox.lock().deliveries.iter().map(|delivery| u64::from(delivery.messages)).sum()
    }

    /// Asks the module to run its last callback, without waiting for it.
    pub(crate) fn request_stop(&self) {
        self.mailbox.lock().stop = true;
        self.mailbox.owner.unpark();
    }

    /// Waits for the current run and for the module's last callback, however long they take, since a thread
    /// cannot be ended from outside. Logs the module's name while it waits.
    pub(crate) fn stop(&mut self) {
        self.request_stop();
        let Some(Thread { handle, ended }) = self.thread.take() else { return };
        let begin = Instant::now();
        while ended.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout) {
            let seconds = begin.elapsed().as_secs();
            tracing::warn!(
                module = &*self.name,
                "has not returned for {seconds} s, shutdown is waiting for it"
            );
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
    fn lock(&self) -> MutexGuard<'_, Contents> {
        unpoisoned(self.contents.lock())
    }
}

impl Contents {
    /// Drops the oldest batch of the topic if `limit` of them wait. Returns the number of messages missed
    /// before the next batch.
    fn make_room(&mut self, topic: usize, limit: usize) -> u32 {
        let mut waiting = (0..self.deliveries.len()).filter(|&index| self.deliveries[index].topic == topic);
        let (oldest, others) = (waiting.next(), waiting.count());
        if let Some(oldest) = oldest
            && others + 1 >= limit
            && let Some(dropped) = self.deliveries.remove(oldest)
        {
            self.skip(topic, dropped.messages);
            let missed = dropped.missed.saturating_add(dropped.messages);
            match self.deliveries.iter_mut().find(|delivery| delivery.topic == topic) {
                Some(next) => next.missed = next.missed.saturating_add(missed),
                None => return missed,
            }
        }
        0
    }

    fn skip(&mut self, topic: usize, messages: u32) {
        match self.skipped.iter_mut().find(|(known, _)| *known == topic) {
            Some((_, count)) => *count = count.saturating_add(messages),
            None => self.skipped.push((topic, messages)),
        }
    }
}

/// The thread's side of a detached module.
struct Runner {
    role: Role,
    cell: ModuleCell,
    mailbox: Arc<Mailbox>,
    parker: Parker,
    clock: Arc<dyn Clock>,
    link: Arc<Link>,
    step: u64,
    /// The last reading of the clock.
    last: Time,
    /// Events taken out of the mailbox since the last run.
    taken: u32,
    /// Declared last, so that it is dropped after the module.
    _alive: Sender<()>,
}

impl Runner {
    fn run(mut self) {
        let _timers = PromptTimers::start();
        self.step(Causes::ALL, VecDeque::new(), Vec::new(), self.clock.now());
        loop {
            let Some(contents) = self.take_contents() else { continue };
            let mut parcel_causes = Causes::NONE;
            for Parcel { causes, events, apply } in contents.parcels {
                self.taken += events;
                parcel_causes.add(causes);
                apply(&mut self.cell);
            }
            let now = self.clock.now();
            if now < self.last {
                self.cell.go_back(now);
            }
            self.last = now;
            let mut causes = Causes::NONE;
            if self.cell.next_due() <= now {
                causes.add(Causes::DUE);
            }
            if !contents.deliveries.is_empty() {
                causes.add(Causes::MESSAGES);
            }
            // A changed setting is reported even if the module is paused.
            let has_to_report = !self.cell.io.asked.is_empty();
            if self.cell.has_work(parcel_causes) || has_to_report || !causes.is_empty() {
                self.step(causes, contents.deliveries, contents.skipped, now);
            }
            if contents.stop {
                // Uses `now` and no later time: work that is due by a later time has not run, but in a replay
                // it would.
                self.cell.shutdown(Input::Batches(&[]), now);
                self.send(now, Vec::new(), Run::Last);
                return;
            }
            self.wait();
        }
    }

    /// The contents of the mailbox; `None` while the core is paused, after waiting for a change.
    fn take_contents(&self) -> Option<Contents> {
        let mut contents = self.mailbox.lock();
        if contents.is_held && !contents.stop {
            drop(contents);
            self.parker.park();
            return None;
        }
        let is_held = contents.is_held;
        Some(std::mem::replace(&mut *contents, Contents { is_held, ..Contents::default() }))
    }

    fn step(
        &mut self,
        causes: Causes,
        mut deliveries: VecDeque<Delivery>,
        skipped: Vec<(usize, u32)>,
        now: Time,
    ) {
        let is_paused = self.cell.is_paused();
        let inputs = inputs_of(&deliveries, skipped);
        // A run on a separate thread costs far more than two readings of the clock.
        let before = processor_time();
        let mut stopwatch = Stopwatch::start(Measuring::Trace);
        self.cell.run_detached(causes, deliveries.make_contiguous(), self.role, now);
        let span = stopwatch.lap().filter(|_| !is_paused);
        let processor = processor_time().zip(before).map(|(after, before)| after.saturating_sub(before));
        let span = span.map(|span| Span { processor, ..span });
        // Frees the batches for reuse in later cycles.
        drop_guarded("a message", || drop(deliveries));
        self.send(now, inputs, Run::Step { span, was_due: causes.has(Causes::DUE) && causes != Causes::ALL });
    }

    fn send(&mut self, time: Time, inputs: Vec<TopicInput>, run: Run) {
        let (is_stop, span, was_due) = match run {
            Run::Last => (true, None, false),
            Run::Step { span, was_due } => (false, span, was_due),
        };
        let outcome = StepOutcome {
            module: self.cell.io.id,
            time,
            number: self.step,
            is_stop,
            inputs,
            taken: std::mem::take(&mut self.taken),
            parts: self.cell.io.split_off(),
            span,
            causes: self.cell.take_ran(),
            was_due,
            overruns: self.cell.meter.take_overruns(),
            state: self.cell.state(),
            panic: self.cell.take_panic(),
        };
        self.step += 1;
        self.link.push(Post::Step(Box::new(outcome)));
        self.cell.give_answers();
    }

    fn wait(&mut self) {
        if self.cell.has_work(Causes::NONE) {
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

enum Run {
    Step {
        span: Option<Span>,
        was_due: bool,
    },
    /// The module's `shutdown`.
    Last,
}

fn inputs_of(deliveries: &VecDeque<Delivery>, skipped: Vec<(usize, u32)>) -> Vec<TopicInput> {
    let mut inputs: Vec<_> =
        skipped.into_iter().map(|(topic, skipped)| TopicInput { topic, skipped, received: 0 }).collect();
    for delivery in deliveries {
        match inputs.iter_mut().find(|input| input.topic == delivery.topic) {
            Some(input) => input.received = input.received.saturating_add(delivery.messages),
            None => {
                inputs.push(TopicInput { topic: delivery.topic, skipped: 0, received: delivery.messages })
            }
        }
    }
    inputs
}
