//! How a module joins a core.

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroUsize;
use std::time::Duration;

use crate::{LifecycleState, SettingValue, ThreadOptions};

/// When a module runs.
///
/// ```
/// use std::num::NonZeroUsize;
/// use std::sync::mpsc::{Sender, channel};
/// use std::thread::ThreadId;
/// use std::time::Duration;
/// use downbeat_executor::{Core, Inbox, Module, ModuleOptions, Setup, SetupError, Synchrony};
///
/// struct Logger(Sender<ThreadId>);
///
/// impl Module for Logger {
///     type Ports = ();
///
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
///         setup.subscribe::<String, _>("events", |logger, _, _| {
///             drop(logger.0.send(std::thread::current().id())); // It might as well write to a slow disk.
///         })
///     }
/// }
///
/// let (sender, threads) = channel();
/// let mut core = Core::new();
/// let synchrony = Synchrony::Detached(Inbox::KeepLast(NonZeroUsize::new(100).unwrap()));
/// core.add_with("logger", Logger(sender), ModuleOptions { synchrony, ..ModuleOptions::default() })?;
/// core.inlet("events")?.publish("battery at 10.9 V".to_owned())?;
/// core.cycle()?;
/// assert_ne!(threads.recv_timeout(Duration::from_secs(10))?, std::thread::current().id());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
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
    /// Watches the others and publishes or serves what it sees, such as a journal; who only receives uses an
    /// [outlet](crate::Core::outlet). Observers stop after all parts, in the order of registration, so that they see the
    /// parts' last messages.
    Observer,
}

/// What happens to a module that panicked. It is made anew by the closure given to
/// [`Core::add_restartable`](crate::Core::add_restartable), set up again, and keeps its place in the order.
///
/// ```
/// use std::time::Duration;
/// use downbeat_executor::{Core, LifecycleState, ManualClock, Module, ModuleOptions, Restart, Setup, SetupError, Time};
///
/// struct Camera;
///
/// impl Module for Camera {
///     type Ports = ();
///
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
///         setup.every(Duration::from_millis(33), |_, _| panic!("the cable came loose"))
///     }
/// }
///
/// let clock = ManualClock::new(Time::ZERO);
/// let mut core = Core::new().with_clock(clock.clone());
/// let restart = Restart::Times { limit: 1, backoff: Duration::from_millis(500) };
/// core.add_restartable("camera", || Camera, ModuleOptions { restart, ..ModuleOptions::default() })?;
/// core.cycle()?;
/// let state = |core: &Core| (core.modules()[0].state, core.modules()[0].restarts);
/// clock.advance(Duration::from_millis(33));
/// core.cycle()?;
/// assert_eq!(state(&core), (LifecycleState::Finalized, 0));
/// clock.advance(Duration::from_millis(500));
/// core.cycle()?;
/// core.cycle()?;
/// assert_eq!(state(&core), (LifecycleState::Active, 1));
/// clock.advance(Duration::from_millis(33));
/// core.cycle()?;
/// clock.advance(Duration::from_secs(60));
/// core.cycle()?;
/// assert_eq!(state(&core), (LifecycleState::Finalized, 1)); // That was once too often.
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
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
    /// Names in [`Self::settings`] that are ignored if the module does not declare them.
    pub optional_settings: BTreeSet<String>,
    /// Other names for its topics and services: from the module's name to the one to use.
    pub remaps: BTreeMap<String, String>,
    /// What comes before the names of its topics and services, such as `blue_1`; see [`ModuleOptions::resolved`]. Empty for
    /// nothing.
    pub namespace: String,
    /// The state to which it is brought when it has joined.
    pub initial_state: LifecycleState,
    /// What happens when it panicked.
    pub restart: Restart,
    /// How long one run may take. A run that takes longer is reported while it is still going on.
    pub deadline: Option<Duration>,
    /// Where its thread runs, if it is detached.
    pub thread: ThreadOptions,
}

impl ModuleOptions {
    /// The name in the core that stands for one of the module's own: remapped, then in the namespace. Names that are absolute, as
    /// `/clock`, or that begin with the namespace stay as they are.
    ///
    /// ```
    /// use downbeat_executor::ModuleOptions;
    ///
    /// let options = ModuleOptions {
    ///     namespace: "blue_1".to_owned(),
    ///     remaps: [("state".to_owned(), "/match/state".to_owned())].into(),
    ///     ..ModuleOptions::default()
    /// };
    /// assert_eq!(options.resolved("imu/data"), "blue_1/imu/data");
    /// assert_eq!(options.resolved("blue_1/imu/data"), "blue_1/imu/data");
    /// assert_eq!(options.resolved("state"), "/match/state");
    /// assert_eq!(options.resolved("/clock"), "/clock");
    /// ```
    #[must_use]
    pub fn resolved(&self, name: &str) -> String {
        resolved(name, &self.remaps, &self.namespace)
    }
}

/// See [`ModuleOptions::resolved`].
pub(crate) fn resolved(name: &str, remaps: &BTreeMap<String, String>, namespace: &str) -> String {
    let name = remaps.get(name.strip_prefix('/').unwrap_or(name)).map_or(name, String::as_str);
    let is_inside = || name.strip_prefix(namespace).is_some_and(|rest| rest.starts_with('/'));
    if namespace.is_empty() || name.starts_with('/') || is_inside() {
        return name.to_owned();
    }
    format!("{namespace}/{name}")
}
