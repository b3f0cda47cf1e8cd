//! How a module joins a core.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;

use crate::SettingValue;

/// When a module runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Synchrony {
    /// Inside the cycles in which it has something to do: a message, a timer, a changed setting.
    #[default]
    WhenDue,
    /// On a thread of its own, whenever it has something to do: it may block without delaying a cycle.
    /// It receives whole batches, and what it publishes joins at the next sync phase.
    Detached(Inbox),
}

/// How many batches of each topic wait for a detached module that is busy. A topic with many messages does
/// not push out those of another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inbox {
    /// All, however many.
    KeepAll,
    /// The latest; older ones are dropped and counted in [`StepInput::skipped`](crate::StepInput).
    KeepLast(NonZeroUsize),
}

/// What a module is for, which decides when it stops.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Role {
    /// A part of the robot. Parts stop in the reverse order of registration.
    #[default]
    Part,
    /// Watches the others: a recorder, a bridge. Observers stop after all parts, in the order of
    /// registration, so that they see the parts' last messages.
    Observer,
}

/// How a module joins a core, see [`Core::add_with`](crate::Core::add_with).
#[derive(Clone, Debug, Default)]
pub struct ModuleOptions {
    /// When it runs.
    pub synchrony: Synchrony,
    /// What it is for.
    pub role: Role,
    /// Values of its settings that differ from the defaults.
    pub settings: BTreeMap<String, SettingValue>,
    /// Other names for its topics: from the module's name to the one to use.
    pub remaps: BTreeMap<String, String>,
}
