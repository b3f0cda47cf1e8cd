//! The context of a callback.

use super::input::Input;
use super::link::Link;
use super::port::{ModuleIo, Port};
use crate::Time;
use std::fmt;
use std::sync::Arc;

/// A callback's access to the executor. All its requests take effect in the sync phase.
///
/// Keys belong to the module whose setup made them. A method panics on a key of another module, which stops
/// the module; keys of two modules with the same number and type cannot be distinguished.
///
/// A function for modules of several types takes a `&mut Context<'_, P>` for any `P`.
pub struct Context<'a, P = ()> {
    /// The value returned by the module's [`setup`](crate::Module::setup), usually its keys.
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

    /// The same context with another input.
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

    /// The module's port of a mechanism, for reading.
    #[inline]
    pub(crate) fn look<Q: Port>(&self, mechanism: usize) -> Option<&Q> {
        self.io.look(mechanism)
    }

    /// The time of this cycle, the same for all callbacks in it.
    #[must_use]
    pub fn now(&self) -> Time {
        self.now
    }

    /// The name under which the module was added.
    #[must_use]
    pub fn module_name(&self) -> &str {
        &self.io.name
    }

    /// A handle that reports whether the core is asked to stop. A long callback can use it to abandon work
    /// whose result is no longer needed.
    ///
    /// A stop can be requested at any time, so messages must not depend on it, except those of a callback
    /// that would otherwise end too late.
    #[must_use]
    pub fn stop_request(&self) -> StopRequest {
        StopRequest { link: Arc::clone(&self.io.link) }
    }

    #[cold]
    pub(crate) fn foreign(&self, did: &str) -> ! {
        panic!("module \"{}\" {did} a key of another module", self.io.name)
    }
}

/// A request to stop a core, see [`Context::stop_request`].
#[derive(Clone)]
pub struct StopRequest {
    link: Arc<Link>,
}

impl StopRequest {
    /// True once the core has been asked to stop.
    #[must_use]
    pub fn is_made(&self) -> bool {
        self.link.stop_is_requested()
    }
}

impl fmt::Debug for StopRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("StopRequest").field("is_made", &self.is_made()).finish_non_exhaustive()
    }
}
