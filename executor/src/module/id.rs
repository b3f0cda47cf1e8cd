//! Which module, and what it uses.

use super::setup::Host;

/// Identifies a module of a core; never given twice, not even to a module that was restarted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ModuleId {
    /// Its place in the order of registration.
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

/// A use that a module makes of something a mechanism keeps by name, to be given back when the module is gone.
#[derive(Clone, Copy)]
pub(crate) struct Use {
    /// The number of the mechanism.
    pub(crate) of: usize,
    pub(crate) direction: Direction,
    /// The number of what is used among those of the mechanism.
    pub(crate) index: usize,
    pub(crate) ends: UseEnds,
    /// Ends the use.
    pub(crate) give_back: fn(&mut dyn Host, ModuleId, Use),
}

/// Whether something comes to the module or goes out from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Direction {
    /// A subscription, or a service that the module serves.
    In,
    /// A publication, or a service that the module calls.
    Out,
}

/// When a use ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum UseEnds {
    /// When the module is removed, before its last messages are delivered.
    AtRemoval,
    /// When the module is gone.
    AtEnd,
}
