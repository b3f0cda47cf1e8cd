//! A module as the core keeps it: its state, its outboxes, and what it has to do next.

mod life;

use std::any::Any;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use crate::asked::Asked;
use crate::behaviour::Behaviour;
use crate::guard::{drop_guarded, end_of};
use crate::inspect::{Badge, ModuleMeter, Span, spans_are_on};
use crate::module_io::{ModuleIo, Shared};
use crate::receipt::ReceiptSender;
use crate::watchdog::Watch;
use crate::{Context, LifecycleState, Role, SettingInfo, SettingValue, Time, Transition, TransitionRefused};

pub(crate) struct ModuleCell {
    pub(crate) io: ModuleIo,
    /// Always there until the cell is dropped.
    behaviour: Option<Box<dyn Behaviour>>,
    /// The topic of each subscription.
    subscribed: Vec<usize>,
    state: LifecycleState,
    transitions: VecDeque<(Transition, TransitionReceipt)>,
    hold: Hold,
    /// True if it has nothing but subscriptions, timers and settings.
    is_simple: bool,
    watch: Option<Watch>,
    badge: Badge,
    panic: Option<String>,
    pub(crate) meter: ModuleMeter,
    /// The last run, in a cycle that is measured.
    pub(crate) span: Option<Span>,
}

type TransitionReceipt = Option<ReceiptSender<Result<LifecycleState, TransitionRefused>>>;

/// Whether a module is paused.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Hold {
    Free,
    Held,
    /// Held after its next run.
    Step,
}

/// A batch on its way to a module on another thread, for all its subscriptions of the topic.
pub(crate) struct Delivery {
    pub(crate) topic: usize,
    pub(crate) batch: Arc<dyn Any + Send + Sync>,
    pub(crate) messages: u32,
    /// Messages of the topic that its inbox dropped since the delivery before.
    pub(crate) missed: u32,
}

impl ModuleCell {
    /// A module on its way to `initial`.
    pub(crate) fn new(
        io: ModuleIo,
        behaviour: Box<dyn Behaviour>,
        subscribed: Vec<usize>,
        initial: LifecycleState,
        meter: ModuleMeter,
    ) -> Self {
        let transitions: &[_] = match initial {
            LifecycleState::Unconfigured => &[],
            LifecycleState::Inactive => &[Transition::Configure],
            LifecycleState::Active => &[Transition::Configure, Transition::Activate],
            LifecycleState::Finalized => &[Transition::Shutdown],
        };
        let is_simple = io.jobs.is_empty()
            && io.servers.is_empty()
            && io.clients.is_empty()
            && io.tasks.is_empty()
            && !behaviour.has_each_run();
        let badge = Badge::new(Arc::clone(&io.name));
        Self {
            io,
            behaviour: Some(behaviour),
            subscribed,
            state: LifecycleState::Unconfigured,
            transitions: transitions.iter().map(|&transition| (transition, None)).collect(),
            hold: Hold::Free,
            is_simple,
            watch: None,
            badge,
            panic: None,
            meter,
            span: None,
        }
    }

    pub(crate) fn name(&self) -> &Arc<str> {
        &self.io.name
    }

    pub(crate) fn settings(&self) -> &[SettingInfo] {
        self.io.settings.infos()
    }

    pub(crate) fn state(&self) -> LifecycleState {
        self.state
    }

    /// True after the last callback, or after a panic.
    pub(crate) fn has_ended(&self) -> bool {
        self.state == LifecycleState::Finalized
    }

    /// What the panic said that ended the module; given once.
    pub(crate) fn take_panic(&mut self) -> Option<String> {
        self.panic.take()
    }

    /// Gives each run a deadline.
    pub(crate) fn watch_runs(&mut self, watch: Watch) {
        self.watch = Some(watch);
    }

    pub(crate) fn pause(&mut self) {
        self.hold = Hold::Held;
    }

    pub(crate) fn resume(&mut self) {
        self.hold = Hold::Free;
    }

    pub(crate) fn step_once(&mut self) {
        self.hold = Hold::Step;
    }

    pub(crate) fn is_paused(&self) -> bool {
        self.hold != Hold::Free
    }

    /// Changes a setting, unless the setting or its module refuses the value; gives back what the setting holds now.
    pub(crate) fn set(&mut self, setting: &str, value: SettingValue) -> Result<SettingValue, String> {
        let (index, value) = self.io.settings.check(setting, value)?;
        if let Some(behaviour) = &mut self.behaviour {
            let check = AssertUnwindSafe(|| behaviour.accept_setting(index, &value));
            catch_unwind(check).unwrap_or_else(|panic| {
                Err(format!("the module's check of it panicked: {}", end_of(panic)))
            })?;
        }
        self.io.settings.put(index, value.clone());
        Ok(value)
    }

    /// True if the module has to run whatever the time is.
    pub(crate) fn has_work(&self) -> bool {
        // What is not active has none to answer requests, but has to refuse them.
        let has_requests = || self.io.servers.iter().any(|server| server.has_requests());
        let has_input = || {
            self.io.settings.has_changes()
                || self.io.jobs.iter().any(|job| job.has_results())
                || self.io.clients.iter().any(|client| client.has_replies())
        };
        let has_cause = || {
            !self.transitions.is_empty()
                || has_requests()
                || self.state == LifecycleState::Active && has_input()
        };
        match self.hold {
            Hold::Held => false,
            Hold::Step => true,
            Hold::Free => has_cause(),
        }
    }

    /// Time has gone back to `now`.
    #[cold]
    pub(crate) fn go_back(&mut self, now: Time) {
        self.io.timers.iter_mut().for_each(|timer| timer.go_back(now));
    }

    /// When the next timer fires, the next task is due, or the next call is given up.
    pub(crate) fn next_due(&self) -> Time {
        if self.state != LifecycleState::Active || self.hold == Hold::Held {
            return Time::MAX;
        }
        let timers = self.io.timers.iter().map(|timer| timer.due());
        if self.is_simple {
            return timers.min().unwrap_or(Time::MAX);
        }
        let calls = self.io.clients.iter().map(|client| client.due());
        timers.chain(calls).fold(self.io.tasks.due(), Time::min)
    }

    /// Runs what is due inside a cycle. Returns what it asked for.
    #[inline]
    pub(crate) fn run(&mut self, shared: &Shared, now: Time) -> Asked {
        if spans_are_on() { self.run_in_span(shared, now) } else { self.run_in_cycle(shared, now) }
    }

    #[cold]
    fn run_in_span(&mut self, shared: &Shared, now: Time) -> Asked {
        let _span = tracing::trace_span!("run", module = &*self.io.name).entered();
        self.run_in_cycle(shared, now)
    }

    fn run_in_cycle(&mut self, shared: &Shared, now: Time) -> Asked {
        let mut received = 0;
        self.run_with(now, Some(shared), |behaviour, subscribed, ctx| {
            for (subscription, &topic) in subscribed.iter().enumerate() {
                if shared.topics.is_fresh(topic) {
                    received += shared.topics.meter(topic).last_batch();
                    behaviour.receive(subscription, &shared.topics, ctx);
                }
            }
        });
        self.meter.ran(received);
        self.take_asked()
    }

    /// What the module asked for since this was called last.
    #[inline]
    pub(crate) fn take_asked(&mut self) -> Asked {
        std::mem::take(&mut self.io.asked)
    }

    /// Runs what is due outside a cycle, on batches that were shared when it was.
    ///
    /// Batches of several cycles may have come together. A part receives them by order of subscription, as
    /// it would if they had come in one cycle: that is how replay gives them to it again. An observer, which
    /// is not replayed but may write down what it sees, receives them in the order of the cycles.
    pub(crate) fn run_detached(&mut self, deliveries: &VecDeque<Delivery>, role: Role, now: Time) {
        let _span = tracing::trace_span!("run", module = &*self.io.name).entered();
        self.run_with(now, None, |behaviour, subscribed, ctx| match role {
            Role::Part => {
                for (subscription, &topic) in subscribed.iter().enumerate() {
                    for delivery in deliveries.iter().filter(|delivery| delivery.topic == topic) {
                        behaviour.receive_shared(
                            subscription,
                            Arc::clone(&delivery.batch),
                            delivery.missed,
                            ctx,
                        );
                    }
                }
            }
            Role::Observer => {
                for delivery in deliveries {
                    let is_for = |&(_, &topic): &(usize, &usize)| topic == delivery.topic;
                    for (subscription, _) in subscribed.iter().enumerate().filter(is_for) {
                        behaviour.receive_shared(
                            subscription,
                            Arc::clone(&delivery.batch),
                            delivery.missed,
                            ctx,
                        );
                    }
                }
            }
        });
    }

    #[inline]
    fn run_with(
        &mut self,
        now: Time,
        shared: Option<&Shared>,
        receive: impl FnOnce(&mut dyn Behaviour, &[usize], &mut Context<'_>),
    ) {
        let is_plain =
            self.hold == Hold::Free && self.transitions.is_empty() && self.state == LifecycleState::Active;
        if !is_plain && !self.prepare(now, shared) {
            return;
        }
        let is_simple = self.is_simple;
        let _worn = self.badge.wear();
        let Self { io, behaviour: Some(behaviour), subscribed, watch, .. } = self else { return };
        if let Some(watch) = watch {
            watch.begin();
        }
        let outcome = catch_unwind(AssertUnwindSafe(|| {
            let (behaviour, ctx) = (&mut **behaviour, &mut Context::new(io, now, shared));
            if ctx.io().settings.has_changes() {
                take_settings(behaviour, ctx);
            }
            if is_simple {
                receive(behaviour, subscribed, ctx);
                fire_timers(behaviour, ctx);
                return;
            }
            let mark = ctx.io().tasks.mark();
            take_results(behaviour, ctx);
            receive(behaviour, subscribed, ctx);
            serve_and_resume(behaviour, ctx, mark);
            fire_timers(behaviour, ctx);
            behaviour.run_ends(ctx);
        }));
        if let Some(watch) = watch
            && watch.end()
        {
            self.meter.overran(1);
        }
        if let Err(panic) = outcome {
            self.end_by_panic(panic, None);
        }
    }
}

#[cold]
fn take_settings(behaviour: &mut dyn Behaviour, ctx: &mut Context<'_>) {
    while let Some(setting) = ctx.io().settings.take_change() {
        behaviour.setting_changed(setting, ctx);
    }
}

fn take_results(behaviour: &mut dyn Behaviour, ctx: &mut Context<'_>) {
    for job in 0..ctx.io().jobs.len() {
        if ctx.io().jobs[job].has_results() {
            behaviour.finished(job, ctx);
        }
    }
}

fn serve_and_resume(behaviour: &mut dyn Behaviour, ctx: &mut Context<'_>, mark: u64) {
    let now = ctx.now();
    for server in 0..ctx.io().servers.len() {
        if ctx.io().servers[server].has_requests() {
            behaviour.serve(server, ctx);
        }
    }
    for client in 0..ctx.io().clients.len() {
        let port = &ctx.io().clients[client];
        if port.has_replies() || port.due() <= now {
            behaviour.replied(client, ctx);
            ctx.io().asked.add(Asked::STATE);
        }
    }
    if ctx.io().tasks.due() <= now {
        while let Some(task) = ctx.io().tasks.take_due(now, mark) {
            behaviour.task(task.index as usize, ctx);
            ctx.io().asked.add(Asked::STATE);
        }
    }
}

#[inline]
fn fire_timers(behaviour: &mut dyn Behaviour, ctx: &mut Context<'_>) {
    let now = ctx.now();
    for timer in 0..ctx.io().timers.len() {
        if ctx.io().timers[timer].fire(now) {
            behaviour.tick(timer, ctx);
            ctx.io().asked.add(Asked::STATE);
        }
    }
}

impl Drop for ModuleCell {
    /// A module that panics while it is dropped takes neither the others nor the core with it.
    fn drop(&mut self) {
        let behaviour = self.behaviour.take();
        if let Err(panic) = catch_unwind(AssertUnwindSafe(|| drop(behaviour))) {
            tracing::error!(module = &*self.io.name, "panicked while it was dropped: {}", end_of(panic));
        }
        drop_guarded("a message", || self.io.discard());
    }
}
