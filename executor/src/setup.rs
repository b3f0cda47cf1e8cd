//! What a module declares when it joins a core.

use std::collections::BTreeMap;
use std::marker::PhantomData;
use std::ops::RangeInclusive;
use std::time::Duration;

use crate::behaviour::{Callbacks, Subscription, answering, answering_later, checking, finishing, replying};
use crate::job::JobPort;
use crate::mechanism::{MechanismKey, Offers};
use crate::messaging::Topics;
use crate::module_io::ModuleIo;
use crate::schedule::Timer;
use crate::service::{ClientPort, ServerPort, ServiceRegistry};
use crate::setting::{SettingInfo, SettingType};
use crate::{
    Client, Context, Job, JobError, Mechanism, Module, Publication, Received, Reply, Responder, Setting,
    SettingValue, SetupError, Task, TopicInfo, Version,
};

/// What a module finds by name when it is set up.
pub(crate) struct Registries<'a> {
    pub(crate) topics: &'a mut Topics,
    pub(crate) services: &'a mut ServiceRegistry,
    pub(crate) offers: &'a Offers,
}

/// What a module uses of the registries, to be given back when it is gone.
#[derive(Default)]
pub(crate) struct Uses {
    /// In the order of subscription.
    pub(crate) subscribed: Vec<usize>,
    pub(crate) published: Vec<usize>,
    pub(crate) services: Vec<usize>,
}

/// Passed to [`Module::setup`](crate::Module::setup): what the module publishes, receives, serves, calls, does at
/// a time and can be set to is declared here.
pub struct Setup<'a, M: Module> {
    io: &'a mut ModuleIo,
    registries: Registries<'a>,
    uses: &'a mut Uses,
    is_detached: bool,
    callbacks: Callbacks<M>,
    given_settings: BTreeMap<String, SettingValue>,
    remaps: BTreeMap<String, String>,
    own_names: Vec<String>,
}

impl<'a, M: Module> Setup<'a, M> {
    pub(crate) fn new(
        io: &'a mut ModuleIo,
        registries: Registries<'a>,
        uses: &'a mut Uses,
        is_detached: bool,
        given_settings: BTreeMap<String, SettingValue>,
        remaps: BTreeMap<String, String>,
    ) -> Self {
        let (callbacks, own_names) = (Callbacks::default(), Vec::new());
        Self { io, registries, uses, is_detached, callbacks, given_settings, remaps, own_names }
    }

    /// Checks that nothing was given that the module did not ask for.
    pub(crate) fn finish(self) -> Result<Callbacks<M>, SetupError> {
        let module = self.io.name.to_string();
        if let Some((setting, _)) = self.given_settings.into_iter().next() {
            let known = self.io.settings.infos().iter().map(|info| info.name.clone()).collect();
            return Err(SetupError::UnknownSetting { module, setting, known });
        }
        if let Some((topic, _)) = self.remaps.into_iter().find(|(from, _)| !self.own_names.contains(from)) {
            return Err(SetupError::UnknownTopic { module, topic, known: self.own_names });
        }
        Ok(self.callbacks)
    }

    /// The name under which the module is being added.
    #[must_use]
    pub fn module_name(&self) -> &str {
        &self.io.name
    }

    /// The topics that modules have declared so far.
    pub fn topics(&self) -> impl Iterator<Item = &TopicInfo> {
        self.registries.topics.infos()
    }

    /// What stands for a name of the module's own where it was added, by the [remaps](crate::ModuleOptions::remaps) it was
    /// given: for code that makes several names of one. Topics and services are remapped by themselves.
    pub fn remapped(&mut self, name: &str) -> String {
        self.resolve(name)
    }

    /// An error with a reason of the module's own.
    #[must_use]
    pub fn refuse(&self, reason: impl Into<String>) -> SetupError {
        SetupError::Refused { module: self.io.name.to_string(), reason: reason.into() }
    }

    /// An error with what is wrong with the value that a setting was given.
    #[must_use]
    pub fn refuse_value<T>(&self, setting: Setting<T>, refusal: impl Into<String>) -> SetupError {
        let name = self.io.settings.infos().get(setting.index).map(|info| info.name.clone());
        SetupError::SettingValue {
            module: self.io.name.to_string(),
            setting: name.unwrap_or_default(),
            refusal: refusal.into(),
        }
    }

    /// Declares that the module publishes messages of type `T` on a topic; the key is for
    /// [`Context::publish`].
    ///
    /// # Errors
    /// A name that is not valid, or a topic that carries another type.
    pub fn publish<T: Send + Sync + 'static>(&mut self, topic: &str) -> Result<Publication<T>, SetupError> {
        let index = self.open_topic::<T>(topic)?;
        self.registries.topics.add_publisher(index);
        self.uses.published.push(index);
        Ok(self.io.outboxes.open(index))
    }

    /// Declares a setting; the key is for [`Context::get`].
    ///
    /// # Errors
    /// A name used twice, or a given value of another type.
    pub fn setting<T: SettingType>(
        &mut self,
        name: &str,
        default: T,
        description: &str,
    ) -> Result<Setting<T>, SetupError> {
        self.declare_setting(SettingInfo::new(name, default, description))
    }

    /// Declares a setting that must lie in a range.
    ///
    /// # Errors
    /// A name used twice, or a default or given value of another type or out of range.
    pub fn setting_in<T: SettingType>(
        &mut self,
        name: &str,
        default: T,
        range: RangeInclusive<f64>,
        description: &str,
    ) -> Result<Setting<T>, SetupError> {
        let range = Some(range);
        self.declare_setting(SettingInfo { range, ..SettingInfo::new(name, default, description) })
    }

    /// Declares a setting that is given before the start and does not change after it.
    ///
    /// # Errors
    /// A name used twice, or a given value of another type.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use downbeat_executor::{Core, ManualClock, Module, ModuleOptions, Setup, SetupError, Time};
    /// struct Servos;
    ///
    /// impl Module for Servos {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.read_only_setting("port", "/dev/ttyUSB0".to_owned(), "serial device")?;
    ///         Ok(())
    ///     }
    /// }
    ///
    /// let settings = [("port".to_owned(), "/dev/ttyACM0".to_owned().into())].into();
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add_with("servos", Servos, ModuleOptions { settings, ..ModuleOptions::default() })?;
    /// let refused = core.handle().set("servos", "port", "/dev/null".to_owned());
    /// core.cycle()?;
    /// assert!(refused.try_take().unwrap().is_err());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn read_only_setting<T: SettingType>(
        &mut self,
        name: &str,
        default: T,
        description: &str,
    ) -> Result<Setting<T>, SetupError> {
        self.declare_setting(SettingInfo {
            is_read_only: true,
            ..SettingInfo::new(name, default, description)
        })
    }

    /// Calls `callback` when the value of a setting has changed.
    pub fn on_change<T, F>(&mut self, setting: Setting<T>, callback: F)
    where
        F: FnMut(&mut M, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        self.callbacks.settings.push((setting.index, Box::new(callback)));
    }

    /// The value a setting has at the start: for what the module must know before it runs.
    #[must_use]
    pub fn value<T: SettingType>(&self, setting: Setting<T>) -> Option<&T> {
        self.io.settings.value(setting.index).and_then(T::from_value)
    }

    /// Asks for one of the core's mechanisms by name ("messaging", "services", "settings", "timers", "modules",
    /// "jobs"), at a version or a compatible later one.
    ///
    /// # Errors
    /// If the core does not offer it, or only at another version.
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
        let offered = self.registries.offers.version(mechanism);
        if offered.is_some_and(|offered| offered.offers(version)) {
            return Ok(());
        }
        Err(SetupError::Mechanism {
            module: self.io.name.to_string(),
            mechanism: mechanism.into(),
            asked: version,
            offered,
            known: self
                .registries
                .offers
                .names()
                .map(|(name, version)| format!("{name} {version}"))
                .collect(),
        })
    }

    /// The key to a mechanism that was added to the core, for [`Context::view`] and [`Context::ask`].
    ///
    /// # Errors
    /// If the core does not offer it, or only at another version; or if this module is detached, since it cannot
    /// look at a mechanism while others change it.
    pub fn mechanism<N: Mechanism>(&self, version: Version) -> Result<MechanismKey<N>, SetupError> {
        self.require(N::NAME, version)?;
        if self.is_detached {
            return Err(self.refuse(format!(
                "a detached module cannot use the mechanism \"{}\": it runs while others change it; add the \
                 module without Synchrony::Detached",
                N::NAME
            )));
        }
        match self.registries.offers.find::<N>() {
            Some(index) => Ok(MechanismKey::new(number(index))),
            None => Err(self.refuse(format!("the mechanism \"{}\" is of another Rust type", N::NAME))),
        }
    }

    fn declare_setting<T: SettingType>(&mut self, info: SettingInfo) -> Result<Setting<T>, SetupError> {
        let given = self.given_settings.remove(&info.name);
        Ok(Setting::new(self.io.settings.declare(&self.io.name, info, given)?))
    }

    fn open_topic<T: Send + Sync + 'static>(&mut self, name: &str) -> Result<usize, SetupError> {
        let name = self.resolve(name);
        self.registries.topics.open::<T>(&name, &self.io.name)
    }

    fn open_service<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        name: &str,
    ) -> Result<usize, SetupError> {
        let name = self.resolve(name);
        let index = self.registries.services.open::<Q, R>(&name, &self.io.name)?;
        self.uses.services.push(index);
        Ok(index)
    }

    fn open_server<Q: Send + 'static, R: Send + 'static>(&mut self, name: &str) -> Result<u32, SetupError> {
        let index = self.open_service::<Q, R>(name)?;
        let port = number(self.io.servers.len());
        self.registries.services.serve(index, &self.io.name, self.io.id, port)?;
        let name = self.registries.services.name(index).clone();
        self.io.servers.push(Box::new(ServerPort::<Q, R>::new(name)));
        Ok(port)
    }

    /// The name to use for one that the module gave.
    fn resolve(&mut self, name: &str) -> String {
        let name = name.strip_prefix('/').unwrap_or(name);
        self.own_names.push(name.to_owned());
        self.remaps.get(name).map_or(name, String::as_str).to_owned()
    }
}

impl<M: Module> Setup<'_, M> {
    /// Calls `callback` with each message of a topic, in the cycle after it was published.
    ///
    /// # Errors
    /// A name that is not valid, or a topic that carries another type.
    pub fn subscribe<T, F>(&mut self, topic: &str, callback: F) -> Result<(), SetupError>
    where
        T: Send + Sync + 'static,
        F: FnMut(&mut M, Received<'_, T>, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        let topic = self.open_topic::<T>(topic)?;
        self.registries.topics.add_user(topic);
        self.uses.subscribed.push(topic);
        self.callbacks.subscriptions.push(Box::new(Subscription { topic, callback, message: PhantomData }));
        Ok(())
    }

    /// Offers a service whose requests are answered at once, with a value or with an error in words. A service has
    /// one server.
    ///
    /// # Errors
    /// A name that is not valid, a service of other types, or one that is served already.
    pub fn serve<Q, R, F>(&mut self, service: &str, answer: F) -> Result<(), SetupError>
    where
        Q: Send + 'static,
        R: Send + 'static,
        F: FnMut(&mut M, &Q, &mut Context<'_, M::Ports>) -> Result<R, String> + Send + 'static,
    {
        let port = self.open_server::<Q, R>(service)?;
        self.callbacks.servers.push(answering(port, answer));
        Ok(())
    }

    /// Offers a service whose requests are answered when the answer is there, with [`Context::reply`].
    ///
    /// # Errors
    /// A name that is not valid, a service of other types, or one that is served already.
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Module, Responder, Setup, SetupError, Time};
    /// # use std::time::Duration;
    /// /// Answers when it has arrived, not when it is asked to go.
    /// #[derive(Default)]
    /// struct Arm {
    ///     asked: Vec<Responder<f64, ()>>,
    /// }
    ///
    /// impl Module for Arm {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.serve_later::<f64, (), _>("reach", |arm, _angle, responder, _| arm.asked.push(responder))?;
    ///         setup.subscribe::<(), _>("arrived", |arm, _, ctx| {
    ///             arm.asked.drain(..).for_each(|responder| ctx.reply(responder, Ok(())));
    ///         })
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("arm", Arm::default())?;
    /// let (sender, answer) = std::sync::mpsc::channel();
    /// core.caller::<f64, ()>("reach")?.call(0.5, Duration::from_secs(9), move |result| drop(sender.send(result)))?;
    /// (0..5).try_for_each(|_| core.cycle())?;
    /// assert!(answer.try_recv().is_err());
    /// core.inlet("arrived")?.publish(())?;
    /// (0..2).try_for_each(|_| core.cycle())?;
    /// assert_eq!(answer.try_recv()?, Ok(()));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn serve_later<Q, R, F>(&mut self, service: &str, take: F) -> Result<(), SetupError>
    where
        Q: Send + 'static,
        R: Send + 'static,
        F: FnMut(&mut M, Q, Responder<Q, R>, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        let port = self.open_server::<Q, R>(service)?;
        self.callbacks.servers.push(answering_later(port, take));
        Ok(())
    }

    /// Declares that the module calls a service; the key is for [`Context::call`]. Each call ends with one call of
    /// `on_reply`: with the answer, or after `timeout` with the error that there is none.
    ///
    /// # Errors
    /// A name that is not valid, or a service of other types.
    pub fn client<Q, R, F>(
        &mut self,
        service: &str,
        timeout: Duration,
        on_reply: F,
    ) -> Result<Client<Q, R>, SetupError>
    where
        Q: Send + 'static,
        R: Send + 'static,
        F: FnMut(&mut M, Reply<R>, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        let index = self.open_service::<Q, R>(service)?;
        let name = self.registries.services.name(index).clone();
        let port = number(self.io.clients.len());
        self.io.clients.push(Box::new(ClientPort::<Q, R>::new(index, name, timeout)));
        self.callbacks.clients.push(replying::<M, Q, R, F>(port, on_reply));
        Ok(Client::new(port))
    }

    /// Calls `callback` every `period`, first one period after the module became active. Due times that were missed
    /// are skipped.
    ///
    /// # Errors
    /// A period of zero.
    pub fn every<F>(&mut self, period: Duration, callback: F) -> Result<(), SetupError>
    where
        F: FnMut(&mut M, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        if period.is_zero() {
            return Err(SetupError::ZeroPeriod(self.io.name.to_string()));
        }
        self.io.timers.push(Timer::new(period));
        self.callbacks.timers.push(Box::new(callback));
        Ok(())
    }

    /// Declares something the module does at times it chooses while it runs; the key is for
    /// [`Context::schedule`].
    pub fn task<F>(&mut self, callback: F) -> Task
    where
        F: FnMut(&mut M, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        self.callbacks.tasks.push(Box::new(callback));
        self.io.tasks.declare()
    }

    /// Declares work beside the cycle and what is done with its results; the key is for [`Context::spawn`].
    pub fn job<T, F>(&mut self, on_result: F) -> Job<T>
    where
        T: Send + 'static,
        F: FnMut(&mut M, Result<T, JobError>, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        let job = Job::new(number(self.io.jobs.len()));
        self.io.jobs.push(Box::new(JobPort::<T>::new()));
        self.callbacks.jobs.push(finishing(job, on_result));
        job
    }

    /// Calls `callback` at the end of each run of the module, after its messages, requests, answers and timers: in
    /// every cycle, if its synchrony is [`Synchrony::EveryCycle`](crate::Synchrony::EveryCycle).
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
        self.callbacks.each_run.push(Box::new(callback));
    }

    /// Has `check` look at each value that a setting is to have while the module runs, before it has it. A value it
    /// refuses, with the reason in words, changes nothing. It runs in the sync phase, or on the module's thread if it
    /// is detached.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use downbeat_executor::{Core, ManualClock, Module, ModuleOptions, Setup, SetupError, Time};
    /// struct Camera;
    ///
    /// impl Module for Camera {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         let width = setup.setting("width", 640_i64, "of the image, pixels")?;
    ///         setup.accept_if(width, |_, width| match width % 16 {
    ///             0 => Ok(()),
    ///             _ => Err(format!("{width} is not a multiple of 16")),
    ///         });
    ///         Ok(())
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("camera", Camera)?;
    /// let refused = core.handle().set("camera", "width", 600_i64);
    /// core.cycle()?;
    /// assert!(refused.try_take().unwrap().unwrap_err().to_string().contains("600 is not a multiple of 16"));
    /// assert_eq!(core.settings("camera").unwrap()[0].value, 640_i64.into());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn accept_if<T, F>(&mut self, setting: Setting<T>, check: F)
    where
        T: SettingType,
        F: FnMut(&mut M, &T) -> Result<(), String> + Send + 'static,
    {
        self.callbacks.checks.push((setting.index, checking(check)));
    }
}

fn number(index: usize) -> u32 {
    u32::try_from(index).unwrap_or(u32::MAX)
}
