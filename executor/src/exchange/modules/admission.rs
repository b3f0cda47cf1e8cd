//! Adding a module to a core, before the start or while the core runs.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use crate::cycle::{CoreHost, CoreLife, DetachedModule, Member, Pause, Recruit, Source};
use crate::exchange::events::{hears_events, note_event};
use crate::exchange::settings::SettingsPort;
use crate::exchange::timers::TimersPort;
use crate::module::{Behaviour, Given, ModuleCell, ModuleIo, Place, SETTINGS, TIMERS};
use crate::threads::{drop_guarded, end_of};
use crate::{
    LifecycleState, Module, ModuleEventKind, ModuleId, ModuleOptions, Restart, Role, Setup, SetupError,
    SyncPhase, Synchrony,
};

/// A module to be added.
pub(super) struct Candidate {
    pub(super) name: String,
    pub(super) source: Source,
    pub(super) options: ModuleOptions,
}

/// Adds a module. If its setup fails, its declarations are undone.
pub(super) fn admit(phase: &mut SyncPhase<'_>, candidate: Candidate) -> Result<(), SetupError> {
    let mut member = enlist(phase, candidate)?;
    instate(phase, &mut member)?;
    phase.state.members.insert(member);
    Ok(())
}

/// Adds a module in the stopped state, with a reason. It is constructed when it is restarted.
pub(super) fn admit_stopped(
    phase: &mut SyncPhase<'_>,
    candidate: Candidate,
    reason: &str,
) -> Result<(), SetupError> {
    let mut member = enlist(phase, candidate)?;
    member.panic = Some(reason.into());
    hold_place(phase, &mut member)?;
    phase.state.members.insert(member);
    Ok(())
}

/// Assigns a place to a new module.
fn enlist(phase: &mut SyncPhase<'_>, candidate: Candidate) -> Result<Member, SetupError> {
    if let Some(error) = objection(phase, &candidate) {
        drop_guarded("a module that was refused", || drop(candidate));
        return Err(error);
    }
    let Candidate { name, source, options } = candidate;
    let SyncPhase { stage, state, .. } = &mut *phase;
    let order = state.members.next_order();
    // Under a clock that does not run by itself, detached modules run inside the cycle.
    let is_detached = matches!(options.synchrony, Synchrony::Detached(_)) && state.clock.runs_by_itself();
    let place = match is_detached {
        true => Place::Detached(state.free_detached_slot()),
        false => Place::Attached(stage.cells.free_slot()),
    };
    let (id, name, started) = (ModuleId { order, life: 0, place }, Arc::from(name), state.clock.now());
    Ok(Member {
        id,
        name,
        options,
        source,
        uses: Vec::new(),
        restarts: 0,
        panic: None,
        panics_in_a_row: 0,
        started,
        periods: Vec::new(),
        meter: None,
    })
}

/// The error, if any, that refuses a module before its setup.
fn objection(phase: &SyncPhase<'_>, candidate: &Candidate) -> Option<SetupError> {
    let Candidate { name, source, options } = candidate;
    if phase.state.life == CoreLife::Stopped {
        return Some(SetupError::Stopped(name.clone()));
    }
    if phase.state.members.find(name).is_some() {
        return Some(SetupError::DuplicateModule(name.clone()));
    }
    let is_restartable = matches!(source, Source::Factory(_));
    (options.restart != Restart::Never && !is_restartable).then(|| SetupError::NotRestartable(name.clone()))
}

/// Constructs the module of a member and puts it in its place; also used for a restart.
pub(super) fn instate(phase: &mut SyncPhase<'_>, member: &mut Member) -> Result<(), SetupError> {
    let result = set_up(phase, member).and_then(|cell| put(phase, member, cell));
    if result.is_err() {
        phase.give_back(member, None);
    }
    result
}

/// Placeholder of a module that could not be constructed.
struct Absent;

impl Module for Absent {
    type Ports = ();

    fn setup(&mut self, _: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        Ok(())
    }
}

/// Keeps the place of a module that could not be constructed, so that it can be restarted.
pub(super) fn hold_place(phase: &mut SyncPhase<'_>, member: &mut Member) -> Result<(), SetupError> {
    let SyncPhase { stage, state, mechanisms, .. } = phase;
    let mut io = ModuleIo::new(Arc::clone(&member.name), member.id, Arc::clone(&state.link));
    let mut host = CoreHost { views: &mut stage.views, mechanisms };
    let is_detached = matches!(member.options.synchrony, Synchrony::Detached(_));
    let absent = Box::new(Absent);
    let behaviour = absent.set_up(&mut io, &mut host, &mut member.uses, is_detached, Given::default())?;
    member.periods = Vec::new();
    let meter = member.meter.take().unwrap_or_else(|| state.inspector.module_meter());
    put(phase, member, ModuleCell::new(io, behaviour, LifecycleState::Finalized, None, meter))
}

fn set_up(phase: &mut SyncPhase<'_>, member: &mut Member) -> Result<ModuleCell, SetupError> {
    let mut made_from = None;
    let result = make(phase, member, &mut made_from);
    if let Some(description) = made_from
        && member.options.role == Role::Part
        && hears_events(phase)
    {
        note_event(phase, ModuleEventKind::Made { module: Arc::clone(&member.name), description });
    }
    result
}

fn make(
    phase: &mut SyncPhase<'_>,
    member: &mut Member,
    made_from: &mut Option<Vec<u8>>,
) -> Result<ModuleCell, SetupError> {
    let SyncPhase { stage, state, mechanisms, .. } = phase;
    let mut io = ModuleIo::new(Arc::clone(&member.name), member.id, Arc::clone(&state.link));
    let mut host = CoreHost { views: &mut stage.views, mechanisms };
    let Member { source, uses, options, .. } = &mut *member;
    let ModuleOptions { settings, optional_settings, remaps, namespace, .. } = options.clone();
    let given = Given { settings, optional_settings, remaps, namespace };
    let is_detached = matches!(options.synchrony, Synchrony::Detached(_));
    let set_up = AssertUnwindSafe(|| match source.make() {
        Some(module) => module.set_up(&mut io, &mut host, uses, is_detached, given),
        None => Err(SetupError::NotRestartable(io.name.to_string())),
    });
    let set_up = catch_unwind(set_up).unwrap_or_else(|panic| {
        Err(SetupError::Panicked { module: member.name.to_string(), reason: end_of(panic) })
    });
    *made_from = io.made_from.take();
    let behaviour: Box<dyn Behaviour> = set_up.inspect_err(|_| {
        state.refused_settings =
            io.look::<SettingsPort>(SETTINGS).map_or_else(Vec::new, SettingsPort::declared);
    })?;
    member.periods = io.look::<TimersPort>(TIMERS).map_or_else(Vec::new, TimersPort::periods);
    let meter = member.meter.take().unwrap_or_else(|| state.inspector.module_meter());
    let watch =
        member.options.deadline.map(|deadline| state.watchdog.watch(Arc::clone(&member.name), deadline));
    let watch = watch.transpose().map_err(|error| SetupError::Thread {
        module: member.name.to_string(),
        reason: format!("the thread of its watchdog: {error}"),
    })?;
    Ok(ModuleCell::new(io, behaviour, member.options.initial_state, watch, meter))
}

fn put(phase: &mut SyncPhase<'_>, member: &Member, cell: ModuleCell) -> Result<(), SetupError> {
    let SyncPhase { stage, state, .. } = phase;
    stage.views.topics.module_changed();
    match member.id.place {
        Place::Attached(slot) => {
            stage.cells.put(slot, cell);
            state.agenda.enter(slot, member.id.order);
            if member.options.synchrony == Synchrony::EveryCycle {
                state.agenda.run_in_every_cycle(slot);
            }
        }
        Place::Detached(slot) => {
            let mut module = DetachedModule::new(cell, &member.options);
            if state.life == CoreLife::Running {
                let is_held = state.pause != Pause::Running;
                module.start(&state.clock, &state.link, is_held).map_err(|error| SetupError::Thread {
                    module: member.name.to_string(),
                    reason: error.to_string(),
                })?;
            }
            state.detached[slot] = Some(module);
        }
    }
    Ok(())
}
