//! The sync phase as mechanisms see it.

use std::sync::Arc;

use crate::asked::Asked;
use crate::cell::ModuleCell;
use crate::core::World;
use crate::event::{ModuleEvent, ModuleEventKind};
use crate::mechanism::Mechanism;
use crate::module_io::ModuleIo;
use crate::setting::SettingsChange;
use crate::{ModuleId, Role, Stage, Time};

/// The core between two process phases: what a [`Mechanism`] works on. No module runs while it is there.
pub struct SyncPhase<'a> {
    pub(crate) stage: &'a mut Stage,
    pub(crate) world: &'a mut World,
    pub(crate) now: Time,
    /// What was asked for in this cycle, by whomever.
    pub(crate) asked: Asked,
}

impl SyncPhase<'_> {
    /// The time of the cycle.
    #[must_use]
    pub fn now(&self) -> Time {
        self.now
    }

    /// Counts the cycles from 0.
    #[must_use]
    pub fn cycle(&self) -> u64 {
        self.world.cycle
    }

    /// What modules see of the mechanism from the next process phase on.
    ///
    /// # Panics
    /// If the mechanism was not added to this core.
    pub fn view<M: Mechanism>(&mut self) -> &mut M::View {
        match self.stage.shared.offers.view_mut::<M>() {
            Some(view) => view,
            None => panic!("the mechanism \"{}\" was not added to this core", M::NAME),
        }
    }

    /// Moves what modules asked of the mechanism in this cycle to the end of `requests`: in the order of
    /// registration of the modules, and of a module in the order in which it asked.
    pub fn take_requests<M: Mechanism>(&mut self, requests: &mut Vec<(ModuleId, M::Request)>) {
        let Some(index) = self.stage.shared.offers.find::<M>() else { return };
        self.for_each_that_asked(Asked::MECHANISMS, |io, _| {
            let asks = io.asks.get_mut(index).and_then(Option::as_mut);
            if let Some(asks) = asks.and_then(|asks| asks.downcast_mut::<Vec<M::Request>>()) {
                let id = io.id;
                requests.extend(asks.drain(..).map(|request| (id, request)));
            }
        });
    }

    /// The name of a module; nothing if it is gone.
    #[must_use]
    pub fn module_name(&self, module: ModuleId) -> Option<&str> {
        self.world.members.get(module.order).map(|member| &*member.name)
    }

    /// Has a module run in the next cycle, as it would for a message. Nothing happens for a detached one.
    pub fn wake(&mut self, module: ModuleId) {
        if let Some(slot) = self.attached_slot(module) {
            self.world.agenda.wake(slot);
        }
    }

    /// Has the change told, if it is one of a part and somebody listens: an observer is not replayed.
    pub(crate) fn note_change(&mut self, module: ModuleId, change: SettingsChange) {
        let (topics, world) = (&self.stage.shared.topics, &mut *self.world);
        let is_heard = world.changes_topic.is_some_and(|topic| !topics.subscribers(topic).is_empty());
        let is_part = world.members.get(module.order).is_some_and(|member| member.role() == Role::Part);
        if is_heard && is_part {
            world.changes.push(change);
        }
    }

    /// True if somebody listens to events.
    pub(crate) fn hears_events(&self) -> bool {
        let topics = &self.stage.shared.topics;
        self.world.events_topic.is_some_and(|topic| !topics.subscribers(topic).is_empty())
    }

    pub(crate) fn note_event(&mut self, kind: ModuleEventKind) {
        let (time, cycle) = (self.now, self.world.cycle);
        self.world.events.push(ModuleEvent { time, cycle, kind });
    }

    /// Has an event of a module told, if the module is a part and somebody listens: an observer is not replayed.
    pub(crate) fn note_event_of(&mut self, module: ModuleId, kind: impl FnOnce(Arc<str>) -> ModuleEventKind) {
        if !self.hears_events() {
            return;
        }
        let member = self.world.members.get(module.order).filter(|member| member.role() == Role::Part);
        if let Some(name) = member.map(|member| Arc::clone(&member.name)) {
            self.note_event(kind(name));
        }
    }

    #[inline]
    pub(crate) fn has(&self, what: Asked) -> bool {
        self.asked.has(what)
    }

    pub(crate) fn for_each_that_asked(
        &mut self,
        what: Asked,
        mut apply: impl FnMut(&mut ModuleIo, &mut World),
    ) {
        let askers = std::mem::take(&mut self.world.askers);
        for asker in askers.iter().filter(|asker| asker.asked.has(what)) {
            if let Some(cell) = self.stage.cell(asker.module.slot) {
                apply(&mut cell.io, self.world);
            }
        }
        self.world.askers = askers;
    }

    /// The module, unless it is detached or gone.
    pub(crate) fn attached(&mut self, module: ModuleId) -> Option<&mut ModuleCell> {
        let slot = self.attached_slot(module)?;
        self.stage.cell(slot)
    }

    fn attached_slot(&mut self, module: ModuleId) -> Option<usize> {
        let crate::management::Place::Attached(slot) = module.place else { return None };
        self.stage.cell(slot).is_some_and(|cell| cell.io.id == module).then_some(slot)
    }
}
