//! A module as the core keeps it: its state, its outboxes, and what it has to do next.

use std::any::Any;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use crate::behaviour::Behaviour;
use crate::context::ModuleIo;
use crate::guard::{drop_guarded, reason};
use crate::outbox::{AnyOutbox, Outboxes};
use crate::setting::Settings;
use crate::topic::Topics;
use crate::{Context, Role, SettingInfo, SettingValue, Time};

pub(crate) struct ModuleCell {
    io: ModuleIo,
    /// Always there until the cell is dropped.
    behaviour: Option<Box<dyn Behaviour>>,
    /// The topic of each subscription.
    subscribed: Vec<usize>,
    /// Subscriptions whose topics carry messages of the last cycle.
    pending: Vec<usize>,
    life: Life,
}

#[derive(Clone, Copy, PartialEq)]
enum Life {
    New,
    Running,
    Ended,
}

/// A batch on its way to a module on another thread, for all its subscriptions of the topic.
pub(crate) struct Delivery {
    pub(crate) topic: usize,
    pub(crate) batch: Arc<dyn Any + Send + Sync>,
    pub(crate) messages: u32,
}

impl ModuleCell {
    pub(crate) fn new(io: ModuleIo, behaviour: Box<dyn Behaviour>, subscribed: Vec<usize>) -> Self {
        Self { io, behaviour: Some(behaviour), subscribed, pending: Vec::new(), life: Life::New }
    }

    pub(crate) fn name(&self) -> &Arc<str> {
        &self.io.name
    }

    pub(crate) fn settings(&self) -> &[SettingInfo] {
        self.io.settings.infos()
    }

    pub(crate) fn set(&mut self, setting: &str, value: SettingValue) -> Result<(), String> {
        self.io.settings.set(setting, value)
    }

    pub(crate) fn receive_later(&mut self, subscription: usize) {
        self.pending.push(subscription);
    }

    /// True after the last callback, or after a panic.
    pub(crate) fn has_ended(&self) -> bool {
        self.life == Life::Ended
    }

    /// True if the module has to run whatever the time is.
    pub(crate) fn has_work(&self) -> bool {
        match self.life {
            Life::New => true,
            Life::Running => !self.pending.is_empty() || self.io.settings.has_changes(),
            Life::Ended => false,
        }
    }

    /// When the next timer fires.
    pub(crate) fn next_due(&self) -> Time {
        match self.life {
            Life::Running => self.io.timers.iter().map(|timer| timer.due()).min().unwrap_or(Time::MAX),
            Life::New | Life::Ended => Time::MAX,
        }
    }

    /// Runs what is due inside a cycle: start, setting changes, messages, timers.
    pub(crate) fn run(&mut self, topics: &Topics, now: Time) {
        let mut pending = std::mem::take(&mut self.pending);
        // The order of subscriptions, not of the cycle's first publishers.
        pending.sort_unstable();
        self.run_with(now, |behaviour, ctx| {
            for &subscription in &pending {
                behaviour.receive(subscription, topics, ctx);
            }
        });
        pending.clear();
        self.pending = pending;
    }

    /// Runs what is due outside a cycle, on batches that were shared when it was.
    ///
    /// Batches of several cycles may have come together. A part receives them by order of subscription, as
    /// it would if they had come in one cycle: that is how replay gives them to it again. An observer, which
    /// is not replayed but may write down what it sees, receives them in the order of the cycles.
    pub(crate) fn run_detached(&mut self, deliveries: &VecDeque<Delivery>, role: Role, now: Time) {
        let subscribed = std::mem::take(&mut self.subscribed);
        self.run_with(now, |behaviour, ctx| match role {
            Role::Part => {
                for (subscription, &topic) in subscribed.iter().enumerate() {
                    for delivery in deliveries.iter().filter(|delivery| delivery.topic == topic) {
                        behaviour.receive_shared(subscription, Arc::clone(&delivery.batch), ctx);
                    }
                }
            }
            Role::Observer => {
                for delivery in deliveries {
                    let is_for = |&(_, &topic): &(usize, &usize)| topic == delivery.topic;
                    for (subscription, _) in subscribed.iter().enumerate().filter(is_for) {
                        behaviour.receive_shared(subscription, Arc::clone(&delivery.batch), ctx);
                    }
                }
            }
        });
        self.subscribed = subscribed;
    }

    /// Runs the module's last callback.
    pub(crate) fn stop(&mut self, now: Time) {
        if self.life == Life::Running {
            self.guarded(now, |behaviour, ctx| behaviour.stop(ctx));
        }
        self.life = Life::Ended;
    }

    /// Hands out each outbox that holds messages.
    pub(crate) fn drain_outboxes(&mut self, consume: impl FnMut(&mut dyn AnyOutbox)) {
        self.io.outboxes.drain(consume);
    }

    fn run_with(&mut self, now: Time, receive: impl FnOnce(&mut dyn Behaviour, &mut Context<'_>)) {
        if self.life == Life::Ended {
            return;
        }
        let is_new = self.life == Life::New;
        self.life = Life::Running;
        self.guarded(now, |behaviour, ctx| {
            if is_new {
                behaviour.start(ctx);
                ctx.io().timers.iter_mut().for_each(|timer| timer.start(now));
            }
            while let Some(setting) = ctx.io().settings.take_change() {
                behaviour.setting_changed(setting, ctx);
            }
            receive(behaviour, ctx);
            for timer in 0..ctx.io().timers.len() {
                if ctx.io().timers[timer].fire(now) {
                    behaviour.tick(timer, ctx);
                }
            }
        });
    }

    /// A panic ends the module, and only it: what it published in this run is discarded.
    fn guarded(&mut self, now: Time, run: impl FnOnce(&mut dyn Behaviour, &mut Context<'_>)) {
        let Self { io, behaviour: Some(behaviour), .. } = self else { return };
        let outcome = catch_unwind(AssertUnwindSafe(|| run(&mut **behaviour, &mut Context::new(io, now))));
        if let Err(panic) = outcome {
            self.life = Life::Ended;
            drop_guarded("a message", || self.io.outboxes.discard());
            let reason = reason(&*panic);
            tracing::error!(module = &*self.io.name, "panicked and is stopped, the others go on: {reason}");
        }
    }
}

impl Drop for ModuleCell {
    /// A module that panics while it is dropped takes neither the others nor the core with it.
    fn drop(&mut self) {
        let behaviour = self.behaviour.take();
        if let Err(panic) = catch_unwind(AssertUnwindSafe(|| drop(behaviour))) {
            tracing::error!(module = &*self.io.name, "panicked while it was dropped: {}", reason(&*panic));
        }
    }
}

impl ModuleIo {
    pub(crate) fn new(name: &str) -> Self {
        let (outboxes, settings, timers) = (Outboxes::default(), Settings::default(), Vec::new());
        Self { name: Arc::from(name), outboxes, settings, timers }
    }
}
