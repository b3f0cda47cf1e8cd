//! A program that runs robots: what its robot files can name, with every command.

use std::path::Path;

use downbeat_bags::{Reader, ReaderError};
use downbeat_bridge::middleware::ParticipantOptions;
use downbeat_executor::{Launcher, Mechanism, Module, ThreadOptions};
use downbeat_msgs::InterfaceSet;

use crate::replay::{self, ReplayError, ReplayOptions, ReplayReport};
use crate::robot::{Catalog, CatalogError, Kind, RobotFile, RobotFileError, RosArgs};
use crate::running::{PreparedRobot, RunningRobot, StartError};

/// A user's program: kinds of modules, registered by name, with every command of `downbeat`.
///
/// ```no_run
/// use downbeat::executor::{Module, Setup, SetupError};
///
/// #[derive(Default)]
/// struct LevelHead;
///
/// impl Module for LevelHead {
///     type Ports = ();
///
///     fn setup(&mut self, _: &mut Setup<'_, Self>) -> Result<(), SetupError> {
///         Ok(())
///     }
/// }
///
/// fn app() -> downbeat::App {
///     downbeat::App::new().kind("level_head", "holds the head level", LevelHead::default)
/// }
///
/// # #[cfg(feature = "cli")]
/// fn main() -> std::process::ExitCode {
///     app().main()
/// }
/// # #[cfg(not(feature = "cli"))]
/// # fn main() {}
///
/// #[test]
/// fn field_run_repeats() -> downbeat::TestResult {
///     app().replay("robot.toml", "tests/field_run")?.assert_same()
/// }
/// ```
///
/// The methods that register something never fail; what is wrong with a registration is reported by the methods that use
/// the app.
#[derive(Clone, Default)]
pub struct App {
    catalog: Catalog,
    /// The first registration that was refused.
    problem: Option<CatalogError>,
}

/// Why an app cannot do what was requested.
#[derive(Debug, thiserror::Error)]
pub enum AppError {
    /// A registration was refused.
    #[error("this program registers something invalid: {0}")]
    Catalog(#[from] CatalogError),
    /// The robot file does not describe a robot.
    #[error(transparent)]
    Robot(#[from] RobotFileError),
    /// The robot does not start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The bag cannot be read.
    #[error(transparent)]
    Bag(#[from] ReaderError),
    /// The bag cannot be replayed.
    #[error(transparent)]
    Replay(#[from] ReplayError),
}

impl App {
    /// An app without kinds of modules.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// An app with the kinds of modules that come with downbeat, as the program `downbeat` has.
    #[must_use]
    pub fn with_built_in_kinds() -> Self {
        Self { catalog: Catalog::built_in(), problem: None }
    }

    /// Registers messages, services and actions: the set `INTERFACES` of a crate, or that of one type. They are then exposed, recorded,
    /// replayed and shown like those that downbeat carries.
    ///
    /// ```
    /// use downbeat::msgs::Message;
    ///
    /// #[derive(Clone, Debug, Default, PartialEq, Message)]
    /// #[message(name = "my_msgs/msg/Tilt", crate = "downbeat::msgs")]
    /// struct Tilt {
    ///     angle: f64,
    /// }
    ///
    /// let app = downbeat::App::new().interfaces(Tilt::INTERFACES);
    /// assert!(app.catalog()?.interfaces.message("my_msgs/msg/Tilt").is_ok());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn interfaces(self, set: impl InterfaceSet) -> Self {
        self.register(|catalog| catalog.add_interfaces(set))
    }

    /// Registers a kind of module: its name in robot files, a description of one line, and a function that makes a module.
    #[must_use]
    pub fn kind<M: Module>(
        self,
        name: &str,
        about: &str,
        make: impl Fn() -> M + Send + Sync + 'static,
    ) -> Self {
        self.add_kind(Kind::new(name, about, make))
    }

    /// Registers a kind of module with further properties: detached, with a device, or emulated.
    #[must_use]
    pub fn add_kind(self, kind: Kind) -> Self {
        self.register(|catalog| catalog.add_kind(kind))
    }

    /// Registers a mechanism, which is added to every core.
    #[must_use]
    pub fn mechanism<M: Mechanism>(self, make: impl Fn() -> M + Send + Sync + 'static) -> Self {
        self.register(|catalog| {
            catalog.add_mechanism(make);
            Ok(())
        })
    }

    /// Registers a launcher, which robot files name as `kind` in `[launcher]`. `make` receives the CPUs and priorities that the robot
    /// file sets.
    #[must_use]
    pub fn launcher<L: Launcher + 'static>(
        self,
        name: &str,
        make: impl Fn(&ThreadOptions) -> Result<L, String> + Send + Sync + 'static,
    ) -> Self {
        self.register(|catalog| catalog.add_launcher(name, make))
    }

    fn register(mut self, add: impl FnOnce(&mut Catalog) -> Result<(), CatalogError>) -> Self {
        if let Err(problem) = add(&mut self.catalog) {
            self.problem.get_or_insert(problem);
        }
        self
    }

    /// The registered kinds, interfaces, launchers and mechanisms.
    ///
    /// # Errors
    /// If a registration was refused.
    pub fn catalog(&self) -> Result<&Catalog, AppError> {
        match &self.problem {
            None => Ok(&self.catalog),
            Some(problem) => Err(problem.clone().into()),
        }
    }

    /// Reads a robot file.
    ///
    /// # Errors
    /// If it cannot be read, or says something that cannot be; with path and line.
    pub fn robot_file(&self, path: impl AsRef<Path>) -> Result<RobotFile, AppError> {
        Ok(RobotFile::read_with(path.as_ref(), self.catalog()?, &RosArgs::default())?)
    }

    /// Starts the robot of a robot file on threads of its own: its core, its node in the ROS domain of the environment, and the socket
    /// for `downbeat top`. It runs until the result is stopped or dropped.
    ///
    /// For a recording, another domain, no node or inlets, use [`App::robot_file`] and [`PreparedRobot`] instead.
    ///
    /// # Errors
    /// If the file does not describe a robot, or something of it cannot start.
    pub fn start(&self, path: impl AsRef<Path>) -> Result<RunningRobot, AppError> {
        let mut robot = PreparedRobot::new(self.robot_file(path)?)?;
        let options = ParticipantOptions::from_env().map_err(StartError::from)?;
        robot.expose(&options, None)?;
        Ok(robot.start()?)
    }

    /// Runs a robot's modules on a bag of it, and compares what they publish with what they published then: bit for bit,
    /// but where `[replay]` of the robot file says otherwise.
    ///
    /// # Errors
    /// If the bag cannot be replayed. That the replay differs is no error: the report says so.
    pub fn replay(&self, robot: impl AsRef<Path>, bag: impl AsRef<Path>) -> Result<ReplayReport, AppError> {
        let file = self.robot_file(robot)?;
        let options = ReplayOptions::of(&file);
        Ok(replay::replay(file, &Reader::open(bag.as_ref())?, &options)?)
    }

    /// Runs the command line, with every command of `downbeat`. Errors are printed and give exit code 1. Takes over logging, SIGINT
    /// and SIGTERM of the process.
    #[cfg(feature = "cli")]
    #[must_use]
    pub fn main(&self) -> std::process::ExitCode {
        crate::program::main(self)
    }
}
