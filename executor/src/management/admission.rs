//! How a module joins a core, before the start or while it runs.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use crate::behaviour::{Behaviour, ModuleBehaviour};
use crate::cell::ModuleCell;
use crate::core::World;
use crate::detached::DetachedModule;
use crate::guard::{drop_guarded, end_of};
use crate::management::{Member, ModuleId, Place};
use crate::messaging::Subscriber;
use crate::module_io::ModuleIo;
use crate::setup::{Registries, Uses};
use crate::{Module, ModuleOptions, Restart, SettingValue, Setup, SetupError, Stage, Synchrony};

/// A module that is to join.
pub(crate) struct Candidate {
    pub(crate) name: String,
    pub(crate) source: Source,
    pub(crate) options: ModuleOptions,
}

/// Where the module comes from.
pub(crate) enum Source {
    /// It exists, and cannot be made again.
    Once(Option<Box<dyn Recruit>>),
    /// It can be made again after a panic.
    Factory(Box<dyn FnMut() -> Box<dyn Recruit> + Send>),
}

impl Source {
    pub(crate) fn once<M: Module>(module: M) -> Self {
        Self::Once(Some(Box::new(module)))
    }

    pub(crate) fn factory<M: Module>(mut make: impl FnMut() -> M + Send + 'static) -> Self {
        Self::Factory(Box::new(move || Box::new(make())))
    }

    fn make(&mut self) -> Option<Box<dyn Recruit>> {
        match self {
            Self::Once(module) => module.take(),
            Self::Factory(make) => Some(make()),
        }
    }
}

/// A module of a type that only it knows, before its setup.
pub(crate) trait Recruit: Send {
    fn set_up(
        self: Box<Self>,
        io: &mut ModuleIo,
        registries: Registries<'_>,
        uses: &mut Uses,
        is_detached: bool,
        given: Given,
    ) -> Result<Box<dyn Behaviour>, SetupError>;
}

/// What a module is given by name.
pub(crate) struct Given {
    settings: BTreeMap<String, SettingValue>,
    remaps: BTreeMap<String, String>,
}

impl<M: Module> Recruit for M {
    fn set_up(
        mut self: Box<Self>,
        io: &mut ModuleIo,
        registries: Registries<'_>,
        uses: &mut Uses,
        is_detached: bool,
        given: Given,
    ) -> Result<Box<dyn Behaviour>, SetupError> {
        let mut setup = Setup::new(io, registries, uses, is_detached, given.settings, given.remaps);
        let ports = self.setup(&mut setup)?;
        let callbacks = setup.finish()?;
        Ok(Box::new(ModuleBehaviour { module: *self, ports, callbacks }))
    }
}

/// Adds a module. What it declared is undone where its setup fails.
pub(crate) fn admit(stage: &mut Stage, world: &mut World, candidate: Candidate) -> Result<(), SetupError> {
    if let Some(error) = objection(world, &candidate) {
        drop_guarded("a module that was refused", || drop(candidate));
        return Err(error);
    }
    let Candidate { name, source, options } = candidate;
    let order = world.members.next_order();
    let place = match is_detached(world, &options) {
        true => Place::Detached(world.free_detached_slot()),
        false => Place::Attached(stage.free_slot()),
    };
    let (id, name) = (ModuleId { order, life: 0, place }, Arc::from(name));
    let uses = Uses::default();
    let started = world.clock.now();
    let mut member =
        Member { id, name, options, source, uses, restarts: 0, panics_in_a_row: 0, started, meter: None };
    instate(stage, world, &mut member)?;
    world.members.insert(member);
    Ok(())
}

/// What speaks against a module before it is set up.
fn objection(world: &World, candidate: &Candidate) -> Option<SetupError> {
    let Candidate { name, source, options } = candidate;
    if world.has_stopped {
        return Some(SetupError::Stopped(name.clone()));
    }
    if world.members.find(name).is_some() {
        return Some(SetupError::DuplicateModule(name.clone()));
    }
    let is_restartable = matches!(source, Source::Factory(_));
    (options.restart != Restart::Never && !is_restartable).then(|| SetupError::NotRestartable(name.clone()))
}

/// Makes the module of a member, anew where it is a restart, and puts it in its place.
pub(crate) fn instate(stage: &mut Stage, world: &mut World, member: &mut Member) -> Result<(), SetupError> {
    let result = try_instate(stage, world, member);
    if result.is_err() {
        release(stage, world, member);
    }
    result
}

fn try_instate(stage: &mut Stage, world: &mut World, member: &mut Member) -> Result<(), SetupError> {
    let mut io = ModuleIo::new(Arc::clone(&member.name), member.id, Arc::clone(&world.queue));
    let registries = Registries {
        topics: &mut stage.shared.topics,
        services: &mut world.services,
        offers: &stage.shared.offers,
    };
    let Member { source, uses, options, .. } = &mut *member;
    let given = Given { settings: options.settings.clone(), remaps: options.remaps.clone() };
    let is_detached = matches!(options.synchrony, Synchrony::Detached(_));
    let set_up = AssertUnwindSafe(|| match source.make() {
        Some(module) => module.set_up(&mut io, registries, uses, is_detached, given),
        None => Err(SetupError::NotRestartable(io.name.to_string())),
    });
    let behaviour = catch_unwind(set_up).unwrap_or_else(|panic| {
        Err(SetupError::Panicked { module: member.name.to_string(), reason: end_of(panic) })
    })?;
    let meter = member.meter.take().unwrap_or_else(|| world.inspector.module_meter());
    let (subscribed, initial) = (member.uses.subscribed.clone(), member.options.initial_state);
    let mut cell = ModuleCell::new(io, behaviour, subscribed, initial, meter);
    if let Some(deadline) = member.options.deadline {
        let watch = world.watchdog.watch(Arc::clone(&member.name), deadline);
        cell.watch_runs(watch.map_err(|error| SetupError::Thread {
            module: member.name.to_string(),
            reason: format!("that of its watchdog: {error}"),
        })?);
    }
    let subscriber = match member.id.place {
        Place::Attached(slot) => Subscriber::Attached(slot),
        Place::Detached(slot) => Subscriber::Detached(slot),
    };
    match member.id.place {
        Place::Attached(slot) => {
            stage.put(slot, cell);
            world.agenda.enter(slot, member.id.order);
            if member.options.synchrony == Synchrony::EveryCycle {
                world.agenda.run_in_every_cycle(slot);
            }
        }
        Place::Detached(slot) => {
            let mut module = DetachedModule::new(cell, &member.options);
            if world.is_running {
                module.start(world).map_err(|error| SetupError::Thread {
                    module: member.name.to_string(),
                    reason: error.to_string(),
                })?;
            }
            world.detached[slot] = Some(module);
        }
    }
    for &topic in &member.uses.subscribed {
        stage.shared.topics.subscribe(topic, subscriber);
    }
    Ok(())
}

/// Gives back what a module used of the registries.
pub(crate) fn release(stage: &mut Stage, world: &mut World, member: &mut Member) {
    release_services(world, member);
    let subscriber = match member.id.place {
        Place::Attached(slot) => Subscriber::Attached(slot),
        Place::Detached(slot) => Subscriber::Detached(slot),
    };
    let uses = std::mem::take(&mut member.uses);
    for topic in uses.subscribed {
        stage.shared.topics.unsubscribe(topic, subscriber);
        stage.shared.topics.release(topic);
    }
    for topic in uses.published {
        stage.shared.topics.release_publisher(topic);
    }
}

pub(crate) fn release_services(world: &mut World, member: &mut Member) {
    for service in member.uses.services.drain(..) {
        world.services.release(service, member.id);
    }
}

/// Under a clock that does not go on by itself detached modules run inside the cycle.
fn is_detached(world: &World, options: &ModuleOptions) -> bool {
    matches!(options.synchrony, Synchrony::Detached(_)) && world.clock.runs_by_itself()
}
