//! The modules of a core, by name and in the order of registration.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::time::Duration;

use crate::module::{Behaviour, Given, Host, ModuleBehaviour, ModuleIo, Use};
use crate::observe::ModuleMeter;
use crate::{LifecycleState, Module, ModuleId, ModuleOptions, Role, Setup, SetupError, Time};

/// What is known of a module, see [`Core::modules`](crate::Core::modules).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModuleInfo {
    /// The name under which it was added.
    pub name: Arc<str>,
    /// Where it is in its life.
    pub state: LifecycleState,
    /// Whether it is a part of the robot or an observer.
    pub role: Role,
    /// True if it runs on a thread of its own.
    pub is_detached: bool,
    /// True if it is paused.
    pub is_paused: bool,
    /// How often it was started again after a panic.
    pub restarts: u32,
    /// What the panic said that ended it, until it is started again.
    pub panic: Option<Arc<str>>,
}

/// What is known of a module beside its cell.
pub(crate) struct Member {
    pub(crate) id: ModuleId,
    pub(crate) name: Arc<str>,
    pub(crate) options: ModuleOptions,
    pub(crate) source: Source,
    pub(crate) uses: Vec<Use>,
    /// How often it was started again after a panic.
    pub(crate) restarts: u32,
    /// What the panic said that ended it, until it is started again.
    pub(crate) panic: Option<Arc<str>>,
    /// Panics in a row, without a time in which it ran well.
    pub(crate) panics_in_a_row: u32,
    pub(crate) started: Time,
    /// Of its timers.
    pub(crate) periods: Vec<Duration>,
    /// What its last life counted, until the next begins.
    pub(crate) meter: Option<ModuleMeter>,
}

impl Member {
    pub(crate) fn role(&self) -> Role {
        self.options.role
    }
}

/// Where a module comes from.
pub(crate) enum Source {
    /// It exists, and cannot be made again.
    Once(Option<Box<dyn Recruit>>),
    /// It can be made again after a panic.
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

/// A module of a type that only it knows, before its setup.
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

    /// Keeps a member whose name may be given to another.
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

    /// True if the module was removed, and runs or waits for its end.
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

    /// In the order of registration; those that are leaving are among them.
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
