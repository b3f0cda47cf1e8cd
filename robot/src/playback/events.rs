//! Replay of the recorded events of modules.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use downbeat_edge::{EncodedCaller, EncodedStandIn, Interfaces, KnownService};
use downbeat_executor::{CallError, Core, SetupError, Transition};
use downbeat_msgs::downbeat_interfaces::msg::ModuleEvent;

use super::PlaybackError;
use crate::journal;
use crate::journal::events::RESTART;

/// The events of the modules of a core that these modules do not cause themselves.
#[derive(Default)]
pub(crate) struct Events {
    waiting: VecDeque<ModuleEvent>,
    callers: BTreeMap<String, EncodedCaller>,
    stand_ins: BTreeMap<String, EncodedStandIn>,
    /// True for a detached module that is replayed on its own: commands that it gave to itself come from the
    /// bag as well.
    alone: bool,
    modules: Vec<String>,
}

/// The services of a robot, also those that its modules have later: their types, and the modules that serve
/// them.
#[derive(Clone, Copy)]
pub(crate) struct WiredServices<'a> {
    pub(crate) types: &'a BTreeMap<String, KnownService>,
    pub(crate) servers: &'a BTreeMap<String, String>,
}

/// A timeout that no replay reaches.
const EVER: Duration = Duration::from_secs(3600 * 24 * 365);

impl Events {
    /// Events of a core with modules that run inside the cycle. Results of jobs are held back until their
    /// recorded time.
    pub(crate) fn of_core(
        core: &mut Core,
        events: Option<&[ModuleEvent]>,
        interfaces: &Interfaces,
        wired: Option<WiredServices<'_>>,
    ) -> Result<Self, SetupError> {
        let Some(events) = events else { return Ok(Self::default()) };
        let mut prepared = Self::prepare(core, interfaces, wired)?;
        prepared.waiting = events
            .iter()
            .filter(|event| prepared.concerns(event) && !prepared.is_caused(event))
            .cloned()
            .collect();
        Ok(prepared)
    }

    /// Events of a core with one detached module, which takes them over in [`Events::take`] as its recorded
    /// runs did.
    pub(crate) fn of_detached(
        core: &mut Core,
        events: Option<&[ModuleEvent]>,
        interfaces: &Interfaces,
        module: &str,
        wired: Option<WiredServices<'_>>,
    ) -> Result<Self, SetupError> {
        let Some(events) = events else { return Ok(Self::default()) };
        let mut prepared = Self::prepare(core, interfaces, wired)?;
        prepared.alone = true;
        prepared.modules = vec![module.to_owned()];
        core.drop_commands_to_self();
        // Its lives begin where its runs say so.
        let is_of_life = |event: &ModuleEvent| ["remove", RESTART].contains(&event.command.as_str());
        let is_its = |event: &&ModuleEvent| prepared.concerns(event) && !is_of_life(event);
        prepared.waiting = events.iter().filter(is_its).cloned().collect();
        Ok(prepared)
    }

    fn prepare(
        core: &mut Core,
        interfaces: &Interfaces,
        wired: Option<WiredServices<'_>>,
    ) -> Result<Self, SetupError> {
        let mut prepared = Self {
            modules: core.modules().iter().map(|module| module.name.to_string()).collect(),
            ..Self::default()
        };
        let services = core.services().map(|info| (info.name.to_string(), info.server.is_some()));
        let mut services: BTreeMap<String, (KnownService, bool)> = services
            .filter_map(|(name, is_served)| {
                let known = interfaces.service_in(core, &name)?;
                Some((name, (known, is_served)))
            })
            .collect();
        for (name, known) in wired.iter().flat_map(|wired| wired.types) {
            let server = wired.and_then(|wired| wired.servers.get(name));
            let is_served = server.is_some_and(|server| prepared.has(server));
            services.entry(name.clone()).or_insert((*known, is_served)).1 |= is_served;
        }
        for (service, (known, is_served)) in services {
            known.encode(core, &service)?;
            if is_served {
                let caller = known.caller(core, &service)?;
                prepared.callers.insert(service, caller);
            } else {
                let stand_in = known.stand_in(core, &service)?;
                prepared.stand_ins.insert(service, stand_in);
            }
        }
        core.hold_results();
        Ok(prepared)
    }

    /// Returns whether there are no events.
    pub(crate) fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    fn has(&self, module: &str) -> bool {
        self.modules.iter().any(|known| known == module)
    }

    /// Returns whether the event went to a module of the core.
    fn concerns(&self, event: &ModuleEvent) -> bool {
        match event.kind {
            ModuleEvent::REQUEST => self.callers.contains_key(&event.service),
            ModuleEvent::ANSWER | ModuleEvent::COMMAND | ModuleEvent::RESULT | ModuleEvent::TAKEN => {
                self.has(&event.module)
            }
            _ => false,
        }
    }

    /// Returns whether the modules of the core cause the event themselves.
    fn is_caused(&self, event: &ModuleEvent) -> bool {
        match event.kind {
            ModuleEvent::REQUEST => self.has(&event.module),
            ModuleEvent::ANSWER => self.callers.contains_key(&event.service),
            ModuleEvent::COMMAND => !self.alone && self.has(&event.by),
            ModuleEvent::TAKEN => true,
            _ => false,
        }
    }

    /// Leaves out the events of the cycles before this one.
    pub(crate) fn skip_before(&mut self, cycle: u64) {
        self.waiting.retain(|event| event.cycle >= cycle);
    }

    /// Applies the events that are due in the next sync phase.
    pub(crate) fn give(
        &mut self,
        core: &Core,
        is_due: impl Fn(&ModuleEvent) -> bool,
    ) -> Result<(), PlaybackError> {
        while self.waiting.front().is_some_and(&is_due) {
            if let Some(event) = self.waiting.pop_front() {
                self.make(core, &event)?;
            }
        }
        Ok(())
    }

    /// Applies the events that the next run, which has that number, took over.
    pub(crate) fn take(&mut self, core: &Core, run: u64) -> Result<(), PlaybackError> {
        let is_of_run = |event: &ModuleEvent| event.kind == ModuleEvent::TAKEN && event.number == run;
        let first_taken = self.waiting.iter().position(|event| event.kind == ModuleEvent::TAKEN);
        let Some(position) = first_taken.filter(|&position| is_of_run(&self.waiting[position])) else {
            return Ok(());
        };
        let count = self.waiting.remove(position).map_or(0, |taken| taken.count);
        for _ in 0..count {
            let next = self.waiting.iter().position(|event| event.kind != ModuleEvent::TAKEN);
            let Some(event) = next.and_then(|next| self.waiting.remove(next)) else { break };
            if !self.is_caused(&event) {
                self.make(core, &event)?;
            }
        }
        Ok(())
    }

    fn make(&self, core: &Core, event: &ModuleEvent) -> Result<(), PlaybackError> {
        let ModuleEvent { module, service, port, number, data, reason, .. } = event;
        let handle = core.handle();
        let wrong = |problem: String| PlaybackError::journal(journal::EVENTS, problem);
        match event.kind {
            ModuleEvent::REQUEST => {
                if let Some(caller) = self.callers.get(service) {
                    caller.call(data, EVER, |_| ());
                }
            }
            ModuleEvent::ANSWER => {
                let Some(stand_in) = self.stand_ins.get(service) else { return Ok(()) };
                let name = service.as_str().into();
                let result = match event.outcome {
                    ModuleEvent::ANSWERED => Ok(data.as_slice()),
                    ModuleEvent::NO_SERVER => Err(CallError::NoServer { service: name }),
                    ModuleEvent::SERVER_GONE => {
                        Err(CallError::ServerGone { service: name, module: reason.as_str().into() })
                    }
                    ModuleEvent::SERVER_FAILED => Err(CallError::ServerFailed {
                        service: name,
                        module: event.by.as_str().into(),
                        reason: reason.as_str().into(),
                    }),
                    _ => Err(CallError::Refused { service: name, reason: reason.clone() }),
                };
                stand_in
                    .answer(module, *port, *number, result)
                    .map_err(|error| wrong(format!("service \"{service}\": {error}")))?;
            }
            ModuleEvent::RESULT => handle.release_result(module, *port, *number),
            ModuleEvent::COMMAND => match event.command.as_str() {
                "pause" => drop(handle.pause_module(module)),
                "resume" => drop(handle.resume_module(module)),
                "step" => drop(handle.step_module(module)),
                "remove" => drop(handle.remove(module)),
                RESTART => drop(handle.restart(module)),
                other => {
                    let transitions = [
                        Transition::Configure,
                        Transition::Activate,
                        Transition::Deactivate,
                        Transition::Cleanup,
                        Transition::Shutdown,
                    ];
                    let transition = transitions.into_iter().find(|known| known.to_string() == other);
                    let transition =
                        transition.ok_or_else(|| wrong(format!("unknown command \"{other}\"")))?;
                    drop(handle.transition(module, transition));
                }
            },
            _ => {}
        }
        Ok(())
    }
}
