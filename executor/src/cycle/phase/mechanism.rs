//! Mechanisms: the ways in which modules interact.
//!
//! In the process phase, modules only *queue* requests to a mechanism; in the sync phase, the mechanism
//! applies them. Messaging, services, settings, timers, jobs and the management of modules are mechanisms;
//! see [`Mechanism`] for user-defined ones.

use std::any::{Any, TypeId};
use std::marker::PhantomData;

use crate::module::{Asked, Host, Input, Offer, Views};
use crate::{Context, Module, ModuleId, Port, Setup, SetupError, SyncPhase, Time, Version};

/// A way for modules to interact, run by the core in the sync phase.
///
/// The core's own mechanisms implement this trait. A user-defined one is added with
/// [`Core::with_mechanism`](crate::Core::with_mechanism) and used by modules through
/// [`Setup::mechanism`](crate::Setup::mechanism). `examples/executor_alone/src/bin/blackboard.rs` is a
/// complete example.
///
/// In the process phase, all modules read the same [`View`](Self::View), and each writes to its
/// [`Port`](Self::Port). In the sync phase, only the mechanism accesses them. So no lock is needed, and the
/// result does not depend on threads.
///
/// ```
/// use downbeat_executor::{Core, ManualClock, Mechanism, Module, Setup, SetupError, SyncPhase, Time, Version};
///
/// /// One word for all: modules propose, the last proposal of a cycle holds in the next.
/// struct Motto;
///
/// impl Mechanism for Motto {
///     type View = String;
///     type Port = Vec<String>;
///
///     const NAME: &'static str = "motto";
///     const VERSION: Version = Version::new(1, 0);
///
///     fn view(&self) -> String {
///         "stand".into()
///     }
///
///     fn sync(&mut self, phase: &mut SyncPhase<'_>) {
///         let mut last = None;
///         phase.each_port::<Self>(|_, words| last = words.drain(..).last().or(last.take()));
///         if let Some(word) = last {
///             *phase.view::<Self>() = word;
///         }
///     }
/// }
///
/// struct Crier;
///
/// impl Module for Crier {
///     type Ports = ();
///
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
///         let motto = setup.mechanism::<Motto>(Version::new(1, 0))?;
///         let heard = setup.publish::<String>("heard")?;
///         setup.subscribe::<String, _>("propose", move |_, word, ctx| {
///             ctx.publish(heard, ctx.view(motto).clone()); // What holds in this cycle.
///             ctx.ask(motto, word.clone());
///         })
///     }
/// }
///
/// struct Ear(std::sync::mpsc::Sender<String>);
///
/// impl Module for Ear {
///     type Ports = ();
///
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
///         setup.subscribe::<String, _>("heard", |ear, word, _| drop(ear.0.send(word.clone())))
///     }
/// }
///
/// let (sender, heard) = std::sync::mpsc::channel();
/// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO)).with_mechanism(Motto);
/// core.add("crier", Crier)?;
/// core.add("ear", Ear(sender))?;
/// let propose = core.inlet("propose")?;
/// for word in ["walk", "kick"] {
///     propose.publish(word.to_owned())?;
///     core.cycle()?;
/// }
/// (0..2).try_for_each(|_| core.cycle())?;
/// assert_eq!(heard.try_iter().collect::<Vec<_>>(), ["stand", "walk"]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait Mechanism: Send + 'static {
    /// The data that modules can read in the process phase.
    type View: Send + Sync + 'static;
    /// The requests of one module: `Vec<Request>` in the simplest case.
    type Port: Port + Default;

    /// The name used in messages and by [`Setup::require`].
    const NAME: &'static str;
    /// The offered version.
    const VERSION: Version;

    /// The view of the first cycle.
    fn view(&self) -> Self::View;

    /// Applies the requests of modules of this cycle. Called once in each sync phase: the core's mechanisms
    /// first, then added ones in the order in which they were added.
    fn sync(&mut self, phase: &mut SyncPhase<'_>);

    /// Removes the data of a removed module.
    fn module_left(&mut self, _module: ModuleId, _phase: &mut SyncPhase<'_>) {}

    /// Takes the part that [`Port::split_off`] separated from the port of a module on another thread.
    fn join(&mut self, _step: Step, _part: Box<dyn Any + Send>) {}

    /// Called before the process phase if [`SyncPhase::call_before_next`] asked for it.
    fn process_begins(&mut self) {}

    /// Called in place of [`sync`](Self::sync) while the whole core is paused.
    fn paused(&mut self, _phase: &mut SyncPhase<'_>) {}

    /// Called when the core starts, before its first cycle.
    fn started(&mut self, _phase: &mut SyncPhase<'_>) {}

    /// Called when the core and all its modules have stopped.
    fn stopped(&mut self) {}
}

/// A run of a detached module.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// The module.
    pub module: ModuleId,
    /// The number of the run, from 0.
    pub number: u64,
    /// The time of the run.
    pub time: Time,
}

/// A [`Mechanism`] with its types erased.
pub(crate) trait AnyMechanism: Any + Send {
    fn sync(&mut self, phase: &mut SyncPhase<'_>);
    fn module_left(&mut self, module: ModuleId, phase: &mut SyncPhase<'_>);
    fn join(&mut self, step: Step, part: Box<dyn Any + Send>);
    fn process_begins(&mut self);
    fn paused(&mut self, phase: &mut SyncPhase<'_>);
    fn started(&mut self, phase: &mut SyncPhase<'_>);
    fn stopped(&mut self);
}

impl<M: Mechanism> AnyMechanism for M {
    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        Mechanism::sync(self, phase);
    }

    fn module_left(&mut self, module: ModuleId, phase: &mut SyncPhase<'_>) {
        Mechanism::module_left(self, module, phase);
    }

    fn join(&mut self, step: Step, part: Box<dyn Any + Send>) {
        Mechanism::join(self, step, part);
    }

    fn process_begins(&mut self) {
        Mechanism::process_begins(self);
    }

    fn paused(&mut self, phase: &mut SyncPhase<'_>) {
        Mechanism::paused(self, phase);
    }

    fn started(&mut self, phase: &mut SyncPhase<'_>) {
        Mechanism::started(self, phase);
    }

    fn stopped(&mut self) {
        Mechanism::stopped(self);
    }
}

/// The mechanisms of a core, and the set of those that run in the next sync phase.
#[derive(Default)]
pub(crate) struct Mechanisms {
    /// `None` while the mechanism runs.
    list: Vec<Option<Box<dyn AnyMechanism>>>,
    offers: Vec<Offer>,
    /// Mechanisms that run in each sync phase.
    always: Asked,
    /// Mechanisms that have something to do without requests of modules; they require a cycle.
    pub(crate) posted: Asked,
    /// Mechanisms that run in the next sync phase, but do not require a cycle.
    pub(crate) next: Asked,
    /// Mechanisms that are called before the next process phase; they require a cycle.
    pub(crate) begin: Asked,
    /// The due time of each mechanism.
    due: Vec<Time>,
    earliest_due: Time,
}

impl Mechanisms {
    /// Adds a mechanism that runs in each sync phase.
    pub(crate) fn add<M: Mechanism>(&mut self, mechanism: M, views: &mut Views) {
        if self.list.len() <= Asked::SHARED {
            self.always.add(Asked::of(self.list.len()));
        }
        self.add_idle(mechanism, views);
    }

    /// Adds a mechanism of the core, which runs only if it has requests.
    ///
    /// # Panics
    /// If its number is not the next one.
    pub(crate) fn add_built_in<M: Mechanism>(&mut self, number: usize, mechanism: M, views: &mut Views) {
        assert_eq!(number, self.list.len(), "the place of the mechanism \"{}\"", M::NAME);
        self.add_idle(mechanism, views);
    }

    fn add_idle<M: Mechanism>(&mut self, mechanism: M, views: &mut Views) {
        views.add(mechanism.view());
        self.offers.push(Offer { name: M::NAME, version: M::VERSION, mechanism: TypeId::of::<M>() });
        self.list.push(Some(Box::new(mechanism)));
        self.due.push(Time::MAX);
        self.earliest_due = if self.due.len() == 1 { Time::MAX } else { self.earliest_due };
    }

    pub(crate) fn offers(&self) -> &[Offer] {
        &self.offers
    }

    pub(crate) fn len(&self) -> usize {
        self.list.len()
    }

    /// The mechanism with this number and type, unless it is running.
    pub(crate) fn get<M: Mechanism>(&self, number: usize) -> Option<&M> {
        let mechanism: &dyn Any = &**self.list.get(number)?.as_ref()?;
        mechanism.downcast_ref()
    }

    /// The mechanism with this number and type, unless it is running.
    pub(crate) fn get_mut<M: Mechanism>(&mut self, number: usize) -> Option<&mut M> {
        self.any(number)?.downcast_mut()
    }

    pub(crate) fn any(&mut self, number: usize) -> Option<&mut dyn Any> {
        Some(&mut **self.list.get_mut(number)?.as_mut()?)
    }

    pub(crate) fn each(&mut self) -> impl Iterator<Item = &mut Box<dyn AnyMechanism>> {
        self.list.iter_mut().flatten()
    }

    /// Takes a mechanism out to run it; [`put_back`](Self::put_back) returns it.
    #[inline]
    pub(crate) fn take(&mut self, number: usize) -> Option<Box<dyn AnyMechanism>> {
        self.list.get_mut(number)?.take()
    }

    #[inline]
    pub(crate) fn put_back(&mut self, number: usize, mechanism: Box<dyn AnyMechanism>) {
        self.list[number] = Some(mechanism);
    }

    pub(crate) fn join(&mut self, number: usize, step: Step, part: Box<dyn Any + Send>) {
        if let Some(mechanism) = self.list.get_mut(number).and_then(Option::as_mut) {
            mechanism.join(step, part);
        }
    }

    /// The mechanisms that run in the sync phase at `now` without requests of modules.
    #[inline]
    pub(crate) fn begin_phase(&mut self, now: Time) -> Asked {
        let mut asked = self.always.or(std::mem::take(&mut self.posted)).or(std::mem::take(&mut self.next));
        if self.earliest_due <= now {
            asked.add(self.take_due(now));
        }
        asked
    }

    #[cold]
    fn take_due(&mut self, now: Time) -> Asked {
        let mut asked = Asked::default();
        for (number, due) in self.due.iter_mut().enumerate().filter(|(_, due)| **due <= now) {
            asked.add(Asked::of(number));
            *due = Time::MAX;
        }
        self.earliest_due = self.due.iter().copied().min().unwrap_or(Time::MAX);
        asked
    }

    pub(crate) fn set_due(&mut self, number: usize, due: Time) {
        if self.due[number] != due {
            self.due[number] = due;
            self.earliest_due = self.due.iter().copied().min().unwrap_or(Time::MAX);
        }
    }

    pub(crate) fn earliest_due(&self) -> Time {
        self.earliest_due
    }

    /// True if a mechanism requires a cycle.
    pub(crate) fn has_work(&self) -> bool {
        !self.posted.is_empty() || !self.begin.is_empty()
    }

    pub(crate) fn number_of<M: Mechanism>(&self) -> Option<usize> {
        self.offers.iter().position(|offer| offer.mechanism == TypeId::of::<M>())
    }
}

/// The core as seen by a module's setup.
pub(crate) struct CoreHost<'a> {
    pub(crate) views: &'a mut Views,
    pub(crate) mechanisms: &'a mut Mechanisms,
}

impl Host for CoreHost<'_> {
    fn mechanism(&mut self, number: usize) -> Option<&mut dyn Any> {
        self.mechanisms.any(number)
    }

    fn view(&mut self, number: usize) -> Option<&mut dyn Any> {
        self.views.any(number)
    }

    fn look(&self, number: usize) -> Option<&dyn Any> {
        self.views.look(number)
    }

    fn offers(&self) -> &[Offer] {
        self.mechanisms.offers()
    }
}

/// A module's key to a mechanism, from [`Setup::mechanism`].
pub struct MechanismKey<M> {
    pub(crate) number: u32,
    kind: PhantomData<fn(M)>,
}

impl<M> MechanismKey<M> {
    fn new(number: usize) -> Self {
        Self { number: u32::try_from(number).unwrap_or(u32::MAX), kind: PhantomData }
    }
}

impl<M> Clone for MechanismKey<M> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<M> Copy for MechanismKey<M> {}

impl<M: Module> Setup<'_, M> {
    /// The key to a mechanism that was added to the core, for [`Context::view`] and [`Context::ask`].
    ///
    /// # Errors
    /// If the core does not offer it, or only another version; or if this module is detached, since a
    /// detached module would read a mechanism while it changes.
    pub fn mechanism<N: Mechanism>(&self, version: Version) -> Result<MechanismKey<N>, SetupError> {
        self.require(N::NAME, version)?;
        if self.is_detached() {
            return Err(self.refuse(format!(
                "a detached module cannot use the mechanism \"{}\": it runs while others change it; add the \
                 module without Synchrony::Detached",
                N::NAME
            )));
        }
        match self.host.offers().iter().position(|offer| offer.mechanism == TypeId::of::<N>()) {
            Some(number) => Ok(MechanismKey::new(number)),
            None => Err(self.refuse(format!("the mechanism \"{}\" is of another Rust type", N::NAME))),
        }
    }
}

impl<P> Context<'_, P> {
    /// The view of a mechanism in this cycle.
    ///
    /// # Panics
    /// In a detached module, which runs outside of cycles and receives no key from
    /// [`Setup::mechanism`](crate::Setup::mechanism).
    #[must_use]
    pub fn view<M: Mechanism>(&self, mechanism: MechanismKey<M>) -> &M::View {
        let view = match self.input() {
            Input::Views(views) => views.get(mechanism.number as usize),
            Input::Batches(_) => None,
        };
        match view {
            Some(view) => view,
            None => self.foreign("looked at a mechanism with"),
        }
    }

    /// The module's port of a mechanism, which the mechanism reads in the sync phase.
    pub fn port<M: Mechanism>(&mut self, mechanism: MechanismKey<M>) -> &mut M::Port {
        let number = mechanism.number as usize;
        self.io().ask(number);
        if self.io().open::<M::Port>(number).is_none() {
            self.foreign("asked a mechanism with");
        }
        match self.io().port(number) {
            Some(port) => port,
            None => unreachable!("the port was opened above"),
        }
    }

    /// Sends a request to a mechanism whose ports are vectors of requests.
    pub fn ask<M, R>(&mut self, mechanism: MechanismKey<M>, request: R)
    where
        M: Mechanism<Port = Vec<R>>,
        R: Send + 'static,
    {
        self.port(mechanism).push(request);
    }
}
