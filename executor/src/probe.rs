//! Tests of modules with a core whose time is controlled by the test.

use std::collections::BTreeSet;
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::threads::unpoisoned;
use crate::{
    CallError, Clock, Core, Inbox, InletError, ManualClock, Module, ModuleOptions, Received, RunError,
    SettingRefused, SettingValue, SetupError, Time,
};

/// A core for the test of a module. It publishes, receives and calls in place of the rest of the robot. Time
/// stands still until the test advances it, so the test never waits and the result is the same on every
/// machine.
///
/// ```
/// use std::time::Duration;
/// use downbeat_executor::{Module, Probe, Publication, Setup, SetupError};
///
/// #[derive(Default)]
/// struct Distance(f64);
///
/// impl Module for Distance {
///     type Ports = Publication<f64>;
///
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Publication<f64>, SetupError> {
///         setup.subscribe::<f64, _>("step", |distance, step, _| distance.0 += *step)?;
///         setup.every(Duration::from_millis(100), |distance, ctx| ctx.publish(*ctx.ports, distance.0))?;
///         setup.serve::<(), f64, _>("reset", |distance, (), _| Ok(std::mem::take(&mut distance.0)))?;
///         setup.publish("distance")
///     }
/// }
///
/// let mut probe = Probe::new();
/// probe.add("distance", Distance::default())?;
/// let distance = probe.listen::<f64>("distance")?;
/// probe.publish("step", 0.5)?;
/// probe.publish("step", 0.25)?;
/// probe.advance(Duration::from_millis(200))?;
/// assert_eq!(distance.take(), [0.75, 0.75]);
/// assert_eq!(probe.call::<(), f64>("reset", ())?, 0.75);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// Every method runs the modules until no module has anything to do at the current time of the clock. If a
/// module panics, the method that ran it returns an error. Detached modules run inside the cycle.
pub struct Probe {
    core: Core,
    clock: ManualClock,
    /// The modules whose panic has been reported.
    reported: BTreeSet<Arc<str>>,
}

/// Errors of a [`Probe`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProbeError {
    /// A module cannot join, or a topic or service exists with other types.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// The core cannot run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The core refuses a message.
    #[error("\"{topic}\": {source}")]
    Inlet {
        /// The topic.
        topic: String,
        /// The error of the inlet.
        source: InletError,
    },
    /// A call has received no response.
    #[error(transparent)]
    Call(#[from] CallError),
    /// A setting refuses a value.
    #[error(transparent)]
    Setting(#[from] SettingRefused),
    /// A module has panicked.
    #[error("module \"{module}\" panicked: {reason}")]
    Panicked {
        /// The module.
        module: Arc<str>,
        /// The message of the panic.
        reason: Arc<str>,
    },
    /// The modules keep each other busy, and the probe never comes to rest.
    #[error(
        "the modules are still busy after {cycles} cycles at the same time: they answer each other without end"
    )]
    Restless {
        /// The number of cycles that ran.
        cycles: u32,
    },
}

/// The messages of a topic, from [`Probe::listen`].
#[derive(Clone)]
pub struct Heard<T>(Arc<Mutex<Vec<T>>>);

impl<T> Heard<T> {
    /// Takes the messages since the last take, in the order of publishing.
    #[must_use]
    pub fn take(&self) -> Vec<T> {
        std::mem::take(&mut *unpoisoned(self.0.lock()))
    }

    /// Takes the messages and returns the last one.
    #[must_use]
    pub fn take_last(&self) -> Option<T> {
        self.take().pop()
    }
}

impl Default for Probe {
    fn default() -> Self {
        Self::new()
    }
}

impl Probe {
    /// The time at which a probe begins. It is not zero, because a stamp of zero means "no time".
    pub const START: Time = Time::from_nanos(1_000_000_000_000);

    /// The longest time that a [call](Self::call) may take.
    pub const PATIENCE: Duration = Duration::from_secs(5);

    const MOST_CYCLES: u32 = 10_000;

    /// A probe without modules.
    #[must_use]
    pub fn new() -> Self {
        let clock = ManualClock::new(Self::START);
        let core = Core::new().with_clock(clock.clone());
        Self { core, clock, reported: BTreeSet::new() }
    }

    /// Adds a module.
    ///
    /// # Errors
    /// If its setup fails, or it panics when it starts.
    pub fn add(&mut self, name: &str, module: impl Module) -> Result<(), ProbeError> {
        self.add_with(name, module, ModuleOptions::default())
    }

    /// Adds a module with options, such as values of its settings.
    ///
    /// # Errors
    /// As for [`add`](Self::add).
    pub fn add_with(
        &mut self,
        name: &str,
        module: impl Module,
        options: ModuleOptions,
    ) -> Result<(), ProbeError> {
        self.core.add_with(name, module, options)?;
        self.settle()
    }

    /// Collects the messages of a topic from now on.
    ///
    /// # Errors
    /// If the topic carries another type.
    pub fn listen<T: Clone + Send + Sync + 'static>(&mut self, topic: &str) -> Result<Heard<T>, ProbeError> {
        let messages = Arc::<Mutex<Vec<T>>>::default();
        let heard = Heard(Arc::clone(&messages));
        let collect = move |message: Received<'_, T>| unpoisoned(messages.lock()).push(message.clone());
        self.core.outlet(topic, Inbox::KeepAll, collect)?.keep();
        Ok(heard)
    }

    /// Publishes a message, and runs the modules that receive it.
    ///
    /// # Errors
    /// If the topic carries another type, or a module panics.
    pub fn publish<T: Send + Sync + 'static>(&mut self, topic: &str, message: T) -> Result<(), ProbeError> {
        let published = self.core.inlet(topic)?.publish(message);
        published.map_err(|source| ProbeError::Inlet { topic: topic.to_owned(), source })?;
        self.settle()
    }

    /// Calls a service, and returns its response. Advances time until the response comes, by at most
    /// [`PATIENCE`](Self::PATIENCE).
    ///
    /// # Errors
    /// If the service has other types, no server or no response, or a module panics.
    pub fn call<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        service: &str,
        request: Q,
    ) -> Result<R, ProbeError> {
        let (sender, response) = channel();
        let caller = self.core.caller::<Q, R>(service)?;
        caller.call(request, Self::PATIENCE, move |result| drop(sender.send(result)))?;
        self.wait(Self::PATIENCE, || response.try_recv().ok())?
            .unwrap_or_else(|| Err(CallError::TimedOut { service: service.into(), timeout: Self::PATIENCE }))
            .map_err(ProbeError::from)
    }

    /// Changes a setting of a module.
    ///
    /// # Errors
    /// If there is no such setting, the setting refuses the value, or a module panics.
    pub fn set(
        &mut self,
        module: &str,
        setting: &str,
        value: impl Into<SettingValue>,
    ) -> Result<(), ProbeError> {
        let receipt = self.core.handle().set(module, setting, value);
        self.settle()?;
        receipt.try_take().unwrap_or(Ok(())).map_err(ProbeError::from)
    }

    /// Advances time. Timers and tasks run at their times, including those due at the end of `time`.
    ///
    /// # Errors
    /// If a module panics.
    pub fn advance(&mut self, time: Duration) -> Result<(), ProbeError> {
        self.wait(time, || None::<()>).map(drop)
    }

    /// Advances time until `find` returns a value, by at most `patience`.
    ///
    /// # Errors
    /// If a module panics.
    pub fn wait<T>(
        &mut self,
        patience: Duration,
        mut find: impl FnMut() -> Option<T>,
    ) -> Result<Option<T>, ProbeError> {
        let end = self.now() + patience;
        loop {
            self.settle()?;
            if let Some(found) = find() {
                return Ok(Some(found));
            }
            match self.core.next_event().filter(|&at| at <= end) {
                Some(at) => self.clock.set(at),
                None if self.now() < end => self.clock.set(end),
                None => return Ok(None),
            }
        }
    }

    /// The time that the modules see.
    #[must_use]
    pub fn now(&self) -> Time {
        self.clock.now()
    }

    /// The core, for functions that the probe does not offer. The methods of the probe run its cycles.
    pub fn core(&mut self) -> &mut Core {
        &mut self.core
    }

    /// Runs cycles until nothing is left to do at the current time.
    ///
    /// # Errors
    /// If a module panics, or the modules never come to rest.
    pub fn settle(&mut self) -> Result<(), ProbeError> {
        let now = self.now();
        let mut cycles = 0;
        loop {
            self.core.cycle()?;
            cycles += 1;
            self.check_panics()?;
            if self.core.next_event().is_none_or(|at| at > now) {
                break;
            }
            if cycles == Self::MOST_CYCLES {
                return Err(ProbeError::Restless { cycles });
            }
        }
        // Outlets receive the messages of the last cycle at the beginning of the next cycle.
        self.core.cycle()?;
        self.check_panics()
    }

    fn check_panics(&mut self) -> Result<(), ProbeError> {
        for module in self.core.modules() {
            match module.panic {
                None => drop(self.reported.remove(&module.name)),
                Some(reason) => {
                    if self.reported.insert(Arc::clone(&module.name)) {
                        return Err(ProbeError::Panicked { module: module.name, reason });
                    }
                }
            }
        }
        Ok(())
    }
}
