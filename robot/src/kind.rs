//! A kind of module that robot files can name.

use std::collections::BTreeMap;
use std::fmt;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use downbeat_darwin_op::emulator::{DarwinOpEmulator, MemoryPorts};
use downbeat_darwin_op::falls::Falls;
use downbeat_darwin_op::gait::Gait;
use downbeat_darwin_op::hardware::DarwinOp;
use downbeat_darwin_op::motions::MotionPlayer;
use downbeat_darwin_op::stand_nod_wave::StandNodWave;
use downbeat_device::{Device, DeviceLink};
use downbeat_edge::Interfaces;
use downbeat_edge::foreign::{self, Foreign, ForeignModule};
use downbeat_executor::{Core, Inbox, Module, ModuleOptions, SettingValue, SetupError, Synchrony};
use downbeat_imu_filter::ImuFilter;
use downbeat_kinematics::Kinematics;
use downbeat_kinematics::joint_state_merger::JointStateMerger;
use downbeat_kinematics::robot_state_publisher::RobotStatePublisher;
use downbeat_library_host::LibraryOptions;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::{Message, cdr};
use downbeat_servos::controllers::diff_drive::DiffDriveController;
use downbeat_servos::controllers::forward_command::ForwardCommandController;
use downbeat_servos::controllers::joint_trajectory::JointTrajectoryController;
use downbeat_servos::joint_command_mux::JointCommandMux;
use downbeat_servos::servo_bus::ServoBus;
use downbeat_servos::servo_bus::bus::{Bus, Exchange, RecordedBus};
use downbeat_servos::servo_emulator::ServoEmulator;
use downbeat_state_machine::StateMachineOptions;
use downbeat_transforms::transform_server::TransformServer;

use super::feature_kinds::of_features;
use super::versions::{Live, LiveState, Recorded, Versions};

/// A kind of module that robot files can name: how its modules are created, how they run by default, and
/// whether they drive a device.
///
/// ```
/// use downbeat_executor::{Module, Setup, SetupError};
/// use downbeat_robot::Kind;
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
    panel: Option<KindPanel>,
    add: Arc<Add>,
}

/// The panel that modules of a kind bring to the page.
#[derive(Clone)]
pub(crate) struct KindPanel {
    pub(crate) title: &'static str,
    #[cfg_attr(not(feature = "view"), allow(dead_code))]
    pub(crate) script: &'static str,
    /// Before remapping.
    pub(crate) topics: &'static [&'static str],
}

/// What a robot file says about a module in another language.
#[derive(Clone, Debug, Default)]
pub struct ModuleSource {
    /// The name of the module.
    pub module: String,
    /// The folder of the robot file, which relative paths begin at.
    pub folder: PathBuf,
    /// The keys of the kind, such as `module` or `path`.
    pub keys: BTreeMap<String, SettingValue>,
    /// How long one run of the module may take.
    pub deadline: Option<Duration>,
    /// The folders of interfaces that the robot file names.
    pub interfaces: Vec<PathBuf>,
    /// What is known of the files while the robot runs.
    pub(crate) live: Arc<LiveState>,
    /// In a replay, the versions that were recorded.
    pub(crate) recorded: Option<Arc<Versions>>,
    /// Of an earlier version in a replay: the file that holds what a file held.
    pub(crate) replaced: BTreeMap<PathBuf, PathBuf>,
    /// Whether the robot starts without the module if it cannot be made and is reloaded.
    pub(crate) may_be_late: bool,
}

impl ModuleSource {
    /// A module of this name, whose relative paths begin at this folder.
    #[must_use]
    pub fn new(module: impl Into<String>, folder: impl Into<PathBuf>) -> Self {
        Self { module: module.into(), folder: folder.into(), ..Self::default() }
    }

    /// The file to read for this file of the module: itself or, in a replay of an earlier version, another
    /// one with the content that it had.
    #[must_use]
    pub fn file_to_read(&self, file: &Path) -> PathBuf {
        self.replaced.get(file).map_or_else(|| file.to_owned(), Clone::clone)
    }

    /// True if the robot file says that the module is reloaded.
    pub(crate) fn is_reloaded(&self) -> bool {
        self.keys.get("reload") == Some(&SettingValue::Bool(true))
    }
}

/// How a kind of modules in other languages reads a robot file.
#[derive(Clone)]
struct ForeignKind {
    /// Those that a robot file must give, and those that it may give.
    keys: [&'static [&'static str]; 2],
    files: Arc<SourceFiles>,
    load: Arc<LoadForeign>,
}

/// Loads the module that a robot file names.
pub(crate) type LoadForeign = dyn Fn(&ModuleSource) -> Result<Box<dyn Foreign>, String> + Send + Sync;

type SourceFiles = dyn Fn(&ModuleSource) -> Vec<PathBuf> + Send + Sync;

/// How a module that drives a device runs without it.
#[derive(Clone)]
pub(crate) struct ReplayedDevice {
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

/// The default number of batches that wait for a detached module: two seconds of commands at 125 Hz.
pub(super) const INBOX: Inbox = Inbox::KeepLast(NonZeroUsize::new(250).expect("not zero"));

impl Kind {
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
        let kind = ForeignKind { keys, files: Arc::new(files), load };
        let of_kind = kind.clone();
        let add: Arc<Add> = Arc::new(move |core, name, options, source, interfaces| {
            of_kind.add_to(core, name, options, source, interfaces)
        });
        let source = Some(kind);
        Self { source, ..Self::with_add(name, about, add) }.detached()
    }

    /// Declares that modules of the kind are reloaded unless the robot file says otherwise.
    fn reloaded(self) -> Self {
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
        self.with_synchrony(Synchrony::Detached(INBOX))
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
    pub(crate) fn claiming_joints(self) -> Self {
        Self { claims_joints: true, ..self }
    }

    pub(crate) fn claims_joints(&self) -> bool {
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
        Self { panel: Some(KindPanel { title, script, topics }), ..self }
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
    /// kinds of modules in other languages.
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

    pub(crate) fn panel(&self) -> Option<&KindPanel> {
        self.panel.as_ref()
    }

    /// The keys that a robot file gives a module of this kind: those that it must have, and those that it may
    /// have.
    #[must_use]
    pub fn keys(&self) -> [&'static [&'static str]; 2] {
        self.source.as_ref().map_or([&[], &[]], |source| source.keys)
    }

    /// The files that the behaviour of a module depends on.
    pub(crate) fn source_files(&self, source: &ModuleSource) -> Vec<PathBuf> {
        self.source.as_ref().map_or_else(Vec::new, |kind| (kind.files)(source))
    }

    /// The files of a module of a running robot, and what is known of them; `None` for a module in Rust.
    pub(crate) fn live(&self, source: &ModuleSource) -> Option<Live> {
        self.source.as_ref().map(|kind| kind.live(source))
    }

    /// True for a module that is loaded again when its files change.
    pub(crate) fn reloads(&self, source: &ModuleSource) -> bool {
        let [_, optional] = self.keys();
        optional.contains(&"reload")
            && source
                .keys
                .get("reload")
                .map_or(self.reloads_by_default, |value| *value == SettingValue::Bool(true))
    }

    /// True for modules in another language.
    pub(crate) fn is_foreign(&self) -> bool {
        self.source.is_some()
    }

    /// The settings that name files.
    pub(crate) fn files(&self) -> &[String] {
        &self.files
    }

    pub(crate) fn replayed(&self) -> Option<&ReplayedDevice> {
        self.replayed.as_ref()
    }
}

impl ForeignKind {
    fn live(&self, source: &ModuleSource) -> Live {
        Live::new(Arc::clone(&self.load), source, (self.files)(source))
    }

    fn add_to(
        &self,
        core: &mut Core,
        name: &str,
        options: ModuleOptions,
        source: &ModuleSource,
        interfaces: &Interfaces,
    ) -> Result<(), SetupError> {
        let (versions, recorded_failure): (Arc<dyn foreign::Versions>, _) = match &source.recorded {
            Some(versions) => {
                let (load, files) = (Arc::clone(&self.load), (self.files)(source));
                let recorded = Recorded::new(load, source, files, Arc::clone(versions));
                let failure = recorded.failure().map(str::to_owned);
                (Arc::new(recorded), failure)
            }
            None => (Arc::new(self.live(source)), None),
        };
        let (interfaces, of_module) = (interfaces.clone(), options.clone());
        let make =
            move || ForeignModule::of_versions(Arc::clone(&versions), interfaces.clone(), of_module.clone());
        if let Some(failure) = recorded_failure {
            return core.add_stopped(name, make, options, &failure);
        }
        let added = core.add_restartable(name, make.clone(), options.clone());
        let failure = source.live.failure().filter(|_| source.may_be_late && source.is_reloaded());
        match (added, failure) {
            (Err(error), Some(failure)) => {
                tracing::error!("{error}; it starts when its file is saved");
                core.add_stopped(name, make, options, &failure)
            }
            (added, _) => added,
        }
    }
}

impl fmt::Debug for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Kind").field("name", &self.name).finish_non_exhaustive()
    }
}

impl ReplayedDevice {
    /// The name of the topic in a bag.
    pub(crate) fn topic_of(&self, options: &ModuleOptions) -> String {
        format!("/{}", options.resolved(&self.topic).trim_start_matches('/'))
    }

    /// Adds the module with these answers, the messages of the topic in CDR. The outer error reports invalid
    /// answers.
    pub(crate) fn add_to(
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

pub(super) fn built_in() -> Vec<Kind> {
    // Emulators and hardware modules of one catalog meet here.
    let ports = MemoryPorts::default();
    let [of_hardware, of_emulator, of_servos, of_servo_emulator] = std::array::from_fn(|_| ports.clone());
    let mut kinds = vec![
        Kind::new(
            "darwin_op",
            "the hardware of a Darwin OP: CM-730 and 20 MX-28 servos on a serial port",
            move || DarwinOp::new(Box::new(of_hardware.bus())),
        )
        .drives_device()
        .detached()
        .replayed_on("bus/exchanges", |messages| Ok(DarwinOp::new(recorded_bus(messages)?))),
        Kind::new(
            "darwin_op_emulator",
            "an emulated Darwin OP behind a pseudo terminal, with faults on request",
            move || DarwinOpEmulator::new(of_emulator.clone()),
        )
        .drives_device()
        .emulated()
        .with_synchrony(Synchrony::WhenDue),
        Kind::new(
            "diff_drive",
            "drives a base with wheels on two sides by cmd_vel, with odometry",
            DiffDriveController::default,
        )
        .claiming_joints(),
        Kind::new(
            "forward_command",
            "passes positions, velocities or efforts on to joints",
            ForwardCommandController::default,
        )
        .claiming_joints(),
        Kind::new(
            "joint_command_mux",
            "which of several commands a joint gets, by the order of their sources",
            JointCommandMux::default,
        ),
        Kind::new(
            "joint_state_merger",
            "joint_states of several buses as one message",
            JointStateMerger::default,
        )
        .with_files(&["robot_description"]),
        Kind::new(
            "joint_trajectory",
            "follows trajectories of joints: the action FollowJointTrajectory",
            JointTrajectoryController::default,
        )
        .claiming_joints(),
        Kind::new(
            "kinematics",
            "services for poses of links, inverse kinematics, where the camera looks; the centre of mass",
            Kinematics::default,
        )
        .with_files(&["robot_description"]),
        Kind::new(
            "robot_state_publisher",
            "tf, tf_static and robot_description, from a URDF and joint_states",
            RobotStatePublisher::default,
        )
        .with_files(&["robot_description"]),
        Kind::foreign(
            "library",
            "a module in C, C++ or Rust: a shared library (docs/libraries.md)",
            [&["path"], &["reload", "isolate", "time_limit"]],
            |source| downbeat_library_host::load(&library(source)?),
            |source| library(source).map(|options| vec![options.path]).unwrap_or_default(),
        )
        .with_synchrony(Synchrony::WhenDue),
        Kind::foreign(
            "state_machine",
            "decisions as a statechart in a file, a subset of SCXML (docs/state_machine.md)",
            [&["file"], &["reload"]],
            |source| downbeat_state_machine::load(&state_machine(source)?),
            |source| state_machine(source).map(|options| vec![options.path]).unwrap_or_default(),
        )
        .reloaded()
        .with_panel("Chart", downbeat_state_machine::PANEL, &["~/mermaid", "~/state"])
        .with_synchrony(Synchrony::WhenDue),
        Kind::new("imu_filter", "orientation from gyroscope and accelerometer", ImuFilter::default),
        Kind::new("gait", "walks with the velocity on cmd_vel, and publishes odometry", Gait::default)
            .with_files(&["humanoid"]),
        Kind::new("motions", "key-frame motions by name: get up, kick, wave", MotionPlayer::default)
            .with_files(&["file", "humanoid"]),
        Kind::new("falls", "detects falls, goes limp, and gets up", Falls::default).with_files(&["humanoid"]),
        Kind::new(
            "servo_bus",
            "the hardware of a robot of serial servos, Dynamixel or Feetech, as a file describes it",
            move || ServoBus::new(Box::new(of_servos.bus())),
        )
        .with_files(&["description"])
        .drives_device()
        .detached()
        .replayed_on("bus/exchanges", |messages| Ok(ServoBus::new(recorded_bus(messages)?))),
        Kind::new(
            "servo_emulator",
            "emulated servos of such a file behind a pseudo terminal, with faults on request",
            move || ServoEmulator::new(of_servo_emulator.clone()),
        )
        .with_files(&["description"])
        .drives_device()
        .emulated()
        .with_synchrony(Synchrony::WhenDue),
        Kind::new("stand_nod_wave", "a small motion: stand up, then nod and wave", StandNodWave::default),
        Kind::new(
            "transform_server",
            "the action tf2_buffer_server: lookups of transforms, for clients without a transform buffer",
            TransformServer::default,
        ),
    ];
    kinds.extend(of_features(&ports));
    kinds
}

/// Reads the keys of a module in a shared library.
fn library(source: &ModuleSource) -> Result<LibraryOptions, String> {
    let Some(SettingValue::Text(path)) = source.keys.get("path") else {
        return Err("`path` is the file of the library, such as \"libfoo.so\"".to_owned());
    };
    Ok(LibraryOptions {
        module: source.module.clone(),
        path: source.file_to_read(&source.folder.join(path)),
        is_reloaded: is_set(source, "reload", false)?,
        is_isolated: is_set(source, "isolate", false)?,
        time_limit: match source.keys.get("time_limit") {
            // A module that may run for longer is not killed before that is reported.
            None => source.deadline.unwrap_or_default().max(LibraryOptions::TIME_LIMIT),
            Some(SettingValue::Text(text)) => time_limit(text)?,
            Some(other) => {
                return Err(format!("`time_limit` is a time with its unit, such as \"500ms\", not {other}"));
            }
        },
    })
}

/// Reads the keys of a state machine.
fn state_machine(source: &ModuleSource) -> Result<StateMachineOptions, String> {
    let Some(SettingValue::Text(file)) = source.keys.get("file") else {
        return Err("`file` is the chart, such as \"player.scxml\"".to_owned());
    };
    let path = source.file_to_read(&source.folder.join(file));
    Ok(StateMachineOptions { path, is_reloaded: is_set(source, "reload", true)? })
}

fn time_limit(text: &str) -> Result<Duration, String> {
    match crate::duration::parse(text) {
        Ok(limit) if !limit.is_zero() => Ok(limit),
        Ok(_) => Err("`time_limit` has to be above 0".to_owned()),
        Err(problem) => Err(format!("`time_limit`: {problem}")),
    }
}

fn is_set(source: &ModuleSource, key: &str, default: bool) -> Result<bool, String> {
    match source.keys.get(key) {
        None => Ok(default),
        Some(SettingValue::Bool(value)) => Ok(*value),
        Some(other) => Err(format!("`{key}` is true or false, not {other}")),
    }
}

fn recorded_bus(messages: Vec<BusExchange>) -> Result<Box<dyn Bus>, String> {
    let exchanges =
        messages.into_iter().map(|message| Exchange::try_from(message).map_err(|error| error.to_string()));
    let (bus, _) = RecordedBus::new(exchanges.collect::<Result<Vec<_>, String>>()?);
    Ok(Box::new(bus))
}
