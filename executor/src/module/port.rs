//! A module's part of each mechanism.

use std::any::Any;
use std::sync::Arc;

use super::causes::{Asked, MESSAGES};
use super::link::Link;
use crate::log::LogLimits;
use crate::threads::drop_guarded;
use crate::topics::{Outboxes, Topics};
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
        /// What its panic said, if that is why.
        failure: Option<&'a Arc<str>>,
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
    /// The lines of its log that are not written each time.
    pub(crate) log_limits: LogLimits,
    /// What its setup says of where the module comes from, see [`Setup::made_from`](crate::Setup::made_from).
    pub(crate) made_from: Option<Vec<u8>>,
    /// The port of messages.
    pub(crate) outboxes: Outboxes,
    /// Those of the other mechanisms, by their numbers.
    ports: Vec<Option<Box<dyn Port>>>,
}

impl ModuleIo {
    pub(crate) fn new(name: Arc<str>, id: ModuleId, link: Arc<Link>) -> Self {
        let (asked, outboxes, ports) = (Asked::default(), Outboxes::default(), Vec::new());
        let log_limits = LogLimits::default();
        Self { name, id, link, asked, received: 0, run: 0, log_limits, made_from: None, outboxes, ports }
    }

    /// The module's port of the mechanism with that number, if it has one.
    #[inline]
    pub(crate) fn port<P: Port>(&mut self, mechanism: usize) -> Option<&mut P> {
        if mechanism == MESSAGES {
            return (&mut self.outboxes as &mut dyn Any).downcast_mut();
        }
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
        if mechanism == MESSAGES {
            return self.port(mechanism);
        }
        if self.ports.len() <= mechanism {
            self.ports.resize_with(mechanism + 1, || None);
        }
        let port: &mut dyn Any = &mut **self.ports[mechanism].get_or_insert_with(|| Box::<P>::default());
        port.downcast_mut()
    }

    /// The same for a mechanism of the core, whose port is known to be of that type.
    pub(crate) fn open_own<P: Port + Default>(&mut self, mechanism: usize) -> &mut P {
        match self.open(mechanism) {
            Some(port) => port,
            None => unreachable!("each mechanism of the core has a number of its own"),
        }
    }

    /// Has the mechanism look at the module's port.
    #[inline]
    pub(crate) fn ask(&mut self, mechanism: usize) {
        self.asked.add(Asked::of(mechanism));
    }

    /// Reports a change to all ports.
    pub(crate) fn changed(&mut self, change: ModuleChange<'_>) {
        let mut asked = Asked::default();
        for (mechanism, port) in self.each_port() {
            let mut is_asked = false;
            drop_guarded("what a module was asked or asks", || is_asked = port.changed(change));
            if is_asked {
                asked.add(Asked::of(mechanism));
            }
        }
        self.asked.add(asked);
    }

    /// All ports, with the numbers of their mechanisms.
    fn each_port(&mut self) -> impl Iterator<Item = (usize, &mut dyn Port)> {
        let others = self.ports.iter_mut().enumerate();
        let others = others.filter_map(|(mechanism, port)| Some((mechanism, &mut **port.as_mut()?)));
        std::iter::once((MESSAGES, &mut self.outboxes as &mut dyn Port)).chain(others)
    }

    /// When the module has to run for one of its ports.
    pub(crate) fn due(&self) -> Time {
        self.ports.iter().flatten().fold(Time::MAX, |due, port| due.min(port.due()))
    }

    /// Takes out what the module asks of mechanisms, by their numbers.
    pub(crate) fn split_off(&mut self) -> Vec<(usize, Box<dyn Any + Send>)> {
        let asked = std::mem::take(&mut self.asked);
        let ports = self.each_port().filter(|(mechanism, _)| asked.has(Asked::of(*mechanism)));
        ports.filter_map(|(mechanism, port)| Some((mechanism, port.split_off()?))).collect()
    }
}

/// What the mechanisms show to all modules in the process phase.
#[derive(Default)]
pub(crate) struct Views {
    /// The view of messages.
    pub(crate) topics: Topics,
    /// Those of all mechanisms, by their numbers; that of messages is empty.
    views: Vec<Box<dyn Any + Send + Sync>>,
}

impl Views {
    pub(crate) fn add(&mut self, view: impl Any + Send + Sync) {
        self.views.push(Box::new(view));
    }

    pub(crate) fn look(&self, mechanism: usize) -> Option<&dyn Any> {
        match mechanism {
            MESSAGES => Some(&self.topics),
            _ => Some(&**self.views.get(mechanism)?),
        }
    }

    pub(crate) fn any(&mut self, mechanism: usize) -> Option<&mut dyn Any> {
        match mechanism {
            MESSAGES => Some(&mut self.topics),
            _ => Some(&mut **self.views.get_mut(mechanism)?),
        }
    }

    pub(crate) fn get<V: 'static>(&self, mechanism: usize) -> Option<&V> {
        self.look(mechanism)?.downcast_ref()
    }

    pub(crate) fn get_mut<V: 'static>(&mut self, mechanism: usize) -> Option<&mut V> {
        self.any(mechanism)?.downcast_mut()
    }
}
