//! The modules of a core, by name and in the order of registration.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use crate::inspect::ModuleMeter;
use crate::management::Source;
use crate::setup::Uses;
use crate::{ModuleOptions, Role, Time};

/// Tells the modules of a core apart; never given twice, not even to a module that was restarted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ModuleId {
    pub(crate) order: u64,
    /// Counts the restarts: what was meant for the module before it panicked does not reach it after.
    pub(crate) life: u32,
    pub(crate) place: Place,
}

/// Where a module is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Place {
    /// In the stage, by slot.
    Attached(usize),
    /// On a thread of its own, by slot.
    Detached(usize),
}

/// What is known of a module beside its cell.
pub(crate) struct Member {
    pub(crate) id: ModuleId,
    pub(crate) name: Arc<str>,
    pub(crate) options: ModuleOptions,
    pub(crate) source: Source,
    pub(crate) uses: Uses,
    /// How often it was started again after a panic.
    pub(crate) restarts: u32,
    /// Panics in a row, without a time in which it ran well.
    pub(crate) panics_in_a_row: u32,
    pub(crate) started: Time,
    /// What its last life counted, until the next begins.
    pub(crate) meter: Option<ModuleMeter>,
}

impl Member {
    pub(crate) fn role(&self) -> Role {
        self.options.role
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

    /// Frees the name; the rest goes with [`take`](Self::take).
    pub(crate) fn forget_name(&mut self, name: &str) {
        self.by_name.remove(name);
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
