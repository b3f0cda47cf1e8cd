//! Identities of modules, and their uses of named resources.

use super::setup::Host;

/// Identifies a module of a core. Identifiers are never reused, not even for a restarted module.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ModuleId {
    /// The position in the order of registration.
    pub(crate) order: u64,
    /// The number of restarts. Requests addressed to an earlier instance do not reach the next one.
    pub(crate) life: u32,
    pub(crate) place: Place,
}

/// Where the core keeps a module.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Place {
    /// In the stage, by slot.
    Attached(usize),
    /// On a separate thread, by slot.
    Detached(usize),
}

/// A module's use of a named resource of a mechanism, which ends with the module.
#[derive(Clone, Copy)]
pub(crate) struct Use {
    /// The number of the mechanism.
    pub(crate) of: usize,
    pub(crate) direction: Direction,
    /// The index of the resource in the mechanism.
    pub(crate) index: usize,
    pub(crate) ends: UseEnds,
    /// Ends the use.
    pub(crate) give_back: fn(&mut dyn Host, ModuleId, Use),
}

/// The direction of data, seen from the module.
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
