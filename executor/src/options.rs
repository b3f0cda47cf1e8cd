//! How a module joins a core.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::time::Duration;

use crate::{LifecycleState, SettingValue, ThreadOptions};

/// When a module runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Synchrony {
    /// Inside the cycles in which it has something to do: a message, a timer, a changed setting.
    #[default]
    WhenDue,
    /// Inside every cycle there is, whatever the cycle is for; see
    /// [`Setup::each_run`](crate::Setup::each_run).
    EveryCycle,
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

/// What happens to a module that panicked. It is made anew by the closure given to
/// [`Core::add_restartable`](crate::Core::add_restartable), set up again, and keeps its place in the order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Restart {
    /// It stays stopped.
    #[default]
    Never,
    /// It is started again that many times; then it stays stopped.
    Times {
        /// How many times.
        limit: u32,
        /// How long it waits before it starts again, see [`Restart::Always`].
        backoff: Duration,
    },
    /// It is started again after every panic.
    Always {
        /// How long it waits before it starts again: doubled with each panic up to [`Restart::LONGEST_BACKOFF`],
        /// and set back when it has run for longer than that.
        backoff: Duration,
    },
}

impl Restart {
    /// The longest time a module waits before it starts again, unless its back-off is longer by itself.
    pub const LONGEST_BACKOFF: Duration = Duration::from_secs(30);
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
    /// Other names for its topics and services: from the module's name to the one to use.
    pub remaps: BTreeMap<String, String>,
    /// The state to which it is brought when it has joined.
    pub initial_state: LifecycleState,
    /// What happens when it panicked.
    pub restart: Restart,
    /// How long one run may take. A run that takes longer is reported while it is still going on.
    pub deadline: Option<Duration>,
    /// Where its thread runs, if it is detached.
    pub thread: ThreadOptions,
}
