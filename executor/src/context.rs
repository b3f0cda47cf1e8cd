//! What a callback can do.

use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use crate::asked::Asked;
use crate::job::Work;
use crate::management::Command;
use crate::mechanism::MechanismKey;
use crate::module_io::{ModuleIo, Shared};
use crate::setting::SettingType;
use crate::{
    CallId, Client, Completion, Job, Mechanism, Module, ModuleOptions, Publication, Responder, Setting,
    SettingValue, Task, Time, Transition,
};

/// A callback's access to the executor. Everything it asks for takes effect in the sync phase.
///
/// Keys belong to the module whose setup made them. A method that is given a key of another module panics, which
/// stops the module; where both modules have a key of that number and type they are not told apart.
///
/// A function that is called by modules of several types takes a `&mut Context<'_, P>` for any `P`.
pub struct Context<'a, P = ()> {
    /// What the module's [`setup`](Module::setup) returned: as a rule its keys.
    pub ports: &'a P,
    io: &'a mut ModuleIo,
    now: Time,
    shared: Option<&'a Shared>,
}

impl<'a> Context<'a> {
    pub(crate) fn new(io: &'a mut ModuleIo, now: Time, shared: Option<&'a Shared>) -> Self {
        Self { ports: &(), io, now, shared }
    }

    /// The context of a module of a known type.
    #[inline]
    pub(crate) fn with_ports<'b, P>(&'b mut self, ports: &'b P) -> Context<'b, P> {
        Context { ports, io: self.io, now: self.now, shared: self.shared }
    }
}

impl<P> Context<'_, P> {
    #[inline]
    pub(crate) fn io(&mut self) -> &mut ModuleIo {
        self.io
    }

    /// The time of this cycle: the same for every callback in it.
    #[must_use]
    pub fn now(&self) -> Time {
        self.now
    }

    /// The name under which the module was added.
    #[must_use]
    pub fn module_name(&self) -> &str {
        &self.io.name
    }

    /// Publishes a message: subscribers receive it in the next cycle.
    #[inline]
    pub fn publish<T: Send + Sync + 'static>(&mut self, publication: Publication<T>, message: T) {
        if !self.io.outboxes.add(publication, |outbox| outbox.push(message)) {
            self.foreign("published with")
        }
        self.io.asked.add(Asked::MESSAGES);
    }

    /// Publishes messages, as many calls of [`publish`](Self::publish) would, but cheaper.
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};
    /// # struct Lidar;
    /// # impl Module for Lidar {
    /// #     type Ports = ();
    /// #     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    /// let ranges = setup.publish::<f32>("ranges")?;
    /// setup.subscribe::<Vec<u16>, _>("millimetres", move |_, scan, ctx| {
    ///     ctx.publish_all(ranges, scan.iter().map(|&range| f32::from(range) / 1000.0));
    /// })
    /// #     }
    /// # }
    /// # let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// # core.add("lidar", Lidar)?;
    /// # core.inlet("millimetres")?.publish(vec![100_u16, 200, 300])?;
    /// # (0..2).try_for_each(|_| core.cycle())?;
    /// # assert_eq!(core.topics().find(|topic| &*topic.name == "ranges").unwrap().counter.messages(), 3);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[inline]
    pub fn publish_all<T: Send + Sync + 'static>(
        &mut self,
        publication: Publication<T>,
        messages: impl IntoIterator<Item = T>,
    ) {
        if !self.io.outboxes.add(publication, |outbox| outbox.extend(messages)) {
            self.foreign("published with")
        }
        self.io.asked.add(Asked::MESSAGES);
    }

    /// The value of a setting in this cycle.
    #[must_use]
    pub fn get<T: SettingType>(&self, setting: Setting<T>) -> &T {
        match self.io.settings.value(setting.index).and_then(T::from_value) {
            Some(value) => value,
            None => self.foreign("read a setting with"),
        }
    }

    /// Changes a setting, of this module or another. What the setting refuses changes nothing and is logged.
    pub fn set(&mut self, module: &str, setting: &str, value: impl Into<SettingValue>) {
        let (module, setting, value) = (module.to_owned(), setting.to_owned(), value.into());
        self.command(Command::Set { module, setting, value, receipt: None });
    }

    /// Gives `to` the values that the settings of `from` have at the sync phase, for all settings that both have
    /// and `to` does not refuse: one module takes over where another was.
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Module, ModuleOptions, Setup, SetupError, Time};
    /// struct Gait;
    ///
    /// impl Module for Gait {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         let step = setup.setting("step_length", 0.03, "m")?;
    ///         // The name by which the next gait is asked for.
    ///         setup.subscribe::<String, _>("next_gait", move |_, name, ctx| {
    ///             let old = ctx.module_name().to_owned();
    ///             assert!(*ctx.get(step) > 0.0);
    ///             ctx.add(&name, Gait, ModuleOptions::default());
    ///             ctx.transfer_settings(&old, &name); // Additions come before settings.
    ///         })
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// let settings = [("step_length".to_owned(), 0.05.into())].into();
    /// core.add_with("walk", Gait, ModuleOptions { settings, ..ModuleOptions::default() })?;
    /// core.inlet("next_gait")?.publish("trot".to_owned())?;
    /// core.cycle()?;
    /// core.cycle()?;
    /// assert_eq!(core.settings("trot").unwrap()[0].value, 0.05.into());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn transfer_settings(&mut self, from: &str, to: &str) {
        self.command(Command::Transfer { from: from.to_owned(), to: to.to_owned(), receipt: None });
    }

    /// Calls a service. The answer, or the reason why there is none, comes to the callback that was given to
    /// [`Setup::client`](crate::Setup::client).
    pub fn call<Q: Send + 'static, R: Send + 'static>(&mut self, client: Client<Q, R>, request: Q) -> CallId {
        let now = self.now;
        self.io.asked.add(Asked::CALLS);
        match self.io.client::<Q, R>(client.port) {
            Some(port) => port.call(request, now),
            None => self.foreign("called a service with"),
        }
    }

    /// Answers a request that was taken by [`Setup::serve_later`](crate::Setup::serve_later): with a value, or with
    /// an error in words.
    ///
    /// `Q` is the type of the service's requests.
    pub fn reply<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        responder: Responder<Q, R>,
        result: Result<R, String>,
    ) {
        self.io.asked.add(Asked::ANSWERS);
        match self.io.server::<Q, R>(responder.port) {
            Some(port) => port.answer(responder.to, result),
            None => self.foreign("answered with"),
        }
    }

    /// Runs a task in the first cycle at or after `time`, but not in this one. A task may be scheduled more than
    /// once.
    pub fn schedule(&mut self, task: Task, time: Time) {
        self.io.asked.add(Asked::STATE);
        if !self.io.tasks.schedule(task, time) {
            self.foreign("scheduled a task with")
        }
    }

    /// Runs a task after `delay`, see [`schedule`](Self::schedule).
    pub fn schedule_after(&mut self, task: Task, delay: Duration) {
        self.schedule(task, self.now + delay);
    }

    /// Takes a task off the schedule, however often it is on it.
    pub fn cancel(&mut self, task: Task) {
        self.io.asked.add(Asked::STATE);
        self.io.tasks.cancel(task);
    }

    /// Runs `work` on another thread, where it may block. Its result comes to the callback of the job.
    ///
    /// Under a clock that does not go on by itself it runs inside the next sync phase instead.
    pub fn spawn<T: Send + 'static>(&mut self, job: Job<T>, work: impl FnOnce() -> T + Send + 'static) {
        let completion = self.completion(job);
        self.work(Work::Blocking(Box::new(move || completion.finish(work()))));
    }

    /// Runs `work` beside the cycle, on one thread for the async work of all modules. Its result comes to the
    /// callback of the job.
    ///
    /// Under a clock that does not go on by itself it runs to its end inside the next sync phase instead. Futures
    /// that need a runtime of their own, such as tokio's, are spawned there and given a
    /// [`completion`](Self::completion).
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};
    /// struct Weather;
    ///
    /// impl Module for Weather {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         let wind = setup.publish::<f64>("wind")?;
    ///         let asking = setup.job::<f64, _>(move |_, answer, ctx| {
    ///             if let Ok(metres_per_second) = answer {
    ///                 ctx.publish(wind, metres_per_second);
    ///             }
    ///         });
    ///         setup.subscribe::<(), _>("ask", move |_, _, ctx| {
    ///             ctx.spawn_async(asking, async { 4.2 }); // A real one would await a socket.
    ///         })
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("weather", Weather)?;
    /// core.inlet("ask")?.publish(())?;
    /// (0..3).try_for_each(|_| core.cycle())?;
    /// assert_eq!(core.topics().find(|topic| &*topic.name == "wind").unwrap().counter.messages(), 1);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn spawn_async<T: Send + 'static>(
        &mut self,
        job: Job<T>,
        work: impl Future<Output = T> + Send + 'static,
    ) {
        let completion = self.completion(job);
        self.work(Work::Async(Box::pin(async move { completion.finish(work.await) })));
    }

    /// A handle that brings one result to the callback of the job, from any thread or runtime.
    ///
    /// ```
    /// # use downbeat_executor::{Completion, Core, ManualClock, Module, Setup, SetupError, Time};
    /// # use std::sync::mpsc::{Sender, channel};
    /// /// Hands positions to a library that answers on a thread of its own.
    /// struct Localisation(Sender<Completion<f64>>);
    ///
    /// impl Module for Localisation {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         let found = setup.publish::<f64>("heading")?;
    ///         let answer = setup.job::<f64, _>(move |_, heading, ctx| {
    ///             if let Ok(radians) = heading {
    ///                 ctx.publish(found, radians);
    ///             }
    ///         });
    ///         setup.subscribe::<(), _>("look", move |module, _, ctx| {
    ///             let completion = ctx.completion(answer);
    ///             drop(module.0.send(completion));
    ///         })
    ///     }
    /// }
    ///
    /// let (sender, library) = channel();
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("localisation", Localisation(sender))?;
    /// core.inlet("look")?.publish(())?;
    /// core.cycle()?;
    /// core.cycle()?;
    /// let work = std::thread::spawn(move || library.recv().map(|completion| completion.finish(1.57)));
    /// work.join().unwrap()?;
    /// core.cycle()?; // The result joins.
    /// core.cycle()?; // The module has it.
    /// assert_eq!(core.topics().find(|topic| &*topic.name == "heading").unwrap().counter.messages(), 1);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn completion<T: Send + 'static>(&mut self, job: Job<T>) -> Completion<T> {
        let Some(port) = self.io.jobs.get_mut(job.port as usize) else { self.foreign("asked for work with") };
        let number = port.next_number();
        Completion::new(Arc::clone(&self.io.queue), self.io.id, job, number)
    }

    /// Adds a module, which runs for the first time in the next cycle. What is wrong with it is logged.
    pub fn add<M: Module>(&mut self, name: &str, module: M, options: ModuleOptions) {
        self.command(Command::add(name, module, options));
    }

    /// Removes a module, this one or another: its last callback runs in this cycle's sync phase, and everything it
    /// held is freed.
    pub fn remove(&mut self, module: &str) {
        self.command(Command::Remove { module: module.to_owned(), receipt: None });
    }

    /// Removes this module, see [`remove`](Self::remove).
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};
    /// /// Done as soon as it has run.
    /// struct Calibration;
    ///
    /// impl Module for Calibration {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.each_run(|_, ctx| ctx.remove_self());
    ///         Ok(())
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("calibration", Calibration)?;
    /// core.cycle()?;
    /// assert!(core.modules().is_empty());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn remove_self(&mut self) {
        let name = self.io.name.to_string();
        self.remove(&name);
    }

    /// Has a module make a transition in the next cycle; one that does not begin in its state is logged.
    pub fn transition(&mut self, module: &str, transition: Transition) {
        self.command(Command::Transition { module: module.to_owned(), transition, receipt: None });
    }

    /// Holds a module: no callback of it runs until it is resumed. Messages pass it by, requests wait.
    pub fn pause(&mut self, module: &str) {
        self.command(Command::Pause { module: module.to_owned(), receipt: None });
    }

    /// Lets a module go on that was paused.
    pub fn resume(&mut self, module: &str) {
        self.command(Command::Resume { module: module.to_owned(), receipt: None });
    }

    /// What a mechanism shows in this cycle.
    ///
    /// # Panics
    /// In a detached module, which runs outside of cycles; [`Setup::mechanism`](crate::Setup::mechanism) gives it
    /// no key.
    #[must_use]
    pub fn view<M: Mechanism>(&self, mechanism: MechanismKey<M>) -> &M::View {
        match self.shared.and_then(|shared| shared.offers.view::<M>(mechanism.index as usize)) {
            Some(view) => view,
            None => self.foreign("looked at a mechanism with"),
        }
    }

    /// Asks something of a mechanism.
    pub fn ask<M: Mechanism>(&mut self, mechanism: MechanismKey<M>, request: M::Request) {
        let index = mechanism.index as usize;
        if self.io.asks.len() <= index {
            self.io.asks.resize_with(index + 1, || None);
        }
        let asks = self.io.asks[index].get_or_insert_with(|| Box::new(Vec::<M::Request>::new()));
        match asks.downcast_mut::<Vec<M::Request>>() {
            Some(asks) => asks.push(request),
            None => self.foreign("asked a mechanism with"),
        }
        self.io.asked.add(Asked::MECHANISMS);
    }

    fn command(&mut self, command: Command) {
        self.io.commands.push(command);
        self.io.asked.add(Asked::COMMANDS);
    }

    fn work(&mut self, work: Work) {
        self.io.work.push(work);
        self.io.asked.add(Asked::WORK);
    }

    #[cold]
    fn foreign(&self, did: &str) -> ! {
        panic!("module \"{}\" {did} a key of another module", self.io.name)
    }
}
