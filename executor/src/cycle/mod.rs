//! Cycles: the schedule of modules, and the mechanisms of the sync phase.

mod agenda;
mod core;
mod detached;
mod mechanism;
mod members;
mod phase;
mod stage;

pub(crate) use self::agenda::{Agenda, Asker};
pub use self::core::{Core, CoreHandle, Idle, RunError};
pub(crate) use detached::DetachedModule;
pub(crate) use mechanism::{CoreHost, Mechanisms};
pub use mechanism::{Mechanism, MechanismKey, Step};
pub use members::ModuleInfo;
pub(crate) use members::{Member, Recruit, Source};
pub use phase::SyncPhase;
pub(crate) use phase::{CoreLife, CoreState, Pause};
pub use stage::{Launcher, Stage};
