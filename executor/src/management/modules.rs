//! The mechanism "modules": adds, removes, pauses and restarts modules, and has them make transitions.

use std::sync::Arc;
use std::time::Duration;

use crate::agenda::{Asker, Ready};
use crate::asked::Asked;
use crate::core::SyncPhase;
use crate::detached::Parcel;
use crate::event::{ModuleCommand, ModuleEventKind};
use crate::inspect::ModuleMeter;
use crate::management::admission::{instate, release, release_services};
use crate::management::{Command, Place, UnknownModule, admit};
use crate::mechanism::{Mechanism, Version};
use crate::receipt::ReceiptSender;
use crate::{ModuleId, Restart, TransitionRefused};

/// Modules whose back-off is over start again first; then panics are noticed; then modules are removed, and then the
/// other commands follow: those of other threads before those of modules.
pub(crate) struct Modules;

impl Mechanism for Modules {
    type View = ();
    type Request = ();

    const NAME: &'static str = "modules";
    const VERSION: Version = Version::new(1, 0);

    fn view(&self) {}

    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        // Before panics are noticed, for a restart clears what the module asked for: what it published before its panic
        // has yet to join, in this sync phase.
        if !phase.world.restarts.is_empty() && !phase.world.queue.is_closed() {
            restart_due(phase);
        }
        notice_changes(phase);
        phase.for_each_that_asked(Asked::COMMANDS, |io, world| {
            let by = Some(io.id);
            world.joined.commands.extend(io.commands.drain(..).map(|command| (by, command)));
        });
        if !phase.world.joined.commands.is_empty() {
            let commands = std::mem::take(&mut phase.world.joined.commands);
            let (removals, others): (Vec<_>, Vec<_>) =
                commands.into_iter().partition(|(_, command)| matches!(command, Command::Remove { .. }));
            removals.into_iter().chain(others).for_each(|(by, command)| apply(phase, by, command));
        }
    }
}

fn notice_changes(phase: &mut SyncPhase<'_>) {
    for index in 0..phase.world.askers.len() {
        let Asker { module, asked } = phase.world.askers[index];
        let cell = phase.stage.cell(module.slot).filter(|_| asked.has(Asked::PANIC));
        if let Some(panic) = cell.and_then(|cell| cell.take_panic()) {
            notice_panic(phase, module.order, &panic);
        }
    }
    for index in 0..phase.world.joined.steps.len() {
        let step = &mut phase.world.joined.steps[index];
        let (id, panic, is_stop) = (step.module, step.panic.take(), step.is_stop);
        if let Place::Detached(slot) = id.place
            && let Some(module) = phase.world.detached[slot].as_mut().filter(|module| module.id == id)
        {
            let change = module.note(step);
            if panic.is_some() {
                module.meter.panicked();
            }
            if let Some(change) = change {
                phase.note_change(id, change);
            }
        }
        if let Some(panic) = panic {
            notice_panic(phase, id.order, &panic);
        }
        // Those that stay: all, where it is the core that stops, and who was put in its place by a restart.
        let is_member = phase.world.members.get(id.order).is_some_and(|member| member.id == id);
        if is_stop && is_member && phase.world.members.is_leaving(id.order) {
            phase.world.leaving.push(id.order);
        }
    }
}

fn notice_panic(phase: &mut SyncPhase<'_>, order: u64, reason: &str) {
    // Who was removed does not come back, nor does anybody while the core stops.
    let is_final = phase.world.queue.is_closed() || phase.world.members.is_leaving(order);
    let Some(member) = phase.world.members.get_mut(order) else { return };
    let module = &*member.name;
    let backoff = match member.options.restart {
        _ if is_final => {
            tracing::error!(module, "panicked at its end: {reason}");
            return;
        }
        Restart::Times { limit, backoff } if member.restarts < limit => backoff,
        Restart::Always { backoff } => backoff,
        Restart::Never | Restart::Times { .. } => {
            tracing::error!(module, "panicked and is stopped, the others go on: {reason}");
            return;
        }
    };
    if phase.now.saturating_since(member.started) > Restart::LONGEST_BACKOFF {
        member.panics_in_a_row = 0;
    }
    let pause = lengthened(backoff, member.panics_in_a_row);
    member.panics_in_a_row += 1;
    tracing::error!(
        module,
        "panicked and is stopped, to start again in {pause:?}; the others go on: {reason}"
    );
    phase.world.restarts.push((phase.now + pause, order));
}

fn lengthened(backoff: Duration, doublings: u32) -> Duration {
    let longest = Restart::LONGEST_BACKOFF.max(backoff);
    backoff.saturating_mul(1_u32.checked_shl(doublings).unwrap_or(u32::MAX)).min(longest)
}

fn restart_due(phase: &mut SyncPhase<'_>) {
    let now = phase.now;
    let (due, later): (Vec<_>, Vec<_>) = phase.world.restarts.drain(..).partition(|&(time, _)| time <= now);
    phase.world.restarts = later;
    for (_, order) in due {
        restart(phase, order);
    }
}

fn restart(phase: &mut SyncPhase<'_>, order: u64) {
    let Some(mut member) = phase.world.members.take(order) else { return };
    release(phase.stage, phase.world, &mut member);
    member.meter = vacate(phase, member.id);
    if let Some(meter) = &mut member.meter {
        meter.restarted();
    }
    phase.world.gone.push(member.id);
    member.restarts += 1;
    member.id.life += 1;
    member.started = phase.now;
    let (module, restarts) = (Arc::clone(&member.name), member.restarts);
    match instate(phase.stage, phase.world, &mut member) {
        Ok(()) => {
            phase.world.members.insert(member);
            tracing::info!(module = &*module, restarts, "starts again after its panic");
        }
        Err(error) => {
            tracing::error!("not started again after its panic: {error}");
            if let Place::Attached(slot) = member.id.place {
                phase.world.freed_slots.push(slot);
            }
        }
    }
}

/// Drops the module in the place. What it counted is left.
fn vacate(phase: &mut SyncPhase<'_>, id: ModuleId) -> Option<ModuleMeter> {
    match id.place {
        Place::Attached(slot) => {
            phase.world.agenda.leave(slot);
            let mut cell = phase.stage.take_cell(slot)?;
            // Those who wait for it are told in this sync phase that they wait in vain.
            for server in &mut cell.io.servers {
                let service = Arc::clone(server.name());
                server.drain_answers(&mut |to, reply| {
                    phase.world.joined.answers.push((to, Arc::clone(&service), reply.take_boxed()));
                });
            }
            Some(std::mem::take(&mut cell.meter))
        }
        Place::Detached(slot) => {
            phase.world.detached[slot].take().map(|mut module| std::mem::take(&mut module.meter))
        }
    }
}

/// Frees what the modules held that were removed: at the end of the sync phase, when their last messages are on their
/// way.
pub(crate) fn finish_leaving(phase: &mut SyncPhase<'_>) {
    let leaving = std::mem::take(&mut phase.world.leaving);
    let members = leaving.into_iter().filter_map(|order| phase.world.members.take(order)).collect::<Vec<_>>();
    for mut member in members {
        let SyncPhase { stage, world, .. } = phase;
        release(stage, world, &mut member);
        drop(vacate(phase, member.id));
        if let Place::Attached(slot) = member.id.place {
            phase.world.freed_slots.push(slot);
        }
        phase.world.gone.push(member.id);
    }
}

/// Has a command told that a module is given.
fn note(phase: &mut SyncPhase<'_>, id: ModuleId, by: Option<ModuleId>, command: ModuleCommand) {
    let asker = by.and_then(|by| phase.world.members.get(by.order));
    let by = asker.map(|member| Arc::clone(&member.name));
    phase.note_event_of(id, |module| ModuleEventKind::Command { module, command, by });
}

fn apply(phase: &mut SyncPhase<'_>, by: Option<ModuleId>, command: Command) {
    if phase.world.drops_commands_to_self
        && let Some(by) = by
        && command.target().is_some_and(|target| phase.module_name(by) == Some(target))
    {
        return;
    }
    match command {
        Command::Add { candidate, receipt } => {
            let result = admit(phase.stage, phase.world, *candidate);
            if let (Err(error), None) = (&result, &receipt) {
                tracing::error!("not added: {error}");
            }
            answer(receipt, result);
        }
        Command::Remove { module, receipt } => {
            let result = find(phase, &module).map(|id| {
                note(phase, id, by, ModuleCommand::Remove);
                remove(phase, id);
            });
            tell(receipt, "not removed", result);
        }
        Command::Pause { module, receipt } => {
            let result = find(phase, &module).map(|id| {
                note(phase, id, by, ModuleCommand::Pause);
                hold(phase, id, Parcel::Pause);
            });
            tell(receipt, "not paused", result);
        }
        Command::Resume { module, receipt } => {
            let result = find(phase, &module).map(|id| {
                note(phase, id, by, ModuleCommand::Resume);
                hold(phase, id, Parcel::Resume);
            });
            tell(receipt, "not resumed", result);
        }
        Command::Step { module, receipt } => {
            let result = find(phase, &module).map(|id| {
                note(phase, id, by, ModuleCommand::Step);
                hold(phase, id, Parcel::StepOnce);
            });
            tell(receipt, "not stepped", result);
        }
        Command::Transition { module, transition, receipt } => match find(phase, &module) {
            Ok(id) => {
                note(phase, id, by, ModuleCommand::Transition(transition));
                match id.place {
                    Place::Attached(slot) => {
                        if let Some(cell) = phase.stage.cell(slot) {
                            cell.transition_later(transition, receipt);
                        }
                        phase.wake(id);
                    }
                    Place::Detached(slot) => {
                        if let Some(module) = &phase.world.detached[slot] {
                            module.send(Parcel::Transition { transition, receipt });
                        }
                    }
                }
            }
            Err(unknown) => {
                tracing::warn!("{transition} not made: {unknown}");
                answer(receipt, Err(TransitionRefused::UnknownModule { module: unknown.module }));
            }
        },
        Command::Look(look) => look(phase.stage, phase.world),
        Command::Set { .. } | Command::Transfer { .. } => phase.world.joined.settings.push(command),
    }
}

pub(crate) fn find(phase: &SyncPhase<'_>, module: &str) -> Result<ModuleId, UnknownModule> {
    phase.world.members.find(module).map(|member| member.id).ok_or_else(|| {
        let known: Vec<_> = phase.world.members.names().map(|name| format!("\"{name}\"")).collect();
        let known = if known.is_empty() { "none".into() } else { known.join(", ") };
        UnknownModule { module: Arc::from(module), known }
    })
}

fn remove(phase: &mut SyncPhase<'_>, id: ModuleId) {
    let SyncPhase { stage, world, now, asked } = phase;
    world.restarts.retain(|&(_, order)| order != id.order);
    let Some(name) = world.members.get(id.order).map(|member| Arc::clone(&member.name)) else { return };
    world.members.forget_name(&name);
    match id.place {
        Place::Attached(slot) => {
            if let (Some(cell), shared) = stage.cell_and_shared(slot) {
                cell.shutdown(Some(shared), *now);
                world.has_joined |= !cell.io.commands.is_empty();
                world.joined.commands.extend(cell.io.commands.drain(..).map(|command| (Some(id), command)));
                let what = cell.take_asked();
                asked.add(what);
                world.note_asker(Asker { module: Ready { order: id.order, slot }, asked: what });
                if let Some(panic) = cell.take_panic() {
                    tracing::error!(module = &*name, "panicked in its shutdown: {panic}");
                }
            }
            world.leaving.push(id.order);
        }
        Place::Detached(slot) => {
            if let Some(module) = &world.detached[slot] {
                module.request_stop();
            }
        }
    }
    if let Some(mut member) = world.members.take(id.order) {
        release_services(world, &mut member);
        world.members.insert_nameless(member);
    }
}

fn hold(phase: &mut SyncPhase<'_>, id: ModuleId, parcel: Parcel) {
    match id.place {
        Place::Attached(slot) => {
            if let Some(cell) = phase.stage.cell(slot) {
                match parcel {
                    Parcel::Pause => cell.pause(),
                    Parcel::StepOnce => cell.step_once(),
                    _ => cell.resume(),
                }
                // What fell due while it was held was forgotten.
                let due = cell.next_due();
                phase.world.agenda.wake_at(slot, due);
            }
            phase.wake(id);
        }
        Place::Detached(slot) => {
            if let Some(module) = &mut phase.world.detached[slot] {
                module.is_paused = !matches!(parcel, Parcel::Resume);
                module.send(parcel);
            }
        }
    }
}

fn answer<T: Send + 'static>(receipt: Option<ReceiptSender<T>>, answer: T) {
    if let Some(receipt) = receipt {
        receipt.send(answer);
    }
}

fn tell(
    receipt: Option<ReceiptSender<Result<(), UnknownModule>>>,
    what: &str,
    result: Result<(), UnknownModule>,
) {
    if let (Err(unknown), None) = (&result, &receipt) {
        tracing::warn!("{what}: {unknown}");
    }
    answer(receipt, result);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_back_off_doubles_up_to_its_longest() {
        let second = Duration::from_secs(1);
        let pauses: Vec<_> = (0..7).map(|panics| lengthened(second, panics).as_secs()).collect();
        assert_eq!(pauses, [1, 2, 4, 8, 16, 30, 30]);
        assert_eq!(lengthened(2 * Restart::LONGEST_BACKOFF, 3), 2 * Restart::LONGEST_BACKOFF);
        assert_eq!(lengthened(second, 200), Restart::LONGEST_BACKOFF);
    }
}
