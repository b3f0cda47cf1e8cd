//! Declarations of a module when it is added to a core.

use std::collections::{BTreeMap, BTreeSet};

use super::behaviour::Steps;
use super::causes::Causes;
use super::host::{Host, Offer};
use super::options;
use super::port::ModuleIo;
use super::uses::Use;
use crate::{Context, Module, SettingValue, SetupError, Version};

/// Passed to [`Module::setup`](crate::Module::setup) for the declaration of the module's publications,
/// subscriptions, services, timers and settings.
pub struct Setup<'a, M: Module> {
    pub(crate) io: &'a mut ModuleIo,
    pub(crate) host: &'a mut dyn Host,
    pub(crate) uses: &'a mut Vec<Use>,
    pub(crate) steps: Steps<M>,
    is_detached: bool,
    given: Given,
    own_names: Vec<String>,
    setting_names: Vec<String>,
}

/// The named options given to a module.
#[derive(Default)]
pub(crate) struct Given {
    pub(crate) settings: BTreeMap<String, SettingValue>,
    pub(crate) optional_settings: BTreeSet<String>,
    pub(crate) remaps: BTreeMap<String, String>,
    pub(crate) namespace: String,
}

impl<'a, M: Module> Setup<'a, M> {
    pub(crate) fn new(
        io: &'a mut ModuleIo,
        host: &'a mut dyn Host,
        uses: &'a mut Vec<Use>,
        is_detached: bool,
        given: Given,
    ) -> Self {
        let (own_names, setting_names) = (Vec::new(), Vec::new());
        Self { io, host, uses, steps: Steps::default(), is_detached, given, own_names, setting_names }
    }

    /// Checks that all given settings and remaps were declared.
    pub(crate) fn finish(self) -> Result<Steps<M>, SetupError> {
        let module = self.io.name.to_string();
        let Given { settings, optional_settings, remaps, .. } = self.given;
        let (ignored, unknown): (Vec<_>, Vec<_>) =
            settings.into_keys().partition(|setting| optional_settings.contains(setting));
        for setting in ignored {
            tracing::debug!(module, "no setting \"{setting}\" is declared: its value is ignored");
        }
        if let Some(setting) = unknown.into_iter().next() {
            return Err(SetupError::UnknownSetting { module, setting, known: self.setting_names });
        }
        if let Some((topic, _)) = remaps.into_iter().find(|(from, _)| !self.own_names.contains(from)) {
            return Err(SetupError::UnknownTopic { module, topic, known: self.own_names });
        }
        Ok(self.steps)
    }

    /// The name under which the module is being added.
    #[must_use]
    pub fn module_name(&self) -> &str {
        &self.io.name
    }

    /// The resolved form of one of the module's names, after its
    /// [remaps and namespace](crate::ModuleOptions::resolved); for code that derives several names from one.
    /// Names of topics and services are resolved automatically.
    pub fn remapped(&mut self, name: &str) -> String {
        self.own_names.push(name.strip_prefix('/').unwrap_or(name).to_owned());
        options::resolved(name, &self.given.remaps, &self.given.namespace)
    }

    /// Describes the source of the module, such as the version of a source file. The event
    /// [`ModuleEventKind::Made`](crate::ModuleEventKind) carries the description, so that a replay can use
    /// the same source.
    pub fn made_from(&mut self, description: Vec<u8>) {
        self.io.made_from = Some(description);
    }

    /// An error with a reason given by the module.
    #[must_use]
    pub fn refuse(&self, reason: impl Into<String>) -> SetupError {
        SetupError::Refused { module: self.io.name.to_string(), reason: reason.into() }
    }

    /// Requires one of the core's mechanisms by name ("messaging", "services", "settings", "timers",
    /// "modules", "jobs"), at this version or a compatible later one.
    ///
    /// # Errors
    /// If the core does not offer the mechanism, or only another version.
    ///
    /// ```
    /// # use downbeat_executor::{Core, Module, Setup, SetupError, Version};
    /// struct Planner;
    ///
    /// impl Module for Planner {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.require("jobs", Version::new(1, 0))?;
    ///         setup.require("teleportation", Version::new(1, 0))
    ///     }
    /// }
    ///
    /// let refused = Core::new().add("planner", Planner).unwrap_err();
    /// assert!(matches!(refused, SetupError::Mechanism { mechanism, .. } if mechanism == "teleportation"));
    /// ```
    pub fn require(&self, mechanism: &str, version: Version) -> Result<(), SetupError> {
        let offers = self.host.offers();
        let offered = offers.iter().find(|offer| offer.name == mechanism).map(|offer| offer.version);
        if offered.is_some_and(|offered| offered.offers(version)) {
            return Ok(());
        }
        Err(SetupError::Mechanism {
            module: self.io.name.to_string(),
            mechanism: mechanism.into(),
            asked: version,
            offered,
            known: offers.iter().map(|Offer { name, version, .. }| format!("{name} {version}")).collect(),
        })
    }

    /// True if the module is to run on a separate thread, provided that the clock allows it.
    pub(crate) fn is_detached(&self) -> bool {
        self.is_detached
    }

    /// Takes the given value of a setting, if any, and marks the setting as declared.
    pub(crate) fn take_given_setting(&mut self, name: &str) -> Option<SettingValue> {
        self.setting_names.push(name.to_owned());
        self.given.settings.remove(name)
    }

    /// Calls `callback` at the end of each run of the module, after its messages, requests, answers and
    /// timers. With [`Synchrony::EveryCycle`](crate::Synchrony::EveryCycle), that is in every cycle.
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};
    /// /// Publishes one mean for all that came in a cycle.
    /// #[derive(Default)]
    /// struct Mean {
    ///     ranges: Vec<f64>,
    /// }
    ///
    /// impl Module for Mean {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         let mean = setup.publish::<f64>("mean_range")?;
    ///         setup.subscribe::<f64, _>("range", |module, range, _| module.ranges.push(*range))?;
    ///         setup.each_run(move |module, ctx| {
    ///             if !module.ranges.is_empty() {
    ///                 ctx.publish(mean, module.ranges.iter().sum::<f64>() / module.ranges.len() as f64);
    ///                 module.ranges.clear();
    ///             }
    ///         });
    ///         Ok(())
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("mean", Mean::default())?;
    /// let range = core.inlet("range")?;
    /// [1.0, 1.5, 2.0].into_iter().try_for_each(|metres| range.publish(metres))?;
    /// core.cycle()?;
    /// core.cycle()?;
    /// assert_eq!(core.topics().find(|topic| &*topic.name == "mean_range").unwrap().counter.messages(), 1);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn each_run<F>(&mut self, callback: F)
    where
        F: FnMut(&mut M, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        self.steps.add(Causes::EACH_RUN, callback);
    }
}
