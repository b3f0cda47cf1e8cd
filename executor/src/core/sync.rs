//! The sync phase: what was asked for during the process phase takes effect.

use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};

use super::{Core, exclusive};
use crate::cell::Delivery;
use crate::detached::{DetachedModule, StepOutcome};
use crate::join::{DetachedStep, Request, StepInput};
use crate::outbox::Outbox;
use crate::topic::{ModuleSlot, Subscriber, Topics};
use crate::{Role, SettingValue, Stage, Time};

impl Core {
    /// Settings first, then messages: those from outside the cycle in the order in which they came, then
    /// those of the modules in the order of registration.
    pub(super) fn sync(&mut self, now: Time) {
        let Self { stage, queue, detached, .. } = self;
        let stage = exclusive(stage);
        stage.topics.retire();
        for &index in &stage.runnable {
            self.has_work[index] = false;
        }
        // What comes while this runs waits for the next cycle, so that a busy thread cannot hold this one.
        for _ in 0..queue.len() {
            match queue.pop() {
                Some(Request::Set { module, setting, value }) => {
                    set(stage, detached, &mut self.has_work, &module, setting, value);
                }
                Some(Request::Messages { mut outbox, waiting }) => {
                    waiting.fetch_sub(1, Ordering::Relaxed);
                    stage.topics.absorb(&mut *outbox, now);
                }
                Some(Request::Step(outcome)) => {
                    let role = role_of(&self.registered, ModuleSlot::Detached(outcome.module));
                    let name = &detached[outcome.module].name;
                    join_step(&mut stage.topics, outcome, role, name, self.steps_topic, self.cycle, now);
                }
                None => break,
            }
        }
        let Stage { topics, modules, runnable, .. } = stage;
        for &index in &*runnable {
            let cell = modules[index].get_mut().unwrap_or_else(PoisonError::into_inner);
            cell.drain_outboxes(|outbox| topics.absorb(outbox, now));
            self.next_due[index] = cell.next_due();
        }
        self.distribute();
    }

    fn distribute(&mut self) {
        let Stage { topics, modules, .. } = exclusive(&mut self.stage);
        for (topic, subscribers) in topics.fresh() {
            for subscriber in subscribers {
                match *subscriber {
                    Subscriber::Attached { module, subscription } => {
                        let cell = modules[module].get_mut().unwrap_or_else(PoisonError::into_inner);
                        cell.receive_later(subscription);
                        self.has_work[module] = true;
                    }
                    Subscriber::Detached { module } => {
                        let (batch, messages) = topics.share(topic);
                        self.detached[module].deliver(Delivery { topic, batch, messages });
                    }
                }
            }
        }
    }
}

fn role_of(registered: &[(ModuleSlot, Role)], slot: ModuleSlot) -> Role {
    registered.iter().find(|(known, _)| *known == slot).map_or(Role::Part, |&(_, role)| role)
}

fn set(
    stage: &mut Stage,
    detached: &[DetachedModule],
    has_work: &mut [bool],
    module: &str,
    setting: String,
    value: SettingValue,
) {
    if let Some(module) = detached.iter().find(|known| *known.name == *module) {
        return module.set(setting, value);
    }
    for (index, has_work) in has_work.iter_mut().enumerate() {
        let cell = stage.cell(index);
        if **cell.name() == *module {
            if let Err(refusal) = cell.set(&setting, value) {
                tracing::warn!(module, setting, "setting not changed: {refusal}");
            }
            *has_work |= cell.has_work();
            return;
        }
    }
    tracing::warn!(module, setting, "setting not changed: there is no such module");
}

fn join_step(
    topics: &mut Topics,
    outcome: StepOutcome,
    role: Role,
    module: &Arc<str>,
    steps_topic: Option<usize>,
    cycle: u64,
    now: Time,
) {
    for mut outbox in outcome.outboxes {
        topics.absorb(&mut *outbox, now);
    }
    // An observer's steps are no input of the robot; and one that records steps would cause its next.
    let Some(topic) = steps_topic.filter(|&topic| role == Role::Part && topics.has_subscribers(topic)) else {
        return;
    };
    let inputs = outcome.inputs.iter().map(|input| StepInput {
        topic: Arc::clone(topics.name(input.topic)),
        skipped: input.skipped,
        received: input.received,
    });
    let step = DetachedStep {
        time: outcome.time,
        module: Arc::clone(module),
        step: outcome.step,
        cycle,
        is_stop: outcome.is_stop,
        inputs: inputs.collect(),
    };
    topics.absorb(&mut Outbox { topic, messages: vec![step] }, now);
}
