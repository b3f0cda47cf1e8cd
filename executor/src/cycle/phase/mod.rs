//! The sync phase, and the interface of the core for mechanisms.

mod mechanism;

pub(crate) use mechanism::{AnyMechanism, CoreHost, Mechanisms};
pub use mechanism::{Mechanism, MechanismKey, Step};

use std::any::Any;

use super::agenda::Asker;
use super::detached::Parcel;
use super::members::Member;
use super::stage::Stage;
use super::state::CoreState;
use crate::module::{Asked, Causes, ModuleCell, Place, Post, StepOutcome, Use, UseEnds};
use crate::observe::ModuleMeter;
use crate::{ModuleId, Role, Time};

/// The core between two process phases, as a [`Mechanism`] accesses it. No module runs meanwhile.
pub struct SyncPhase<'a> {
    pub(crate) stage: &'a mut Stage,
    pub(crate) state: &'a mut CoreState,
    pub(crate) mechanisms: &'a mut Mechanisms,
    pub(crate) now: Time,
    /// The mechanisms that have yet to run.
    asked: Asked,
    /// The mechanisms with smaller numbers have run.
    begun: usize,
    /// Mechanisms whose external queues are not empty.
    announced: Asked,
}

impl<'a> SyncPhase<'a> {
    pub(crate) fn new(
        stage: &'a mut Stage,
        state: &'a mut CoreState,
        mechanisms: &'a mut Mechanisms,
        now: Time,
    ) -> Self {
        Self { stage, state, mechanisms, now, asked: Asked::default(), begun: 0, announced: Asked::default() }
    }

    /// A view of the core outside a sync phase: requests to mechanisms wait for the next sync phase.
    pub(crate) fn between_cycles(
        stage: &'a mut Stage,
        state: &'a mut CoreState,
        mechanisms: &'a mut Mechanisms,
        now: Time,
    ) -> Self {
        Self { begun: usize::MAX, ..Self::new(stage, state, mechanisms, now) }
    }

    /// Applies the requests of the process phase.
    #[inline(always)]
    pub(crate) fn run(&mut self) {
        self.state.inspector.processed();
        self.stage.swap_askers(&mut self.state.askers);
        self.announced = self.state.link.take_announcements();
        self.asked = self.mechanisms.begin_phase(self.now).or(self.announced);
        self.asked.add(self.state.askers.asked);
        if self.state.link.has_posts() {
            self.join(None);
        }
        while let Some(number) = self.asked.take_first() {
            self.begun = number + 1;
            self.run_mechanism(number);
        }
        if self.mechanisms.len() > Asked::SHARED {
            self.run_shared();
        }
        if self.state.has_ends {
            self.finish();
        }
        self.state.cycle += 1;
        self.state.inspector.count_cycles(self.state.cycle);
    }

    /// Runs the mechanisms that share a bit; they run in every sync phase.
    #[cold]
    fn run_shared(&mut self) {
        (Asked::SHARED + 1..self.mechanisms.len()).for_each(|number| self.run_mechanism(number));
    }

    #[inline(always)]
    fn run_mechanism(&mut self, number: usize) {
        if let Some(mut mechanism) = self.mechanisms.take(number) {
            mechanism.sync(self);
            self.mechanisms.put_back(number, mechanism);
        }
    }

    /// Passes the posts of other threads to the mechanisms. Posts that arrive meanwhile wait for the next
    /// cycle, so that a busy thread cannot stall this one.
    #[cold]
    fn join(&mut self, mut running: Option<(usize, &mut dyn Any)>) {
        for _ in 0..self.state.link.len() {
            match self.state.link.pop() {
                Some(Post::To(number, change)) => {
                    self.ask(number);
                    match &mut running {
                        Some((known, mechanism)) if *known == number => change(*mechanism),
                        _ => {
                            if let Some(mechanism) = self.mechanisms.any(number) {
                                change(mechanism);
                            }
                        }
                    }
                }
                Some(Post::Step(mut outcome)) => {
                    let StepOutcome { module, number, time, .. } = *outcome;
                    for (mechanism, part) in std::mem::take(&mut outcome.parts) {
                        self.mechanisms.join(mechanism, Step { module, number, time }, part);
                    }
                    self.ask_all();
                    self.state.has_ends = true;
                    self.state.steps.push(*outcome);
                }
                None => break,
            }
        }
    }

    /// Passes the posts since the begin of the phase to the mechanisms. `running` is the mechanism with this
    /// number.
    pub(crate) fn join_again(&mut self, number: usize, running: &mut dyn Any) {
        self.join(Some((number, running)));
    }

    /// Passes the posts of other threads to the mechanisms while the core is paused, and calls their
    /// [`Mechanism::paused`].
    pub(crate) fn attend(&mut self) {
        if self.state.link.has_posts() {
            self.join(None);
        }
        self.each_mechanism(|mechanism, phase| mechanism.paused(phase));
    }

    pub(crate) fn each_mechanism(&mut self, mut visit: impl FnMut(&mut dyn AnyMechanism, &mut Self)) {
        for number in 0..self.mechanisms.len() {
            if let Some(mut mechanism) = self.mechanisms.take(number) {
                visit(&mut *mechanism, self);
                self.mechanisms.put_back(number, mechanism);
            }
        }
    }

    /// Frees the resources of removed modules at the end of the sync phase, after their last messages have
    /// been sent.
    #[cold]
    fn finish(&mut self) {
        self.state.has_ends = false;
        self.state.steps.clear();
        for order in std::mem::take(&mut self.state.leaving) {
            let Some(mut member) = self.state.members.take(order) else { continue };
            self.give_back(&mut member, None);
            drop(self.vacate(member.id));
            if let Place::Attached(slot) = member.id.place {
                self.state.freed_slots.push(slot);
            }
            self.state.gone.push(member.id);
        }
        for module in std::mem::take(&mut self.state.gone) {
            self.each_mechanism(|mechanism, phase| mechanism.module_left(module, phase));
        }
    }

    /// Ends the module's uses of named resources: all of them, or those with this `ends`.
    pub(crate) fn give_back(&mut self, member: &mut Member, ends: Option<UseEnds>) {
        let host = &mut CoreHost { views: &mut self.stage.views, mechanisms: self.mechanisms };
        let ended = member.uses.extract_if(.., |used| ends.is_none_or(|ends| used.ends == ends));
        for used in ended.collect::<Vec<Use>>() {
            (used.give_back)(host, member.id, used);
        }
    }

    /// Drops the module in the given place, and returns its counters.
    pub(crate) fn vacate(&mut self, id: ModuleId) -> Option<ModuleMeter> {
        self.stage.views.topics.module_changed();
        match id.place {
            Place::Attached(slot) => {
                self.state.agenda.leave(slot);
                let mut cell = self.stage.cells.take(slot)?;
                // Callers that wait for an answer of this module receive an error.
                cell.io.asked = Asked::default();
                cell.refuse_requests();
                for (number, part) in cell.io.split_off() {
                    self.mechanisms.join(number, Step { module: id, number: 0, time: self.now }, part);
                    self.ask(number);
                }
                Some(std::mem::take(&mut cell.meter))
            }
            Place::Detached(slot) => {
                self.state.detached[slot].take().map(|mut module| std::mem::take(&mut module.meter))
            }
        }
    }

    /// The time of the cycle.
    #[must_use]
    pub fn now(&self) -> Time {
        self.now
    }

    /// The number of the cycle, from 0.
    #[must_use]
    pub fn cycle(&self) -> u64 {
        self.state.cycle
    }

    /// The view that modules read from the next process phase on.
    ///
    /// # Panics
    /// If the mechanism was not added to this core.
    pub fn view<M: Mechanism>(&mut self) -> &mut M::View {
        let number = self.mechanisms.number_of::<M>();
        match number.and_then(|number| self.stage.views.get_mut(number)) {
            Some(view) => view,
            None => panic!("the mechanism \"{}\" was not added to this core", M::NAME),
        }
    }

    /// Visits the ports of the modules with requests to the mechanism in this cycle, in the order of
    /// registration.
    pub fn each_port<M: Mechanism>(&mut self, mut visit: impl FnMut(ModuleId, &mut M::Port)) {
        if let Some(number) = self.mechanisms.number_of::<M>() {
            self.each_asker(number, |cell, _| {
                let id = cell.io.id;
                if let Some(port) = cell.port(number) {
                    visit(id, port);
                }
            });
        }
    }

    /// The port of a module; `None` if it has none, or is detached or gone.
    pub fn port<M: Mechanism>(&mut self, module: ModuleId) -> Option<&mut M::Port> {
        let number = self.mechanisms.number_of::<M>()?;
        self.attached(module)?.port(number)
    }

    /// The name of a module; `None` after its removal.
    #[must_use]
    pub fn module_name(&self, module: ModuleId) -> Option<&str> {
        self.state.members.get(module.order).map(|member| &*member.name)
    }

    /// Schedules a module for the next cycle, as a message would. Does nothing for a detached module.
    pub fn wake(&mut self, module: ModuleId) {
        self.wake_for(module, Causes::WOKEN);
    }

    /// Requests a call of [`Mechanism::process_begins`] before the next process phase, which then starts at
    /// once.
    pub fn call_before_next<M: Mechanism>(&mut self) {
        if let Some(number) = self.mechanisms.number_of::<M>() {
            self.mechanisms.begin.add(Asked::of(number));
        }
    }

    /// Schedules the module for the next cycle, with this cause, unless it is detached or gone.
    pub(crate) fn wake_for(&mut self, module: ModuleId, causes: Causes) {
        if let Place::Attached(slot) = module.place
            && self.stage.cells.get(slot).is_some_and(|cell| cell.io.id == module)
        {
            self.state.agenda.wake(slot, causes);
        }
    }

    /// Makes the mechanism with this number run in this sync phase, or in the next if it has already run.
    pub(crate) fn ask(&mut self, number: usize) {
        if number < self.begun {
            self.mechanisms.posted.add(Asked::of(number));
        } else {
            self.asked.add(Asked::of(number));
        }
    }

    /// Makes the mechanism with this number run in this sync phase, unless it has already run.
    pub(crate) fn take_part(&mut self, number: usize) {
        self.asked.add(Asked::of(number).from(self.begun));
    }

    /// Makes all mechanisms run in the next sync phase.
    pub(crate) fn ask_all(&mut self) {
        (0..self.mechanisms.len()).for_each(|number| self.ask(number));
    }

    /// True if another thread has announced a post to the mechanism with this number before this phase began.
    #[inline]
    pub(crate) fn is_announced(&self, number: usize) -> bool {
        self.announced.has(Asked::of(number))
    }

    /// Visits the modules with requests to the mechanism with this number, in the order of registration.
    #[inline]
    pub(crate) fn each_asker(
        &mut self,
        number: usize,
        mut visit: impl FnMut(&mut ModuleCell, &mut CoreState),
    ) {
        let asked = Asked::of(number);
        let askers = std::mem::take(&mut self.state.askers);
        for asker in askers.list.iter().filter(|asker| asker.asked.has(asked)) {
            if let Some(cell) = self.stage.cells.get(asker.slot) {
                visit(cell, self.state);
            }
        }
        self.state.askers = askers;
    }

    /// Registers requests that a module made outside of the process phase.
    pub(crate) fn note_asker(&mut self, asker: Asker) {
        self.asked.add(asker.asked.from(self.begun));
        let askers = &mut self.state.askers.list;
        match askers.binary_search_by_key(&asker.order, |known| known.order) {
            Ok(position) => askers[position].asked.add(asker.asked),
            Err(position) => askers.insert(position, asker),
        }
    }

    /// The module, unless it is detached or gone.
    pub(crate) fn attached(&mut self, module: ModuleId) -> Option<&mut ModuleCell> {
        let Place::Attached(slot) = module.place else { return None };
        self.stage.cells.get(slot).filter(|cell| cell.io.id == module)
    }

    /// Changes a module where it runs, here or on its own thread, and runs it with this cause. `events` is
    /// the number of events that the change stands for.
    pub(crate) fn change(
        &mut self,
        module: ModuleId,
        causes: Causes,
        events: u32,
        apply: impl FnOnce(&mut ModuleCell) + Send + 'static,
    ) {
        self.change_with(module, causes, events, apply, |cell, apply| apply(cell), |apply| Box::new(apply));
    }

    /// As [`change`](Self::change), for a value that `there` converts for use on another thread.
    #[inline]
    pub(crate) fn change_with<T>(
        &mut self,
        module: ModuleId,
        causes: Causes,
        events: u32,
        value: T,
        here: impl FnOnce(&mut ModuleCell, T),
        there: impl FnOnce(T) -> Box<dyn FnOnce(&mut ModuleCell) + Send>,
    ) {
        match module.place {
            Place::Attached(slot) => {
                if let Some(cell) = self.stage.cells.get(slot).filter(|cell| cell.io.id == module) {
                    here(cell, value);
                    self.state.agenda.wake(slot, causes);
                }
            }
            Place::Detached(_) => {
                if let Some(detached) = self.state.detached(module) {
                    detached.send(Parcel { causes, events, apply: there(value) });
                }
            }
        }
    }

    /// True if the module is a part of the robot, not an observer.
    pub(crate) fn is_part(&self, module: ModuleId) -> bool {
        self.state.members.get(module.order).is_some_and(|member| member.role() == Role::Part)
    }
}
