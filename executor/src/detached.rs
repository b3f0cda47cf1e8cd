//! Modules on a thread and at a pace of their own.

use std::any::Any;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam::channel::{Receiver, RecvTimeoutError, Sender, bounded};
use crossbeam::sync::{Parker, Unparker};

use crate::cell::{Delivery, ModuleCell};
use crate::core::World;
use crate::guard::drop_guarded;
use crate::inspect::{Measuring, ModuleMeter, Span, Stopwatch};
use crate::job::Work;
use crate::join::{JoinQueue, Request};
use crate::management::{Command, SettingRefused};
use crate::messaging::AnyOutbox;
use crate::probe::{Probe, StepReport};
use crate::receipt::ReceiptSender;
use crate::service::{AnyClient, AnyReply, ReplyTo};
use crate::{
    Clock, Inbox, LifecycleState, ModuleId, ModuleOptions, Role, SettingInfo, SettingValue, Synchrony,
    ThreadError, ThreadOptions, Time, Transition, TransitionRefused,
};

/// What a run of a detached module brings to the next sync phase.
pub(crate) struct StepOutcome {
    pub(crate) module: ModuleId,
    pub(crate) time: Time,
    pub(crate) step: u64,
    pub(crate) is_stop: bool,
    pub(crate) inputs: Vec<Input>,
    pub(crate) outboxes: Vec<Box<dyn AnyOutbox>>,
    /// When and where it ran, if that was measured.
    pub(crate) span: Option<Span>,
    /// Runs that took longer than the deadline.
    pub(crate) overruns: u64,
    /// By client port.
    pub(crate) calls: Vec<(u32, Box<dyn AnyClient>)>,
    pub(crate) answers: Vec<(ReplyTo, Box<dyn AnyReply>)>,
    pub(crate) commands: Vec<Command>,
    pub(crate) work: Vec<Work>,
    pub(crate) state: LifecycleState,
    pub(crate) panic: Option<String>,
    /// The settings that have other values now, whole.
    pub(crate) settings: Option<Vec<SettingInfo>>,
}

#[derive(Clone, Copy)]
pub(crate) struct Input {
    pub(crate) topic: usize,
    pub(crate) skipped: u32,
    pub(crate) received: u32,
}

/// What the core has for a detached module beside messages.
pub(crate) enum Parcel {
    Reply {
        port: u32,
        reply: Box<dyn AnyReply>,
    },
    /// A `Vec<Incoming<Q>>`.
    Requests {
        port: u32,
        requests: Box<dyn Any + Send>,
    },
    /// An `Option<Result<T, JobError>>`.
    Job {
        port: u32,
        result: Box<dyn Any + Send>,
    },
    Set {
        setting: String,
        value: SettingValue,
        receipt: Option<ReceiptSender<Result<(), SettingRefused>>>,
    },
    Transition {
        transition: Transition,
        receipt: Option<ReceiptSender<Result<LifecycleState, TransitionRefused>>>,
    },
    Pause,
    Resume,
    StepOnce,
}

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
    parcels: Vec<Parcel>,
    is_held: bool,
    stop: bool,
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
            settings: cell.settings().to_vec(),
            role: options.role,
            cell: Some(cell),
            mailbox: Arc::new(Mailbox { contents: Mutex::default(), owner, capacity }),
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
            has_new_settings: false,
            _alive: alive,
        };
        let handle = self.options.spawn(&*self.name, move || runner.run())?;
        self.thread = Some(Thread { handle, ended });
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

    pub(crate) fn send(&self, parcel: Parcel) {
        self.mailbox.lock().parcels.push(parcel);
        self.mailbox.owner.unpark();
    }

    /// Keeps the module from running while the whole core is paused.
    pub(crate) fn hold(&self, is_held: bool) {
        self.mailbox.lock().is_held = is_held;
        self.mailbox.owner.unpark();
    }

    /// Takes over what the last run changed.
    pub(crate) fn note(&mut self, outcome: &mut StepOutcome) {
        self.state = outcome.state;
        self.meter.overran(outcome.overruns);
        if let Some(settings) = outcome.settings.take() {
            self.settings = settings;
        }
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
            Some((_, count)) => *count = count.saturating_add(messages),
            None => self.skipped.push((topic, messages)),
        }
    }
}

/// The thread's side.
struct Runner {
    role: Role,
    cell: ModuleCell,
    mailbox: Arc<Mailbox>,
    parker: Parker,
    clock: Arc<dyn Clock>,
    queue: Arc<JoinQueue>,
    probe: Option<Arc<dyn Probe>>,
    step: u64,
    has_new_settings: bool,
    /// The last field, so that it is dropped after the module.
    _alive: Sender<()>,
}

impl Runner {
    fn run(mut self) {
        self.step(VecDeque::new(), Vec::new(), self.clock.now(), Time::MAX);
        loop {
            let Some(contents) = self.take_contents() else { continue };
            for parcel in contents.parcels {
                self.open(parcel);
            }
            let (now, due) = (self.clock.now(), self.cell.next_due());
            if self.cell.has_work() || !contents.deliveries.is_empty() || due <= now || self.has_new_settings
            {
                self.step(contents.deliveries, contents.skipped, now, due);
            }
            if contents.stop {
                // Not a later time: what would be due at that has not run, and in a replay it would.
                self.cell.shutdown(None, now);
                self.send(now, Vec::new(), true, None);
                return;
            }
            self.wait();
        }
    }

    /// Nothing while the core is paused, after it has waited for a change.
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

    fn open(&mut self, parcel: Parcel) {
        let io = &mut self.cell.io;
        match parcel {
            Parcel::Reply { port, mut reply } => {
                if let Some(client) = io.clients.get_mut(port as usize) {
                    client.accept_any(&mut *reply);
                }
            }
            Parcel::Requests { port, mut requests } => {
                if let Some(server) = io.servers.get_mut(port as usize) {
                    server.accept(&mut *requests);
                }
            }
            Parcel::Job { port, result } => {
                if let Some(job) = io.jobs.get_mut(port as usize) {
                    job.accept(result);
                }
            }
            Parcel::Set { setting, value, receipt } => {
                let result = self.cell.set(&setting, value);
                self.has_new_settings |= result.is_ok();
                crate::setting::report(self.cell.name(), &setting, result, receipt);
            }
            Parcel::Transition { transition, receipt } => self.cell.transition_later(transition, receipt),
            Parcel::Pause => self.cell.pause(),
            Parcel::Resume => self.cell.resume(),
            Parcel::StepOnce => self.cell.step_once(),
        }
    }

    fn step(&mut self, deliveries: VecDeque<Delivery>, skipped: Vec<(usize, u32)>, now: Time, due: Time) {
        let is_paused = self.cell.is_paused();
        let inputs = inputs_of(&deliveries, skipped);
        let started = Instant::now();
        // A run on a thread of its own costs far more than two readings of the clock.
        let mut stopwatch = Stopwatch::start(Measuring::Trace);
        self.cell.run_detached(&deliveries, self.role, now);
        let span = stopwatch.lap().filter(|_| !is_paused);
        // Frees the batches for the cycles to come.
        drop_guarded("a message", || drop(deliveries));
        if let Some(probe) = &self.probe
            && !is_paused
        {
            let lateness = (due <= now).then(|| now.saturating_since(due));
            let (module, step) = (&**self.cell.name(), self.step);
            probe.step(&StepReport { module, step, time: now, lateness, duration: started.elapsed() });
        }
        self.send(now, inputs, false, span);
    }

    fn send(&mut self, time: Time, inputs: Vec<Input>, is_stop: bool, span: Option<Span>) {
        let io = &mut self.cell.io;
        let mut outboxes = Vec::new();
        io.outboxes.drain(|outbox| outboxes.push(outbox.split_off()));
        let calling = (0..).zip(&mut io.clients).filter(|(_, client)| client.has_calls());
        let calls = calling.map(|(port, client)| (port, client.split_off())).collect();
        let mut answers = Vec::new();
        for server in &mut io.servers {
            server.drain_answers(&mut |to, reply| answers.push((to, reply.take_boxed())));
        }
        let (commands, work) = (std::mem::take(&mut io.commands), std::mem::take(&mut io.work));
        io.asked = Default::default();
        let settings = std::mem::take(&mut self.has_new_settings).then(|| self.cell.settings().to_vec());
        let outcome = StepOutcome {
            module: self.cell.io.id,
            time,
            step: self.step,
            is_stop,
            inputs,
            outboxes,
            span,
            overruns: self.cell.meter.take_overruns(),
            calls,
            answers,
            commands,
            work,
            state: self.cell.state(),
            panic: self.cell.take_panic(),
            settings,
        };
        self.step += 1;
        self.queue.push(Request::Step(outcome));
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
            Some(input) => input.received = input.received.saturating_add(delivery.messages),
            None => inputs.push(Input { topic: delivery.topic, skipped: 0, received: delivery.messages }),
        }
    }
    inputs
}
