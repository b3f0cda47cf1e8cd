//! Ports: the module's side of each mechanism.

use std::any::Any;
use std::sync::Arc;

use super::causes::{Asked, MESSAGES};
use super::link::Link;
use super::log_limits::LogLimits;
use crate::threads::drop_guarded;
use crate::topics::{Outboxes, Topics};
use crate::{ModuleId, Time};

/// A module's side of a [`Mechanism`](crate::Mechanism): the requests of the module to the mechanism, and the
/// data of the mechanism for the module. Only the module accesses it in the process phase, and only the
/// mechanism in the sync phase.
///
/// A vector of requests is a port.
pub trait Port: Any + Send {
    /// Handles a change of the module. Returns true if the mechanism has to process the port because of it.
    fn changed(&mut self, change: ModuleChange<'_>) -> bool;

    /// The time at which the module has to run for this port at the latest; [`Time::MAX`] for never.
    fn due(&self) -> Time {
        Time::MAX
    }

    /// Takes the requests out of the port of a detached module. The mechanism receives them in
    /// [`Mechanism::join`](crate::Mechanism::join).
    fn split_off(&mut self) -> Option<Box<dyn Any + Send>> {
        None
    }
}

/// A change of a module, as reported to its ports.
#[derive(Clone, Copy, Debug)]
pub enum ModuleChange<'a> {
    /// The module has become active.
    Activated(Time),
    /// The module is no longer active.
    Deactivated,
    /// The module should run but is not active, so its open requests will not be answered.
    Inactive {
        /// The name of the module.
        module: &'a Arc<str>,
        /// The message of the panic that ended the module, if any.
        failure: Option<&'a Arc<str>>,
    },
    /// A run of the module panicked, so its requests are void.
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

/// The data of a module besides the user's state.
pub(crate) struct ModuleIo {
    pub(crate) name: Arc<str>,
    pub(crate) id: ModuleId,
    pub(crate) link: Arc<Link>,
    /// The mechanisms that have to process a port of this module.
    pub(crate) asked: Asked,
    /// The number of messages received in this run.
    pub(crate) received: usize,
    /// The number of runs.
    pub(crate) run: u64,
    /// The state of rate-limited log lines.
    pub(crate) log_limits: LogLimits,
    /// The description given in the setup with [`Setup::made_from`](crate::Setup::made_from).
    pub(crate) made_from: Option<Vec<u8>>,
    /// The port of messaging.
    pub(crate) outboxes: Outboxes,
    /// The ports of the other mechanisms, by their numbers.
    ports: Vec<Option<Box<dyn Port>>>,
}

impl ModuleIo {
    pub(crate) fn new(name: Arc<str>, id: ModuleId, link: Arc<Link>) -> Self {
        let (asked, outboxes, ports) = (Asked::default(), Outboxes::default(), Vec::new());
        let log_limits = LogLimits::default();
        Self { name, id, link, asked, received: 0, run: 0, log_limits, made_from: None, outboxes, ports }
    }

    /// The module's port of the mechanism with this number, if it has one.
    #[inline]
    pub(crate) fn port<P: Port>(&mut self, mechanism: usize) -> Option<&mut P> {
        if mechanism == MESSAGES {
            return (&mut self.outboxes as &mut dyn Any).downcast_mut();
        }
        let port: &mut dyn Any = &mut **self.ports.get_mut(mechanism)?.as_mut()?;
        port.downcast_mut()
    }

    /// As [`port`](Self::port), for reading.
    pub(crate) fn look<P: Port>(&self, mechanism: usize) -> Option<&P> {
        let port: &dyn Any = &**self.ports.get(mechanism)?.as_ref()?;
        port.downcast_ref()
    }

    /// The module's port of the mechanism with this number; creates the port if the module has none. `None`
    /// if an existing port has another type.
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

    /// As [`open`](Self::open), for a mechanism of the core, whose port type is known.
    pub(crate) fn open_own<P: Port + Default>(&mut self, mechanism: usize) -> &mut P {
        match self.open(mechanism) {
            Some(port) => port,
            None => unreachable!("the mechanisms of the core have distinct numbers"),
        }
    }

    /// Marks the module's port for processing by the mechanism.
    #[inline]
    pub(crate) fn ask(&mut self, mechanism: usize) {
        self.asked.add(Asked::of(mechanism));
    }

    /// Reports a change to all ports.
    pub(crate) fn changed(&mut self, change: ModuleChange<'_>) {
        let mut asked = Asked::default();
        for (mechanism, port) in self.each_port() {
            let mut is_asked = false;
            drop_guarded("a request", || is_asked = port.changed(change));
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

    /// The earliest time at which the module has to run for one of its ports.
    pub(crate) fn due(&self) -> Time {
        self.ports.iter().flatten().fold(Time::MAX, |due, port| due.min(port.due()))
    }

    /// Takes the module's requests out of its ports, by the numbers of the mechanisms.
    pub(crate) fn split_off(&mut self) -> Vec<(usize, Box<dyn Any + Send>)> {
        let asked = std::mem::take(&mut self.asked);
        let ports = self.each_port().filter(|(mechanism, _)| asked.has(Asked::of(*mechanism)));
        ports.filter_map(|(mechanism, port)| Some((mechanism, port.split_off()?))).collect()
    }
}

/// The views of the mechanisms, which all modules read in the process phase.
#[derive(Default)]
pub(crate) struct Views {
    /// The view of messaging.
    pub(crate) topics: Topics,
    /// The views of all mechanisms, by their numbers; that of messaging is empty.
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
