//! Mechanisms: the ways in which modules interact.
//!
//! In the process phase modules only *ask* something of a mechanism; in the sync phase it applies what they
//! asked for. Messaging, services, settings, timers and module management are mechanisms; see [`Mechanism`]
//! for adding one's own.

use std::any::{Any, TypeId};
use std::fmt;

use crate::asked::Asked;
use crate::{ModuleId, SyncPhase};

/// The version of a mechanism: what is built for `1.2` works with `1.3`, not with `1.1` nor `2.0`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Version {
    /// Changes when something is taken away.
    pub major: u16,
    /// Changes when something is added.
    pub minor: u16,
}

impl Version {
    /// Version `major.minor`.
    #[must_use]
    pub const fn new(major: u16, minor: u16) -> Self {
        Self { major, minor }
    }

    /// True if what asks for version `asked` can work with this one.
    #[must_use]
    pub const fn offers(self, asked: Self) -> bool {
        self.major == asked.major && self.minor >= asked.minor
    }
}

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.major, self.minor)
    }
}

/// A way for modules to interact, run by the core in each sync phase.
///
/// The core's own mechanisms are implementations of this trait, and so are a user's: added with
/// [`Core::with_mechanism`](crate::Core::with_mechanism), used by modules through
/// [`Setup::mechanism`](crate::Setup::mechanism). `examples/executor_alone/src/bin/blackboard.rs` is a whole one.
///
/// Modules see the mechanism's [`View`](Self::View) in the process phase, all the same one, and queue
/// [`Request`](Self::Request)s; nobody writes while somebody reads, so no lock is needed, and the result does
/// not depend on threads.
///
/// ```
/// use downbeat_executor::{Core, ManualClock, Mechanism, Module, ModuleId, Setup, SetupError, SyncPhase, Time, Version};
///
/// /// One word for all: modules propose, the last proposal of a cycle holds in the next.
/// #[derive(Default)]
/// struct Motto(Vec<(ModuleId, String)>);
///
/// impl Mechanism for Motto {
///     type View = String;
///     type Request = String;
///
///     const NAME: &'static str = "motto";
///     const VERSION: Version = Version::new(1, 0);
///
///     fn view(&self) -> String {
///         "stand".into()
///     }
///
///     fn sync(&mut self, phase: &mut SyncPhase<'_>) {
///         phase.take_requests::<Self>(&mut self.0);
///         if let Some((_, word)) = self.0.drain(..).last() {
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
/// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO)).with_mechanism(Motto::default());
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
    /// What modules can read in the process phase.
    type View: Send + Sync + 'static;
    /// What modules can ask for in the process phase.
    type Request: Send + 'static;

    /// The name by which it is known in messages and to [`Setup::require`](crate::Setup::require).
    const NAME: &'static str;
    /// The version that is offered.
    const VERSION: Version;

    /// What modules see in the first cycle.
    fn view(&self) -> Self::View;

    /// Applies what modules asked for in this cycle. Called once in each sync phase: the core's mechanisms
    /// first, then those that were added, in the order in which they were added.
    fn sync(&mut self, phase: &mut SyncPhase<'_>);

    /// Forgets what belongs to a module that is gone.
    fn module_left(&mut self, _module: ModuleId, _phase: &mut SyncPhase<'_>) {}
}

/// A [`Mechanism`] whose types only its users know.
pub(crate) trait AnyMechanism: Send {
    fn name(&self) -> &'static str;
    fn version(&self) -> Version;
    fn sync(&mut self, phase: &mut SyncPhase<'_>);
    fn module_left(&mut self, module: ModuleId, phase: &mut SyncPhase<'_>);
}

impl<M: Mechanism> AnyMechanism for M {
    fn name(&self) -> &'static str {
        M::NAME
    }

    fn version(&self) -> Version {
        M::VERSION
    }

    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        Mechanism::sync(self, phase);
    }

    fn module_left(&mut self, module: ModuleId, phase: &mut SyncPhase<'_>) {
        Mechanism::module_left(self, module, phase);
    }
}

/// A mechanism, and in which cycles it has something to do.
pub(crate) struct Engaged {
    pub(crate) mechanism: Box<dyn AnyMechanism>,
    /// In those in which one of these was asked for.
    interest: Asked,
}

impl Engaged {
    pub(crate) fn new(mechanism: Box<dyn AnyMechanism>, interest: Asked) -> Self {
        Self { mechanism, interest }
    }

    #[inline]
    pub(crate) fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        if phase.has(self.interest) {
            self.mechanism.sync(phase);
        }
    }
}

/// What mechanisms a core offers, and what modules see of them.
#[derive(Default)]
pub(crate) struct Offers {
    offers: Vec<Offer>,
}

struct Offer {
    name: &'static str,
    version: Version,
    mechanism: TypeId,
    view: Box<dyn Any + Send + Sync>,
}

impl Offers {
    pub(crate) fn add<M: Mechanism>(&mut self, mechanism: &M) {
        let view = Box::new(mechanism.view());
        self.offers.push(Offer { name: M::NAME, version: M::VERSION, mechanism: TypeId::of::<M>(), view });
    }

    pub(crate) fn names(&self) -> impl Iterator<Item = (&'static str, Version)> {
        self.offers.iter().map(|offer| (offer.name, offer.version))
    }

    pub(crate) fn version(&self, name: &str) -> Option<Version> {
        self.offers.iter().find(|offer| offer.name == name).map(|offer| offer.version)
    }

    pub(crate) fn find<M: Mechanism>(&self) -> Option<usize> {
        self.offers.iter().position(|offer| offer.mechanism == TypeId::of::<M>())
    }

    pub(crate) fn view<M: Mechanism>(&self, index: usize) -> Option<&M::View> {
        self.offers.get(index).and_then(|offer| offer.view.downcast_ref())
    }

    pub(crate) fn view_mut<M: Mechanism>(&mut self) -> Option<&mut M::View> {
        let index = self.find::<M>()?;
        self.offers[index].view.downcast_mut()
    }
}

/// A module's key to a mechanism, from [`Setup::mechanism`](crate::Setup::mechanism).
pub struct MechanismKey<M> {
    pub(crate) index: u32,
    kind: std::marker::PhantomData<fn(M)>,
}

impl<M> MechanismKey<M> {
    pub(crate) fn new(index: u32) -> Self {
        Self { index, kind: std::marker::PhantomData }
    }
}

impl<M> Clone for MechanismKey<M> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<M> Copy for MechanismKey<M> {}
