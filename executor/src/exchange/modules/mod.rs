//! The mechanism "modules": adds, removes, pauses and restarts modules, and starts their transitions.

mod admission;
mod api;

use std::any::Any;
use std::sync::Arc;
use std::time::Duration;

use admission::{Candidate, admit, hold_place, instate};

use super::events::{ModuleCommand, ModuleEventKind, note_event_of};
use super::messages::DetachedStep;
use crate::cycle::Asker;
use crate::module::{Asked, Causes, Hold, Input, MODULES, Place, StepOutcome, UseEnds};
use crate::threads::ReceiptSender;
use crate::{
    LifecycleState, Mechanism, ModuleChange, ModuleId, Port, Restart, SetupError, Step, SyncPhase, Time,
    Transition, TransitionRefused, Version,
};

/// The order of a sync phase is: restarts whose back-off is over; panics; removals; then the other commands,
/// those of other threads before those of modules.
#[derive(Default)]
pub(crate) struct Modules {
    /// Pending commands, each with the module that sent it; `None` for another thread.
    commands: Vec<(Option<ModuleId>, Command)>,
}

/// A command that takes effect in the next sync phase.
enum Command {
    Add {
        candidate: Box<Candidate>,
        /// The module to add if the setup of the candidate fails.
        fallback: Option<Box<Candidate>>,
        receipt: Option<ReceiptSender<Result<(), SetupError>>>,
    },
    /// Pauses, resumes, steps or removes a module.
    Change { module: String, change: Change, receipt: Option<ReceiptSender<Result<(), UnknownModule>>> },
    Transition {
        module: String,
        transition: Transition,
        receipt: Option<ReceiptSender<Result<LifecycleState, TransitionRefused>>>,
    },
    /// Constructs a stopped module again.
    Restart { module: String, receipt: Option<ReceiptSender<Result<(), RestartRefused>>> },
    /// Calls a closure with the core between two cycles.
    Look(Look),
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Change {
    Remove,
    Hold(Hold),
}

type Look = Box<dyn FnOnce(&mut SyncPhase<'_>) + Send>;

/// The core has no module of this name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no module \"{module}\"; there is {known}")]
pub struct UnknownModule {
    /// The given name.
    pub module: Arc<str>,
    /// The existing names.
    pub known: String,
}

/// The reason why a module is not restarted.
#[derive(Debug, thiserror::Error)]
pub enum RestartRefused {
    /// There is no such module.
    #[error(transparent)]
    UnknownModule(#[from] UnknownModule),
    /// The module is running.
    #[error("module \"{module}\" is running; only a stopped or inactive module can be restarted")]
    Runs {
        /// The module.
        module: String,
    },
    /// The module cannot be constructed again, or its setup failed. It stays stopped.
    #[error(transparent)]
    Setup(#[from] SetupError),
}

impl Command {
    /// The module that has to carry out the command; `None` for additions, removals and restarts.
    fn target(&self) -> Option<&str> {
        match self {
            Self::Change { module, change: Change::Hold(_), .. } | Self::Transition { module, .. } => {
                Some(module)
            }
            Self::Add { .. } | Self::Change { .. } | Self::Restart { .. } | Self::Look(_) => None,
        }
    }

    fn is_removal(&self) -> bool {
        matches!(self, Self::Change { change: Change::Remove, .. })
    }
}

impl Change {
    /// The command as reported in events.
    fn event(self) -> ModuleCommand {
        match self {
            Self::Remove => ModuleCommand::Remove,
            Self::Hold(Hold::Held) => ModuleCommand::Pause,
            Self::Hold(Hold::Free) => ModuleCommand::Resume,
            Self::Hold(Hold::Step) => ModuleCommand::Step,
        }
    }

    /// The log text if there is no such module.
    fn failure(self) -> &'static str {
        match self {
            Self::Remove => "not removed",
            Self::Hold(Hold::Held) => "not paused",
            Self::Hold(Hold::Free) => "not resumed",
            Self::Hold(Hold::Step) => "not stepped",
        }
    }
}

/// The commands of one module.
#[derive(Default)]
pub(crate) struct ModulesPort(Vec<Command>);

impl Port for ModulesPort {
    fn changed(&mut self, change: ModuleChange<'_>) -> bool {
        if let ModuleChange::Panicked = change {
            self.0.clear();
        }
        false
    }

    fn split_off(&mut self) -> Option<Box<dyn Any + Send>> {
        Some(Box::new(std::mem::take(&mut self.0)))
    }
}

impl Mechanism for Modules {
    type View = ();
    type Port = ModulesPort;

    const NAME: &'static str = "modules";
    const VERSION: Version = Version::new(1, 0);

    fn view(&self) {}

    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        // Restarts come before panics are noticed, because a restart clears the module's requests, and the
        // messages published before a new panic are still to be sent in this sync phase.
        if !phase.state.restarts.is_empty() && !phase.state.link.is_closed() {
            self.restart_due(phase);
        }
        self.notice_panics(phase);
        let steps = std::mem::take(&mut phase.state.steps);
        steps.iter().for_each(|step| self.notice_step(phase, step));
        phase.state.steps = steps;
        phase.each_asker(MODULES, |cell, _| {
            let by = Some(cell.io.id);
            if let Some(ModulesPort(commands)) = cell.port(MODULES) {
                self.commands.extend(commands.drain(..).map(|command| (by, command)));
            }
        });
        if !self.commands.is_empty() {
            let commands = std::mem::take(&mut self.commands);
            let (removals, others): (Vec<_>, Vec<_>) =
                commands.into_iter().partition(|(_, command)| command.is_removal());
            removals.into_iter().chain(others).for_each(|(by, command)| self.apply(phase, by, command));
        }
        let due = phase.state.restarts.iter().map(|&(due, _)| due).min();
        phase.mechanisms.set_due(MODULES, due.unwrap_or(Time::MAX));
    }

    fn join(&mut self, step: Step, part: Box<dyn Any + Send>) {
        if let Ok(commands) = part.downcast::<Vec<Command>>() {
            self.commands.extend(commands.into_iter().map(|command| (Some(step.module), command)));
        }
    }

    fn paused(&mut self, phase: &mut SyncPhase<'_>) {
        for (by, command) in std::mem::take(&mut self.commands) {
            match command {
                Command::Look(look) => look(phase),
                other => self.commands.push((by, other)),
            }
        }
    }

    fn started(&mut self, phase: &mut SyncPhase<'_>) {
        phase.topics().open_report::<DetachedStep>();
    }
}

impl Modules {
    fn notice_panics(&mut self, phase: &mut SyncPhase<'_>) {
        let mut panics = Vec::new();
        phase.each_asker(MODULES, |cell, _| {
            panics.extend(cell.take_panic().map(|panic| (cell.io.id.order, panic)));
        });
        panics.into_iter().for_each(|(order, panic)| self.notice_panic(phase, order, &panic));
    }

    /// Applies the state changes of a detached module's run.
    fn notice_step(&mut self, phase: &mut SyncPhase<'_>, step: &StepOutcome) {
        let id = step.module;
        if let Some(module) = phase.state.detached(id) {
            module.state = step.state;
            module.meter.overran(step.overruns);
            if step.panic.is_some() {
                module.meter.panicked();
            }
        }
        if step.taken > 0 {
            let (step, count) = (step.number, step.taken);
            note_event_of(phase, id, |module| ModuleEventKind::Taken { module, step, count });
        }
        if let Some(panic) = &step.panic {
            self.notice_panic(phase, id.order, panic);
        }
        // Other modules stay: all of them while the core stops, and the new instance after a restart.
        let members = &phase.state.members;
        let is_member = members.get(id.order).is_some_and(|member| member.id == id);
        if step.is_stop && is_member && members.is_leaving(id.order) {
            phase.state.leave(id.order);
        }
    }

    fn notice_panic(&mut self, phase: &mut SyncPhase<'_>, order: u64, reason: &str) {
        // A removed module is not restarted, and no module is restarted while the core stops.
        let is_final = phase.state.link.is_closed() || phase.state.members.is_leaving(order);
        let now = phase.now();
        let Some(member) = phase.state.members.get_mut(order) else { return };
        member.panic = Some(reason.into());
        let module = &*member.name;
        let backoff = match member.options.restart {
            _ if is_final => {
                tracing::error!(module, "panicked while it was stopping: {reason}");
                return;
            }
            Restart::Times { limit, backoff } if member.restarts < limit => backoff,
            Restart::Always { backoff } => backoff,
            Restart::Never | Restart::Times { .. } => {
                tracing::error!(module, "panicked and was stopped; the other modules continue: {reason}");
                return;
            }
        };
        if now.saturating_since(member.started) > Restart::LONGEST_BACKOFF {
            member.panics_in_a_row = 0;
        }
        let pause = lengthened(backoff, member.panics_in_a_row);
        member.panics_in_a_row += 1;
        tracing::error!(
            module,
            "panicked and will be restarted in {pause:?}; the other modules continue: {reason}"
        );
        phase.state.restarts.push((now + pause, order));
    }

    fn restart_due(&mut self, phase: &mut SyncPhase<'_>) {
        let now = phase.now();
        let (due, later): (Vec<_>, Vec<_>) =
            phase.state.restarts.drain(..).partition(|&(time, _)| time <= now);
        phase.state.restarts = later;
        for (_, order) in due {
            match restart(phase, order) {
                Some((module, Ok(restarts))) => {
                    tracing::info!(module = &*module, restarts, "restarted after its panic");
                }
                Some((_, Err(error))) => tracing::error!("its restart after a panic failed: {error}"),
                None => {}
            }
        }
    }

    /// Restarts a module that has stopped or is not active.
    fn restart_stopped(
        phase: &mut SyncPhase<'_>,
        by: Option<ModuleId>,
        module: &str,
    ) -> Result<(), RestartRefused> {
        let id = find(phase, module)?;
        if phase.state.link.is_closed() {
            return Err(SetupError::Stopped(module.to_owned()).into());
        }
        let member = phase.state.members.get(id.order);
        let has_stopped = member.is_some_and(|member| member.panic.is_some());
        let state = match id.place {
            Place::Attached(_) => phase.attached(id).map(|cell| cell.state()),
            Place::Detached(_) => phase.state.detached(id).map(|detached| detached.state),
        };
        if !has_stopped && state == Some(LifecycleState::Active) {
            return Err(RestartRefused::Runs { module: module.to_owned() });
        }
        note(phase, id, by, ModuleCommand::Restart);
        phase.state.restarts.retain(|&(_, order)| order != id.order);
        match restart(phase, id.order) {
            Some((_, Err(error))) => Err(error.into()),
            _ => Ok(()),
        }
    }

    fn apply(&mut self, phase: &mut SyncPhase<'_>, by: Option<ModuleId>, command: Command) {
        if phase.state.drops_commands_to_self
            && let Some(by) = by
            && command.target().is_some_and(|target| phase.module_name(by) == Some(target))
        {
            return;
        }
        match command {
            Command::Add { candidate, fallback, receipt } => {
                let result = admit(phase, *candidate);
                if let (Err(error), None) = (&result, &receipt) {
                    tracing::error!("not added: {error}");
                }
                if let (Err(_), Some(fallback)) = (&result, fallback)
                    && let Err(error) = admit(phase, *fallback)
                {
                    tracing::error!("not added again: {error}");
                }
                answer(receipt, result);
            }
            Command::Change { module, change, receipt } => {
                let result = find(phase, &module).map(|id| {
                    note(phase, id, by, change.event());
                    match change {
                        Change::Remove => self.remove(phase, id),
                        Change::Hold(hold) => set_hold(phase, id, hold),
                    }
                });
                if let (Err(unknown), None) = (&result, &receipt) {
                    tracing::warn!("{}: {unknown}", change.failure());
                }
                answer(receipt, result);
            }
            Command::Transition { module, transition, receipt } => match find(phase, &module) {
                Ok(id) => {
                    note(phase, id, by, ModuleCommand::Transition(transition));
                    phase
                        .change(id, Causes::WOKEN, 1, move |cell| cell.transition_later(transition, receipt));
                }
                Err(unknown) => {
                    tracing::warn!("{transition} not made: {unknown}");
                    answer(receipt, Err(TransitionRefused::UnknownModule { module: unknown.module }));
                }
            },
            Command::Restart { module, receipt } => {
                let result = Self::restart_stopped(phase, by, &module);
                answer(receipt, result);
            }
            Command::Look(look) => look(phase),
        }
    }

    fn remove(&mut self, phase: &mut SyncPhase<'_>, id: ModuleId) {
        phase.state.restarts.retain(|&(_, order)| order != id.order);
        let Some(mut member) = phase.state.members.take(id.order) else { return };
        match id.place {
            Place::Attached(slot) => {
                if let Some(cell) = phase.stage.cells.get(slot) {
                    cell.shutdown(Input::Views(&phase.stage.views), phase.now);
                    if let Some(ModulesPort(commands)) = cell.port(MODULES) {
                        // They take effect in the next cycle, since this cycle's commands are already being
                        // applied.
                        let commands = std::mem::take(commands);
                        self.commands.extend(commands.into_iter().map(|command| (Some(id), command)));
                    }
                    let mut asked = cell.take_asked();
                    asked.remove(Asked::of(MODULES));
                    if let Some(panic) = cell.take_panic() {
                        tracing::error!(module = &*member.name, "panicked in its shutdown: {panic}");
                    }
                    phase.note_asker(Asker { order: id.order, slot, asked });
                    if !self.commands.is_empty() {
                        phase.mechanisms.posted.add(Asked::of(MODULES));
                    }
                }
                phase.state.leave(id.order);
            }
            Place::Detached(_) => {
                if let Some(module) = phase.state.detached(id) {
                    module.request_stop();
                }
            }
        }
        phase.give_back(&mut member, Some(UseEnds::AtRemoval));
        phase.state.members.insert_nameless(member);
    }
}

fn lengthened(backoff: Duration, doublings: u32) -> Duration {
    let longest = Restart::LONGEST_BACKOFF.max(backoff);
    backoff.saturating_mul(1_u32.checked_shl(doublings).unwrap_or(u32::MAX)).min(longest)
}

/// Restarts a module. Returns its name, and the number of its restarts or the error that keeps it stopped;
/// `None` if there is no such module.
fn restart(phase: &mut SyncPhase<'_>, order: u64) -> Option<(Arc<str>, Result<u32, SetupError>)> {
    let mut member = phase.state.members.take(order)?;
    phase.give_back(&mut member, None);
    member.meter = phase.vacate(member.id);
    if let Some(meter) = &mut member.meter {
        meter.restarted();
    }
    phase.state.gone.push(member.id);
    phase.state.has_ends = true;
    member.restarts += 1;
    member.panic = None;
    member.id.life += 1;
    member.started = phase.now();
    let (module, restarts) = (Arc::clone(&member.name), member.restarts);
    let result = instate(phase, &mut member).map(|()| restarts);
    if let Err(error) = &result {
        // The module keeps its place, because the cause of the error may be fixed later.
        member.panic = Some(error.to_string().into());
        if let Err(error) = hold_place(phase, &mut member) {
            tracing::error!(module = &*module, "removed, because its place cannot be kept: {error}");
            if let Place::Attached(slot) = member.id.place {
                phase.state.freed_slots.push(slot);
            }
            return Some((module, result));
        }
    }
    phase.state.members.insert(member);
    Some((module, result))
}

/// Publishes a command to a module as an event.
fn note(phase: &mut SyncPhase<'_>, id: ModuleId, by: Option<ModuleId>, command: ModuleCommand) {
    let asker = by.and_then(|by| phase.state.members.get(by.order));
    let by = asker.map(|member| Arc::clone(&member.name));
    note_event_of(phase, id, |module| ModuleEventKind::Command { module, command, by });
}

pub(crate) fn find(phase: &SyncPhase<'_>, module: &str) -> Result<ModuleId, UnknownModule> {
    phase.state.members.find(module).map(|member| member.id).ok_or_else(|| {
        let known: Vec<_> = phase.state.members.names().map(|name| format!("\"{name}\"")).collect();
        let known = if known.is_empty() { "none".into() } else { known.join(", ") };
        UnknownModule { module: Arc::from(module), known }
    })
}

fn set_hold(phase: &mut SyncPhase<'_>, id: ModuleId, hold: Hold) {
    if let Some(detached) = phase.state.detached(id) {
        detached.is_paused = hold != Hold::Free;
    }
    phase.change(id, Causes::WOKEN, 1, move |cell| cell.hold(hold));
    if let Place::Attached(slot) = id.place
        && let Some(cell) = phase.attached(id)
    {
        // Due times that passed during the pause were discarded.
        let due = cell.next_due();
        phase.state.agenda.wake_at(slot, due);
    }
}

fn answer<T: Send + 'static>(receipt: Option<ReceiptSender<T>>, answer: T) {
    if let Some(receipt) = receipt {
        receipt.send(answer);
    }
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
