//! The modules of a core, by name and in the order of registration.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::time::Duration;

use crate::module::{Behaviour, Given, Host, ModuleBehaviour, ModuleIo, Use};
use crate::observe::ModuleMeter;
use crate::{LifecycleState, Module, ModuleId, ModuleOptions, Role, Setup, SetupError, Time};

/// A description of a module, see [`Core::modules`](crate::Core::modules).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModuleInfo {
    /// The name under which the module was added.
    pub name: Arc<str>,
    /// The lifecycle state.
    pub state: LifecycleState,
    /// Whether the module is a part of the robot or an observer.
    pub role: Role,
    /// True if the module runs on a separate thread.
    pub is_detached: bool,
    /// True if the module is paused.
    pub is_paused: bool,
    /// The number of restarts after a panic.
    pub restarts: u32,
    /// The message of the panic that ended the module, until it is restarted.
    pub panic: Option<Arc<str>>,
}

/// The data of a module outside its cell.
pub(crate) struct Member {
    pub(crate) id: ModuleId,
    pub(crate) name: Arc<str>,
    pub(crate) options: ModuleOptions,
    pub(crate) source: Source,
    pub(crate) uses: Vec<Use>,
    /// The number of restarts after a panic.
    pub(crate) restarts: u32,
    /// The message of the panic that ended the module, until it is restarted.
    pub(crate) panic: Option<Arc<str>>,
    /// Consecutive panics; reset when the module has run well for some time.
    pub(crate) panics_in_a_row: u32,
    pub(crate) started: Time,
    /// The periods of the module's timers.
    pub(crate) periods: Vec<Duration>,
    /// The counters of the previous instance, until the module is restarted.
    pub(crate) meter: Option<ModuleMeter>,
}

impl Member {
    pub(crate) fn role(&self) -> Role {
        self.options.role
    }
}

/// How a module is constructed.
pub(crate) enum Source {
    /// A module that was passed to the core, and cannot be constructed again.
    Once(Option<Box<dyn Recruit>>),
    /// A factory, which constructs the module again after a panic.
    Factory(Box<dyn FnMut() -> Box<dyn Recruit> + Send>),
}

impl Source {
    pub(crate) fn once<M: Module>(module: M) -> Self {
        Self::Once(Some(Box::new(module)))
    }

    pub(crate) fn factory<M: Module>(mut make: impl FnMut() -> M + Send + 'static) -> Self {
        Self::Factory(Box::new(move || Box::new(make())))
    }

    pub(crate) fn make(&mut self) -> Option<Box<dyn Recruit>> {
        match self {
            Self::Once(module) => module.take(),
            Self::Factory(make) => Some(make()),
        }
    }
}

/// A module before its setup, with its type erased.
pub(crate) trait Recruit: Send {
    fn set_up(
        self: Box<Self>,
        io: &mut ModuleIo,
        host: &mut dyn Host,
        uses: &mut Vec<Use>,
        is_detached: bool,
        given: Given,
    ) -> Result<Box<dyn Behaviour>, SetupError>;
}

impl<M: Module> Recruit for M {
    fn set_up(
        mut self: Box<Self>,
        io: &mut ModuleIo,
        host: &mut dyn Host,
        uses: &mut Vec<Use>,
        is_detached: bool,
        given: Given,
    ) -> Result<Box<dyn Behaviour>, SetupError> {
        let mut setup = Setup::new(io, host, uses, is_detached, given);
        let ports = self.setup(&mut setup)?;
        let steps = setup.finish()?;
        Ok(Box::new(ModuleBehaviour { module: *self, ports, steps }))
    }
}

/// The modules of a core.
#[derive(Default)]
pub(crate) struct Members {
    by_order: BTreeMap<u64, Member>,
    by_name: HashMap<Arc<str>, u64>,
    next_order: u64,
}

impl Members {
    pub(crate) fn next_order(&mut self) -> u64 {
        self.next_order += 1;
        self.next_order - 1
    }

    pub(crate) fn insert(&mut self, member: Member) {
        self.by_name.insert(Arc::clone(&member.name), member.id.order);
        self.by_order.insert(member.id.order, member);
    }

    /// Inserts a member without entering its name, which another module may have.
    pub(crate) fn insert_nameless(&mut self, member: Member) {
        self.by_order.insert(member.id.order, member);
    }

    pub(crate) fn take(&mut self, order: u64) -> Option<Member> {
        let member = self.by_order.remove(&order)?;
        if self.by_name.get(&member.name) == Some(&order) {
            self.by_name.remove(&member.name);
        }
        Some(member)
    }

    pub(crate) fn find(&self, name: &str) -> Option<&Member> {
        self.by_order.get(self.by_name.get(name)?)
    }

    /// True if the module was removed, but its last callback has not finished.
    pub(crate) fn is_leaving(&self, order: u64) -> bool {
        self.get(order).is_some_and(|member| self.by_name.get(&member.name) != Some(&order))
    }

    pub(crate) fn get(&self, order: u64) -> Option<&Member> {
        self.by_order.get(&order)
    }

    pub(crate) fn get_mut(&mut self, order: u64) -> Option<&mut Member> {
        self.by_order.get_mut(&order)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.by_order.is_empty()
    }

    /// All members in the order of registration, including those that are leaving.
    pub(crate) fn iter(&self) -> impl DoubleEndedIterator<Item = &Member> {
        self.by_order.values()
    }

    /// The names in use, in the order of registration.
    pub(crate) fn names(&self) -> impl Iterator<Item = &Arc<str>> {
        self.by_order
            .values()
            .filter(|member| self.by_name.get(&member.name) == Some(&member.id.order))
            .map(|member| &member.name)
    }
}
