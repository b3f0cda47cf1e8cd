//! A module's uses of named resources of mechanisms.

use super::host::Host;
use crate::ModuleId;

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
