//! Options of a module when it is added to a core.

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroUsize;
use std::time::Duration;

use crate::{LifecycleState, SettingValue, ThreadOptions};

/// The times at which a module runs.
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
    /// Inside the cycles in which the module has something to do: a message, a timer, a changed setting.
    #[default]
    WhenDue,
    /// Inside every cycle, whatever the reason for the cycle; see
    /// [`Setup::each_run`](crate::Setup::each_run).
    EveryCycle,
    /// On a separate thread, whenever the module has something to do. It may block without delaying a cycle.
    /// It receives whole batches, and its messages are sent in the next sync phase.
    Detached(Inbox),
}

/// The capacity of the inbox of a detached module, in batches per topic. A topic with many messages does not
/// displace those of another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inbox {
    /// All batches, without a limit.
    KeepAll,
    /// The latest batches; older ones are dropped and counted in [`StepInput::skipped`](crate::StepInput).
    KeepLast(NonZeroUsize),
}

/// Whether a module is a part of the robot or looks at its parts; decides the order of stopping.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Role {
    /// A part of the robot. Parts stop in the reverse order of registration.
    #[default]
    Part,
    /// Keeps an account of the cycles in which all parts run. Timekeepers stop before all parts, also before
    /// those that were added later.
    Timekeeper,
    /// Watches the parts and publishes or serves its observations, such as a journal. Code that only receives
    /// messages uses an [outlet](crate::Core::outlet) instead. Observers stop after all parts, in the order
    /// of registration, so that they receive the parts' last messages.
    Observer,
}

/// The restart policy of a module that panicked. A restart constructs the module with the closure given to
/// [`Core::add_restartable`](crate::Core::add_restartable) and sets it up again. The module keeps its
/// position in the order.
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
    /// The module stays stopped.
    #[default]
    Never,
    /// The module is restarted up to this number of times, and then stays stopped.
    Times {
        /// The number of restarts.
        limit: u32,
        /// The delay before a restart, see [`Restart::Always`].
        backoff: Duration,
    },
    /// The module is restarted after every panic.
    Always {
        /// The delay before a restart. It doubles with each panic up to [`Restart::LONGEST_BACKOFF`], and is
        /// reset when the module has run for longer than that.
        backoff: Duration,
    },
}

impl Restart {
    /// The longest delay before a restart, unless the configured back-off is longer.
    pub const LONGEST_BACKOFF: Duration = Duration::from_secs(30);
}

/// Options of a module when it is added, see [`Core::add_with`](crate::Core::add_with).
#[derive(Clone, Debug, Default)]
pub struct ModuleOptions {
    /// The times at which the module runs.
    pub synchrony: Synchrony,
    /// Whether the module is a part of the robot or an observer.
    pub role: Role,
    /// Values of the module's settings that differ from the defaults.
    pub settings: BTreeMap<String, SettingValue>,
    /// Names in [`Self::settings`] that are ignored if the module does not declare them.
    pub optional_settings: BTreeSet<String>,
    /// Names that replace those of the module's topics and services: from the module's name to the new one.
    pub remaps: BTreeMap<String, String>,
    /// The prefix of the names of its topics and services, such as `blue_1`; empty for none. See
    /// [`ModuleOptions::resolved`].
    pub namespace: String,
    /// The state to which the module is brought when it is added.
    pub initial_state: LifecycleState,
    /// The restart policy after a panic.
    pub restart: Restart,
    /// The longest allowed duration of a run. A run that exceeds it is reported while it is still running.
    pub deadline: Option<Duration>,
    /// The options of the module's thread if it is detached.
    pub thread: ThreadOptions,
}

impl ModuleOptions {
    /// The name in the core for one of the module's names: first remapped, then prefixed with the namespace.
    /// Absolute names such as `/clock`, and names that begin with the namespace, stay as they are.
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
