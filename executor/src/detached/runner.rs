//! The thread of a detached module.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam::channel::Sender;
use crossbeam::sync::Parker;

use super::mailbox::{Contents, Mailbox, Parcel};
use super::outcome::{Input, NewSettings, StepOutcome};
use crate::asked::Asked;
use crate::cell::{Delivery, ModuleCell};
use crate::guard::drop_guarded;
use crate::inspect::{Measuring, Span, Stopwatch};
use crate::join::{JoinQueue, Request};
use crate::probe::{Probe, StepReport};
use crate::{Clock, Role, SettingValue, Time};

/// The thread's side.
pub(super) struct Runner {
    pub(super) role: Role,
    pub(super) cell: ModuleCell,
    pub(super) mailbox: Arc<Mailbox>,
    pub(super) parker: Parker,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) queue: Arc<JoinQueue>,
    pub(super) probe: Option<Arc<dyn Probe>>,
    pub(super) step: u64,
    /// When it looked at the clock last.
    pub(super) last: Time,
    /// The settings that were changed since the last run.
    pub(super) changed: Vec<(String, SettingValue)>,
    /// What was taken out of the mailbox since the last run, besides messages and settings.
    pub(super) taken: u32,
    /// The last field, so that it is dropped after the module.
    pub(super) _alive: Sender<()>,
}

impl Runner {
    pub(super) fn run(mut self) {
        self.step(VecDeque::new(), Vec::new(), self.clock.now(), Time::MAX);
        loop {
            let Some(contents) = self.take_contents() else { continue };
            for parcel in contents.parcels {
                self.open(parcel);
            }
            let now = self.clock.now();
            if now < self.last {
                self.cell.go_back(now);
            }
            self.last = now;
            let due = self.cell.next_due();
            if self.cell.has_work()
                || !contents.deliveries.is_empty()
                || due <= now
                || !self.changed.is_empty()
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
        self.taken += match &parcel {
            Parcel::Requests { count, .. } => *count,
            Parcel::Set { .. } => 0,
            _ => 1,
        };
        let io = &mut self.cell.io;
        match parcel {
            Parcel::Reply { port, mut reply } => {
                if let Some(client) = io.clients.get_mut(port as usize) {
                    client.accept_any(&mut *reply);
                }
            }
            Parcel::Requests { port, mut requests, .. } => {
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
                let value = crate::setting::report(self.cell.name(), &setting, result, receipt);
                self.changed.extend(value.map(|value| (setting, value)));
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
            let service = Arc::clone(server.name());
            server.drain_answers(&mut |to, reply| {
                answers.push((to, Arc::clone(&service), reply.take_boxed()));
            });
        }
        let (commands, work) = (std::mem::take(&mut io.commands), std::mem::take(&mut io.work));
        io.asked = Asked::default();
        let changed = std::mem::take(&mut self.changed);
        let settings = (!changed.is_empty())
            .then(|| Box::new(NewSettings { all: self.cell.settings().to_vec(), changed }));
        let outcome = StepOutcome {
            module: self.cell.io.id,
            time,
            step: self.step,
            is_stop,
            inputs,
            taken: std::mem::take(&mut self.taken),
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
