//! A kind of module that robot files can name.

use std::fmt;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::Arc;

use bytes::Bytes;
use downbeat_device::{Device, DeviceLink};
use downbeat_edge::Interfaces;
use downbeat_edge::foreign::{Foreign, ForeignModule};
use downbeat_executor::{Core, Inbox, Module, ModuleOptions, SettingValue, SetupError, Synchrony};
use downbeat_msgs::{Message, cdr};

use super::source::{LoadForeign, ModuleSource};

/// A kind of module that robot files can name: how its modules are created, how they run by default, and
/// whether they drive a device.
///
/// ```
/// use downbeat_executor::{Module, Setup, SetupError};
/// use downbeat_kind::Kind;
///
/// #[derive(Default)]
/// struct Detector;
///
/// impl Module for Detector {
///     type Ports = ();
///
///     fn setup(&mut self, _: &mut Setup<'_, Self>) -> Result<(), SetupError> {
///         Ok(())
///     }
/// }
///
/// let kind = Kind::new("detector", "finds the ball in camera images", Detector::default).detached();
/// assert_eq!(kind.name(), "detector");
/// ```
#[derive(Clone)]
pub struct Kind {
    name: Arc<str>,
    about: Arc<str>,
    is_emulated: bool,
    uses_device: bool,
    claims_joints: bool,
    synchrony: Synchrony,
    files: Arc<[String]>,
    source: Option<ForeignKind>,
    /// Whether modules in other languages are reloaded unless the robot file says otherwise.
    reloads_by_default: bool,
    replayed: Option<ReplayedDevice>,
    panel: Option<Panel>,
    add: Arc<Add>,
}

/// The panel that modules of a kind bring to the page.
#[derive(Clone)]
pub struct Panel {
    /// Its heading.
    pub title: &'static str,
    /// The JavaScript module.
    pub script: &'static str,
    /// The topics that it shows, before remapping.
    pub topics: &'static [&'static str],
}

/// How a kind of modules in other languages reads a robot file.
#[derive(Clone)]
struct ForeignKind {
    /// Those that a robot file must give, and those that it may give.
    keys: [&'static [&'static str]; 2],
    files: Arc<SourceFiles>,
    load: Arc<LoadForeign>,
}

type SourceFiles = dyn Fn(&ModuleSource) -> Vec<PathBuf> + Send + Sync;

/// How a module that drives a device runs without it.
#[derive(Clone)]
pub struct ReplayedDevice {
    /// The topic on which the module publishes the answers of the device, before remapping.
    topic: Arc<str>,
    add: Arc<AddReplayed>,
}

type Add = dyn Fn(&mut Core, &str, ModuleOptions, &ModuleSource, &Interfaces) -> Result<(), SetupError>
    + Send
    + Sync;
/// The outer error reports invalid recorded answers.
type AddReplayed = dyn Fn(&mut Core, &str, ModuleOptions, &[Bytes], &Interfaces) -> Result<Result<(), SetupError>, String>
    + Send
    + Sync;

impl Kind {
    /// The default number of batches that wait for a detached module: two seconds of commands at 125 Hz.
    pub const INBOX: Inbox = Inbox::KeepLast(NonZeroUsize::new(250).expect("not zero"));

    /// Creates a kind whose modules `make` creates: at the start, and again if the restart policy restarts
    /// them after a panic.
    ///
    /// `about` describes the module in one line. By default, modules of the kind run inside the cycle, in the
    /// cycles in which they have work.
    pub fn new<M: Module>(
        name: impl Into<Arc<str>>,
        about: impl Into<Arc<str>>,
        make: impl Fn() -> M + Send + Sync + 'static,
    ) -> Self {
        let make = Arc::new(make);
        let add = move |core: &mut Core, name: &str, options, _: &ModuleSource, _: &Interfaces| {
            let make = Arc::clone(&make);
            core.add_restartable(name, move || make(), options)
        };
        Self::with_add(name, about, Arc::new(add))
    }

    /// Creates a kind of modules in another language. Beside the keys of every module, a robot file must give
    /// a module of it the first of these `keys` and may give it the second; `load` loads the module they
    /// name, at the start and after each panic. `files` lists the files that its behaviour depends on: bags
    /// hold their hashes, and a replay reports those that have changed.
    ///
    /// Modules of the kind run detached by default.
    pub fn foreign(
        name: impl Into<Arc<str>>,
        about: impl Into<Arc<str>>,
        keys: [&'static [&'static str]; 2],
        load: impl Fn(&ModuleSource) -> Result<Box<dyn Foreign>, String> + Send + Sync + 'static,
        files: impl Fn(&ModuleSource) -> Vec<PathBuf> + Send + Sync + 'static,
    ) -> Self {
        let load: Arc<LoadForeign> = Arc::new(load);
        let source = Some(ForeignKind { keys, files: Arc::new(files), load: Arc::clone(&load) });
        let add = move |core: &mut Core,
                        name: &str,
                        options: ModuleOptions,
                        source: &ModuleSource,
                        interfaces: &Interfaces| {
            let (load, source) = (Arc::clone(&load), source.clone());
            let make = Arc::new(move || load(&source));
            let (interfaces, of_module) = (interfaces.clone(), options.clone());
            let module = move || ForeignModule::new(make.clone(), interfaces.clone(), of_module.clone());
            core.add_restartable(name, module, options)
        };
        Self { source, ..Self::with_add(name, about, Arc::new(add)) }.detached()
    }

    /// Declares that modules of the kind are reloaded unless the robot file says otherwise.
    #[must_use]
    pub fn reloaded(self) -> Self {
        Self { reloads_by_default: true, ..self }
    }

    fn with_add(name: impl Into<Arc<str>>, about: impl Into<Arc<str>>, add: Arc<Add>) -> Self {
        Self {
            name: name.into(),
            about: about.into(),
            is_emulated: false,
            uses_device: false,
            claims_joints: false,
            synchrony: Synchrony::WhenDue,
            files: Arc::default(),
            source: None,
            reloads_by_default: false,
            replayed: None,
            panel: None,
            add,
        }
    }

    /// Creates a kind whose modules drive a [`Device`]: `connect` creates the device and `make` the module
    /// with a link to it.
    ///
    /// Modules of the kind run detached. In a replay the link returns the recorded answers.
    pub fn device<D: Device, M: Module>(
        name: impl Into<Arc<str>>,
        about: impl Into<Arc<str>>,
        connect: impl Fn() -> D + Send + Sync + 'static,
        make: impl Fn(DeviceLink<D>) -> M + Send + Sync + 'static,
    ) -> Self {
        let make = Arc::new(make);
        let of_recorded = Arc::clone(&make);
        Self::new(name, about, move || make(DeviceLink::new(connect())))
            .drives_device()
            .detached()
            .replayed_on(D::TOPIC, move |exchanges| Ok(of_recorded(DeviceLink::recorded(exchanges))))
    }

    /// Runs the modules on their own threads by default: for work that blocks or takes longer than a cycle
    /// may.
    #[must_use]
    pub fn detached(self) -> Self {
        self.with_synchrony(Synchrony::Detached(Self::INBOX))
    }

    /// Sets how the modules run by default.
    #[must_use]
    pub fn with_synchrony(self, synchrony: Synchrony) -> Self {
        Self { synchrony, ..self }
    }

    /// Declares that these settings name files: in a robot file, they are relative to its folder. A text with
    /// a line break is left as it is, for settings that hold either a file or its content.
    #[must_use]
    pub fn with_files(self, settings: &[&str]) -> Self {
        Self { files: settings.iter().map(|&setting| setting.to_owned()).collect(), ..self }
    }

    /// Marks the modules as driving a device: a replay runs them only with recorded answers.
    #[must_use]
    pub fn drives_device(self) -> Self {
        Self { uses_device: true, ..self }
    }

    /// Marks the modules as controllers, each of which has its joints for itself while it is active.
    #[must_use]
    pub fn claiming_joints(self) -> Self {
        Self { claims_joints: true, ..self }
    }

    /// Returns true if each of its modules has its joints for itself while it is active.
    #[must_use]
    pub fn claims_joints(&self) -> bool {
        self.claims_joints
    }

    /// Marks the data of the modules as not from real hardware, which status, bags and `check` then show.
    #[must_use]
    pub fn emulated(self) -> Self {
        Self { is_emulated: true, ..self }
    }

    /// Makes modules that drive a device replayable. They publish all answers of their device as messages of
    /// type `E` on `topic` (the name before remapping); for a replay, `make` creates a module that uses these
    /// messages instead of the device.
    ///
    /// [`Kind::device`] does this for every [`Device`].
    #[must_use]
    pub fn replayed_on<E: Message, M: Module>(
        self,
        topic: &str,
        make: impl Fn(Vec<E>) -> Result<M, String> + Send + Sync + 'static,
    ) -> Self {
        self.replayed_with(topic, move |exchanges, _| make(exchanges))
    }

    fn replayed_with<E: Message, M: Module>(
        self,
        topic: &str,
        make: impl Fn(Vec<E>, &Interfaces) -> Result<M, String> + Send + Sync + 'static,
    ) -> Self {
        let add: Arc<AddReplayed> = Arc::new(move |core, name, options, answers, interfaces| {
            let exchange = |bytes: &Bytes| cdr::from_slice::<E>(bytes).map_err(|error| error.to_string());
            let exchanges = answers.iter().map(exchange).collect::<Result<Vec<_>, String>>()?;
            Ok(core.add_with(name, make(exchanges, interfaces)?, options))
        });
        Self { replayed: Some(ReplayedDevice { topic: topic.into(), add }), ..self }
    }

    /// Like [`Kind::device`], for modules that find types of messages by their names: `make` is also given
    /// the interfaces of the robot.
    pub fn device_with_interfaces<D: Device, M: Module>(
        name: impl Into<Arc<str>>,
        about: impl Into<Arc<str>>,
        connect: impl Fn() -> D + Send + Sync + 'static,
        make: impl Fn(DeviceLink<D>, Interfaces) -> M + Send + Sync + 'static,
    ) -> Self {
        let parts = Arc::new((connect, make));
        let of_recorded = Arc::clone(&parts);
        let add: Arc<Add> = Arc::new(move |core, name, options, _, interfaces| {
            let (parts, interfaces) = (Arc::clone(&parts), interfaces.clone());
            let make = move || parts.1(DeviceLink::new(parts.0()), interfaces.clone());
            core.add_restartable(name, make, options)
        });
        Self::with_add(name, about, add).drives_device().detached().replayed_with(
            D::TOPIC,
            move |exchanges, interfaces| {
                Ok(of_recorded.1(DeviceLink::recorded(exchanges), interfaces.clone()))
            },
        )
    }

    /// Brings a panel to the page of the robot: a JavaScript module whose default export has
    /// `create(root, robot, view)` (docs/panels.md). `topics` are those that it shows, as the module names
    /// them (`~` is its own name); the panel learns their names in the robot.
    #[must_use]
    pub fn with_panel(
        self,
        title: &'static str,
        script: &'static str,
        topics: &'static [&'static str],
    ) -> Self {
        Self { panel: Some(Panel { title, script, topics }), ..self }
    }

    /// The name in robot files.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The description in one line.
    #[must_use]
    pub fn about(&self) -> &str {
        &self.about
    }

    /// Returns true if the data of its modules does not come from real hardware.
    #[must_use]
    pub fn is_emulated(&self) -> bool {
        self.is_emulated
    }

    /// Returns true if its modules drive a device, which a replay must not touch.
    #[must_use]
    pub fn uses_device(&self) -> bool {
        self.uses_device
    }

    /// How its modules run by default.
    #[must_use]
    pub fn synchrony(&self) -> Synchrony {
        self.synchrony
    }

    /// The default options of its modules.
    #[must_use]
    pub fn options(&self) -> ModuleOptions {
        ModuleOptions { synchrony: self.synchrony, ..ModuleOptions::default() }
    }

    /// Adds a module of this kind to a core. The module can be restarted after a panic. `source` is used by
    /// kinds of modules in other languages, of which it loads what the files hold.
    ///
    /// # Errors
    /// See [`Core::add_restartable`].
    pub fn add_to(
        &self,
        core: &mut Core,
        name: &str,
        options: ModuleOptions,
        source: &ModuleSource,
        interfaces: &Interfaces,
    ) -> Result<(), SetupError> {
        (self.add)(core, name, options, source, interfaces)
    }

    /// The panel that its modules bring to the page.
    #[must_use]
    pub fn panel(&self) -> Option<&Panel> {
        self.panel.as_ref()
    }

    /// The keys that a robot file gives a module of this kind: those that it must have, and those that it may
    /// have.
    #[must_use]
    pub fn keys(&self) -> [&'static [&'static str]; 2] {
        self.source.as_ref().map_or([&[], &[]], |source| source.keys)
    }

    /// The files that the behaviour of a module depends on.
    #[must_use]
    pub fn source_files(&self, source: &ModuleSource) -> Vec<PathBuf> {
        self.source.as_ref().map_or_else(Vec::new, |kind| (kind.files)(source))
    }

    /// Loads a module in another language; `None` for a kind in Rust.
    #[must_use]
    pub fn loader(&self) -> Option<Arc<LoadForeign>> {
        self.source.as_ref().map(|kind| Arc::clone(&kind.load))
    }

    /// True for a module that is loaded again when its files change.
    #[must_use]
    pub fn reloads(&self, source: &ModuleSource) -> bool {
        let [_, optional] = self.keys();
        optional.contains(&"reload")
            && source
                .keys
                .get("reload")
                .map_or(self.reloads_by_default, |value| *value == SettingValue::Bool(true))
    }

    /// True for modules in another language.
    #[must_use]
    pub fn is_foreign(&self) -> bool {
        self.source.is_some()
    }

    /// The settings that name files.
    #[must_use]
    pub fn files(&self) -> &[String] {
        &self.files
    }

    /// How a module runs without its device; `None` if its device cannot be replayed.
    #[must_use]
    pub fn replayed(&self) -> Option<&ReplayedDevice> {
        self.replayed.as_ref()
    }
}

impl fmt::Debug for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Kind").field("name", &self.name).finish_non_exhaustive()
    }
}

impl ReplayedDevice {
    /// The name of the topic in a bag.
    #[must_use]
    pub fn topic_of(&self, options: &ModuleOptions) -> String {
        format!("/{}", options.resolved(&self.topic).trim_start_matches('/'))
    }

    /// Adds the module with these answers, the messages of the topic in CDR.
    ///
    /// # Errors
    /// The outer error reports invalid answers; the inner one is that of [`Core::add_with`].
    pub fn add_to(
        &self,
        core: &mut Core,
        name: &str,
        options: ModuleOptions,
        answers: &[Bytes],
        interfaces: &Interfaces,
    ) -> Result<Result<(), SetupError>, String> {
        (self.add)(core, name, options, answers, interfaces)
    }
}
