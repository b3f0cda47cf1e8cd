//! The mechanism "messaging": makes the messages of a cycle the batches of the next one.

use std::sync::Arc;

use crate::asked::Asked;
use crate::cell::Delivery;
use crate::core::SyncPhase;
use crate::detached::{DetachedModule, StepOutcome};
use crate::event::ModuleEventKind;
use crate::join::{DetachedStep, StepInput};
use crate::management::Place;
use crate::mechanism::{Mechanism, Version};
use crate::messaging::{Outbox, Subscriber, Topics};
use crate::{Role, Time};

/// Messages from outside the cycle come first: those of inlets in the order in which the inlets were made, those of
/// detached modules in the order in which these ran; then those of the modules, in the order of registration.
pub(crate) struct Messaging;

impl Mechanism for Messaging {
    type View = ();
    type Request = ();

    const NAME: &'static str = "messaging";
    const VERSION: Version = Version::new(1, 0);

    fn view(&self) {}

    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        phase.stage.shared.topics.begin();
        if phase.world.queue.take_inlet_announcement() {
            take_inlets(phase);
        }
        if !phase.world.changes.is_empty() {
            tell_changes(phase);
        }
        if !phase.world.events.is_empty() {
            tell_events(phase);
        }
        if phase.has(Asked::JOINED) {
            join_steps(phase);
        }
        if phase.has(Asked::MESSAGES) {
            take_outboxes(phase);
        }
        phase.stage.shared.topics.finish();
        distribute(phase);
    }
}

#[inline(never)] // Together with the rest it makes every sync phase slower.
fn take_inlets(phase: &mut SyncPhase<'_>) {
    let (topics, now) = (&mut phase.stage.shared.topics, phase.now);
    for inlet in &mut phase.world.inlets {
        inlet.drain(topics, now);
    }
    phase.world.inlets.retain(|inlet| {
        let is_orphaned = inlet.is_orphaned();
        if is_orphaned {
            topics.release_publisher(inlet.topic());
        }
        !is_orphaned
    });
}

fn take_outboxes(phase: &mut SyncPhase<'_>) {
    let SyncPhase { stage, world, now, .. } = phase;
    for asker in world.askers.iter().filter(|asker| asker.asked.has(Asked::MESSAGES)) {
        if let (Some(cell), shared) = stage.cell_and_shared(asker.module.slot) {
            let mut messages = 0;
            cell.io.outboxes.drain(|outbox| messages += shared.topics.absorb(outbox, *now));
            cell.meter.published(messages);
        }
    }
}

fn distribute(phase: &mut SyncPhase<'_>) {
    let SyncPhase { stage, world, .. } = phase;
    let topics = &mut stage.shared.topics;
    let (mut is_any_detached, mut is_any_outlet) = (false, false);
    for &topic in topics.fresh() {
        for subscriber in topics.subscribers(topic) {
            match *subscriber {
                Subscriber::Attached(slot) => world.agenda.wake(slot),
                Subscriber::Detached(slot) => {
                    is_any_detached = true;
                    deliver(topics, topic, world.detached[slot].as_mut());
                }
                Subscriber::Outlet(slot) => {
                    is_any_outlet = true;
                    world.outlets.deliver(topics, slot);
                }
            }
        }
    }
    if is_any_detached {
        world.detached.iter_mut().flatten().for_each(DetachedModule::dispatch);
    }
    if is_any_outlet {
        world.outlets.dispatch(topics);
    }
}

#[inline(never)]
fn deliver(topics: &Topics, topic: usize, module: Option<&mut DetachedModule>) {
    if let Some(module) = module {
        let (batch, messages) = topics.share(topic);
        module.deliver(Delivery { topic, batch, messages, missed: 0 });
    }
}

#[inline(never)]
fn join_steps(phase: &mut SyncPhase<'_>) {
    for step in std::mem::take(&mut phase.world.joined.steps) {
        join_step(phase, step);
    }
}

fn join_step(phase: &mut SyncPhase<'_>, outcome: StepOutcome) {
    let Some(member) = phase.world.members.get(outcome.module.order) else { return };
    let (role, module) = (member.role(), Arc::clone(&member.name));
    if outcome.taken > 0 {
        let (step, count) = (outcome.step, outcome.taken);
        phase.note_event_of(outcome.module, |module| ModuleEventKind::Taken { module, step, count });
    }
    let topics = &mut phase.stage.shared.topics;
    let (now, cycle) = (phase.now, phase.world.cycle);
    let mut published = 0;
    for mut outbox in outcome.outboxes {
        published += topics.absorb(&mut *outbox, now);
    }
    let mut received = 0;
    for input in &outcome.inputs {
        received += input.received as usize;
        topics.meter_mut(input.topic).dropped(u64::from(input.skipped));
    }
    if let Place::Detached(slot) = outcome.module.place
        && let Some(detached) = phase.world.detached[slot].as_mut()
    {
        let meter = &mut detached.meter;
        meter.ran(received);
        meter.published(published);
        meter.dropped(outcome.inputs.iter().map(|input| u64::from(input.skipped)).sum());
        if let Some(span) = &outcome.span {
            phase.world.inspector.stepped(meter, &module, cycle, span);
        }
    }
    // An observer's steps are no input of the robot; and one that records steps would cause its next.
    let has_subscribers = |topic: &usize| !topics.subscribers(*topic).is_empty();
    let Some(topic) = phase.world.steps_topic.filter(has_subscribers).filter(|_| role == Role::Part) else {
        return;
    };
    let inputs = outcome.inputs.iter().map(|input| StepInput {
        topic: Arc::clone(topics.name(input.topic)),
        skipped: input.skipped,
        received: input.received,
    });
    let step = DetachedStep {
        time: outcome.time,
        module,
        step: outcome.step,
        cycle,
        is_stop: outcome.is_stop,
        inputs: inputs.collect(),
    };
    absorb_step(topics, topic, step, now);
}

#[cold]
fn tell_changes(phase: &mut SyncPhase<'_>) {
    let messages = std::mem::take(&mut phase.world.changes);
    if let Some(topic) = phase.world.changes_topic {
        phase.stage.shared.topics.absorb(&mut Outbox { topic, messages }, phase.now);
    }
}

#[cold]
fn tell_events(phase: &mut SyncPhase<'_>) {
    let messages = std::mem::take(&mut phase.world.events);
    if let Some(topic) = phase.world.events_topic {
        phase.stage.shared.topics.absorb(&mut Outbox { topic, messages }, phase.now);
    }
}

fn absorb_step(topics: &mut Topics, topic: usize, step: DetachedStep, now: Time) {
    topics.absorb(&mut Outbox { topic, messages: vec![step] }, now);
}
