//! A module and its callbacks behind a trait object.

use std::fmt;

use super::causes::Causes;
use super::port::ModuleIo;
use crate::{Context, Module, SettingValue, Time, Transition, TransitionError};

/// A module with its type erased.
pub(crate) trait Behaviour: Send {
    fn transition(&mut self, transition: Transition, ctx: &mut Context<'_>) -> Result<(), TransitionError>;
    /// Calls the callbacks of these kinds.
    fn run(&mut self, causes: Causes, ctx: &mut Context<'_>);
    /// The kinds of callbacks that every run calls.
    fn always(&self) -> Causes;
    /// Checks a new value of a setting.
    fn accept_setting(&mut self, setting: usize, value: &SettingValue) -> Result<(), String>;
    fn debug(&self) -> Option<&dyn fmt::Debug>;
}

pub(crate) type Callback<M> = Box<dyn FnMut(&mut M, &mut Context<'_, <M as Module>::Ports>) + Send>;
pub(crate) type Check<M> = Box<dyn FnMut(&mut M, &SettingValue) -> Result<(), String> + Send>;

/// Decides which callback of a kind is called next, by its key.
pub(crate) type Choose = fn(&mut ModuleIo, Time) -> Option<usize>;

/// The callbacks of a module, by kind and in the order in which they were declared.
pub(crate) struct Steps<M: Module> {
    kinds: [Kind<M>; Causes::KINDS],
    pub(crate) checks: Vec<(usize, Check<M>)>,
}

struct Kind<M: Module> {
    /// `None` if all callbacks are called, and each checks itself whether it has something to do.
    choose: Option<Choose>,
    callbacks: Vec<(usize, Callback<M>)>,
}

impl<M: Module> Default for Steps<M> {
    fn default() -> Self {
        let kinds = std::array::from_fn(|_| Kind { choose: None, callbacks: Vec::new() });
        Self { kinds, checks: Vec::new() }
    }
}

impl<M: Module> Steps<M> {
    /// Adds a callback that is called whenever the module runs for this cause.
    pub(crate) fn add(
        &mut self,
        cause: Causes,
        callback: impl FnMut(&mut M, &mut Context<'_, M::Ports>) + Send + 'static,
    ) {
        self.kinds[cause.kind()].callbacks.push((0, Box::new(callback)));
    }

    /// Adds a callback that is called when `choose` returns its key.
    pub(crate) fn add_chosen(
        &mut self,
        cause: Causes,
        choose: Choose,
        key: usize,
        callback: impl FnMut(&mut M, &mut Context<'_, M::Ports>) + Send + 'static,
    ) {
        let kind = &mut self.kinds[cause.kind()];
        kind.choose = Some(choose);
        kind.callbacks.push((key, Box::new(callback)));
    }
}

/// A module and its callbacks.
pub(crate) struct ModuleBehaviour<M: Module> {
    pub(crate) module: M,
    pub(crate) ports: M::Ports,
    pub(crate) steps: Steps<M>,
}

impl<M: Module> Behaviour for ModuleBehaviour<M> {
    fn transition(&mut self, transition: Transition, ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        let Self { module, ports, .. } = self;
        let ctx = &mut ctx.with_ports(ports);
        match transition {
            Transition::Configure => module.configure(ctx),
            Transition::Activate => module.activate(ctx),
            Transition::Deactivate => module.deactivate(ctx),
            Transition::Cleanup => module.cleanup(ctx),
            Transition::Shutdown => {
                module.shutdown(ctx);
                Ok(())
            }
        }
    }

    fn run(&mut self, mut causes: Causes, ctx: &mut Context<'_>) {
        let Self { module, ports, steps } = self;
        let ctx = &mut ctx.with_ports(ports);
        while let Some(kind) = causes.take_kind() {
            let Kind { choose, callbacks } = &mut steps.kinds[kind];
            match choose {
                None => callbacks.iter_mut().for_each(|(_, callback)| callback(module, ctx)),
                Some(choose) => {
                    let now = ctx.now();
                    while let Some(chosen) = choose(ctx.io(), now) {
                        for (_, callback) in callbacks.iter_mut().filter(|(key, _)| *key == chosen) {
                            callback(module, ctx);
                        }
                    }
                }
            }
        }
    }

    fn always(&self) -> Causes {
        let is_any = !self.steps.kinds[Causes::EACH_RUN.kind()].callbacks.is_empty();
        if is_any { Causes::EACH_RUN } else { Causes::NONE }
    }

    fn accept_setting(&mut self, setting: usize, value: &SettingValue) -> Result<(), String> {
        let mut checks = self.steps.checks.iter_mut().filter(|(index, _)| *index == setting);
        checks.try_for_each(|(_, check)| check(&mut self.module, value))
    }

    fn debug(&self) -> Option<&dyn fmt::Debug> {
        self.module.debug()
    }
}
