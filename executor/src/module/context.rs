//! What a callback can do.

use super::cell::Input;
use super::port::{ModuleIo, Port};
use crate::Time;

/// A callback's access to the executor. Everything it asks for takes effect in the sync phase.
///
/// Keys belong to the module whose setup made them. A method that is given a key of another module panics, which
/// stops the module; keys of two modules with the same number and type cannot be distinguished.
///
/// A function that is called by modules of several types takes a `&mut Context<'_, P>` for any `P`.
pub struct Context<'a, P = ()> {
    /// What the module's [`setup`](crate::Module::setup) returned: as a rule its keys.
    pub ports: &'a P,
    io: &'a mut ModuleIo,
    now: Time,
    input: Input<'a>,
}

impl<'a> Context<'a> {
    #[inline]
    pub(crate) fn new(io: &'a mut ModuleIo, now: Time, input: Input<'a>) -> Self {
        Self { ports: &(), io, now, input }
    }

    /// The context of a module of a known type.
    #[inline]
    pub(crate) fn with_ports<'b, P>(&'b mut self, ports: &'b P) -> Context<'b, P> {
        Context { ports, io: self.io, now: self.now, input: self.input }
    }

    /// The same with something else to read.
    pub(crate) fn with_input<'b>(&'b mut self, input: Input<'b>) -> Context<'b> {
        Context { ports: self.ports, io: self.io, now: self.now, input }
    }
}

impl<'a, P> Context<'a, P> {
    #[inline]
    pub(crate) fn io(&mut self) -> &mut ModuleIo {
        self.io
    }

    #[inline]
    pub(crate) fn input(&self) -> Input<'a> {
        self.input
    }

    /// The module's port of a mechanism, for somebody who only looks.
    #[inline]
    pub(crate) fn look<Q: Port>(&self, mechanism: usize) -> Option<&Q> {
        self.io.look(mechanism)
    }

    /// The time of this cycle: the same for every callback in it.
    #[must_use]
    pub fn now(&self) -> Time {
        self.now
    }

    /// The name under which the module was added.
    #[must_use]
    pub fn module_name(&self) -> &str {
        &self.io.name
    }

    #[cold]
    pub(crate) fn foreign(&self, did: &str) -> ! {
        panic!("module \"{}\" {did} a key of another module", self.io.name)
    }
}
