//! Identities of modules.

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
