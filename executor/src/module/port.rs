//! A module's part of each mechanism.

use std::any::Any;
use std::sync::Arc;

use super::causes::Asked;
use super::link::Link;
use crate::threads::drop_guarded;
use crate::{ModuleId, Time};

/// A module's part of a [`Mechanism`](crate::Mechanism): what the module asks of the mechanism and what the mechanism has
/// for the module. Only the module touches it in the process phase, only the mechanism in the sync phase.
///
/// A vector of requests is one.
pub trait Port: Any + Send {
    /// Reports what happened to the module. Returns true if the mechanism has to look at the port because of it.
    fn changed(&mut self, change: ModuleChange<'_>) -> bool;

    /// When the module has to run for this port, whatever else happens; [`Time::MAX`] for never.
    fn due(&self) -> Time {
        Time::MAX
    }

    /// Takes out what the module asks, for a module on a thread of its own: the mechanism receives it in
    /// [`Mechanism::join`](crate::Mechanism::join).
    fn split_off(&mut self) -> Option<Box<dyn Any + Send>> {
        None
    }
}

/// What happens to a module, as its ports see it.
#[derive(Clone, Copy, Debug)]
pub enum ModuleChange<'a> {
    /// It is active from now on.
    Activated(Time),
    /// It is no longer active.
    Deactivated,
    /// It was to run and is not active: nobody answers what it has been asked.
    Inactive {
        /// Its name.
        module: &'a Arc<str>,
    },
    /// Its run panicked: what it asked in that run is void.
    Panicked,
    /// The clock went back to this time.
    ClockWentBack(Time),
}

impl<T: Send + 'static> Port for Vec<T> {
    fn changed(&mut self, change: ModuleChange<'_>) -> bool {
        if let ModuleChange::Panicked = change {
            self.clear();
        }
        false
    }
}

/// What a module owns beside its state.
pub(crate) struct ModuleIo {
    pub(crate) name: Arc<str>,
    pub(crate) id: ModuleId,
    pub(crate) link: Arc<Link>,
    /// The mechanisms that have to look at a port of this module.
    pub(crate) asked: Asked,
    /// Messages that this run received.
    pub(crate) received: usize,
    /// Counts the runs.
    pub(crate) run: u64,
    /// By the number of the mechanism.
    ports: Vec<Option<Box<dyn Port>>>,
}

impl ModuleIo {
    pub(crate) fn new(name: Arc<str>, id: ModuleId, link: Arc<Link>) -> Self {
        Self { name, id, link, asked: Asked::default(), received: 0, run: 0, ports: Vec::new() }
    }

    /// The module's port of the mechanism with that number, if it has one.
    #[inline]
    pub(crate) fn port<P: Port>(&mut self, mechanism: usize) -> Option<&mut P> {
        let port: &mut dyn Any = &mut **self.ports.get_mut(mechanism)?.as_mut()?;
        port.downcast_mut()
    }

    /// The same for somebody who only looks.
    pub(crate) fn look<P: Port>(&self, mechanism: usize) -> Option<&P> {
        let port: &dyn Any = &**self.ports.get(mechanism)?.as_ref()?;
        port.downcast_ref()
    }

    /// The module's port of the mechanism with that number, which is made if the module has none; `None` if that is of
    /// another type.
    pub(crate) fn open<P: Port + Default>(&mut self, mechanism: usize) -> Option<&mut P> {
        if self.ports.len() <= mechanism {
            self.ports.resize_with(mechanism + 1, || None);
        }
        let port: &mut dyn Any = &mut **self.ports[mechanism].get_or_insert_with(|| Box::<P>::default());
        port.downcast_mut()
    }

    /// Has the mechanism look at the module's port.
    #[inline]
    pub(crate) fn ask(&mut self, mechanism: usize) {
        self.asked.add(Asked::of(mechanism));
    }

    /// Reports a change to all ports.
    pub(crate) fn changed(&mut self, change: ModuleChange<'_>) {
        for (mechanism, port) in self.ports.iter_mut().enumerate() {
            let Some(port) = port else { continue };
            let mut is_asked = false;
            drop_guarded("what a module was asked or asks", || is_asked = port.changed(change));
            if is_asked {
                self.asked.add(Asked::of(mechanism));
            }
        }
    }

    /// When the module has to run for one of its ports.
    pub(crate) fn due(&self) -> Time {
        self.ports.iter().flatten().fold(Time::MAX, |due, port| due.min(port.due()))
    }

    /// Takes out what the module asks of mechanisms, by their numbers.
    pub(crate) fn split_off(&mut self) -> Vec<(usize, Box<dyn Any + Send>)> {
        let asked = std::mem::take(&mut self.asked);
        let ports =
            self.ports.iter_mut().enumerate().filter(|(mechanism, _)| asked.has(Asked::of(*mechanism)));
        ports.filter_map(|(mechanism, port)| Some((mechanism, port.as_mut()?.split_off()?))).collect()
    }
}

/// What the mechanisms show to all modules in the process phase, by the numbers of the mechanisms.
#[derive(Default)]
pub(crate) struct Views {
    views: Vec<Box<dyn Any + Send + Sync>>,
}

impl Views {
    pub(crate) fn add(&mut self, view: impl Any + Send + Sync) {
        self.views.push(Box::new(view));
    }

    pub(crate) fn look(&self, mechanism: usize) -> Option<&dyn Any> {
        Some(&**self.views.get(mechanism)?)
    }

    pub(crate) fn any(&mut self, mechanism: usize) -> Option<&mut dyn Any> {
        Some(&mut **self.views.get_mut(mechanism)?)
    }

    #[inline]
    pub(crate) fn get<V: 'static>(&self, mechanism: usize) -> Option<&V> {
        self.views.get(mechanism)?.downcast_ref()
    }

    #[inline]
    pub(crate) fn get_mut<V: 'static>(&mut self, mechanism: usize) -> Option<&mut V> {
        self.views.get_mut(mechanism)?.downcast_mut()
    }
}
