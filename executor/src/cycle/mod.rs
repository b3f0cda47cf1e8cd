//! Cycles: the schedule of modules, and the mechanisms of the sync phase.

mod agenda;
mod core;
mod detached;
mod members;
mod phase;
mod stage;
mod state;

pub(crate) use self::agenda::{Agenda, Asker};
pub use self::core::{Core, CoreHandle, Idle, RunError};
pub(crate) use detached::DetachedModule;
pub use members::ModuleInfo;
pub(crate) use members::{Member, Recruit, Source};
pub(crate) use phase::{CoreHost, Mechanisms};
pub use phase::{Mechanism, MechanismKey, Step, SyncPhase};
pub use stage::{Launcher, Stage};
pub(crate) use state::{CoreLife, CoreState, Pause};
