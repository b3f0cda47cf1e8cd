//! Programs that run robots: registration of what their robot files can name, and all commands.

#[cfg(feature = "cli")]
use std::ffi::OsString;
use std::path::Path;
#[cfg(feature = "cli")]
use std::process::ExitCode;

use downbeat_bags::{Reader, ReaderError};
use downbeat_bridge::middleware::ParticipantOptions;
use downbeat_executor::{Launcher, Mechanism, Module, ThreadOptions};
use downbeat_msgs::InterfaceSet;

use downbeat_robot::replay::{self, ReplayError, ReplayOptions, ReplayReport};
use downbeat_robot::running::{PreparedRobot, RunningRobot, StartError};
use downbeat_robot::{Catalog, CatalogError, Kind, RobotFile, RobotFileError, RosArgs};

/// A user's program: kinds of modules, registered by name, with all commands of `downbeat`.
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
/// The methods that register something never fail. Errors of a registration are reported by the methods that
/// use the app.
#[derive(Clone, Default)]
pub struct App {
    catalog: Catalog,
    /// The error of the first registration that was refused.
    problem: Option<CatalogError>,
}

/// Error of an app.
#[derive(Debug, thiserror::Error)]
pub enum AppError {
    /// A registration was refused.
    #[error("this program registers something invalid: {0}")]
    Catalog(#[from] CatalogError),
    /// The robot file is invalid.
    #[error(transparent)]
    Robot(#[from] RobotFileError),
    /// The robot cannot be started.
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
    /// Creates an app without kinds of modules.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Creates an app with the built-in kinds of modules, like the program `downbeat`.
    #[must_use]
    pub fn with_built_in_kinds() -> Self {
        Self { catalog: Catalog::built_in(), problem: Catalog::environment_problem() }
    }

    /// Registers messages, services and actions: the set `INTERFACES` of a crate, or that of one type. They
    /// are then exposed, recorded, replayed and shown like the built-in ones.
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

    /// Registers a kind of module: its name in robot files, a description in one line, and a function that
    /// creates a module.
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

    /// Registers a launcher, which robot files name as `kind` in `[launcher]`. `make` receives the CPUs and
    /// priorities that the robot file sets.
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

    /// Returns the registered kinds, interfaces, launchers and mechanisms.
    ///
    /// # Errors
    /// Returns an error if a registration was refused.
    pub fn catalog(&self) -> Result<&Catalog, AppError> {
        match &self.problem {
            None => Ok(&self.catalog),
            Some(problem) => Err(problem.clone().into()),
        }
    }

    /// Reads a robot file.
    ///
    /// # Errors
    /// Returns an error with path and line if the file cannot be read or is invalid.
    pub fn robot_file(&self, path: impl AsRef<Path>) -> Result<RobotFile, AppError> {
        Ok(RobotFile::read_with(path.as_ref(), self.catalog()?, &RosArgs::default())?)
    }

    /// Starts the robot of a robot file on its own threads: its core, its node in the ROS domain of the
    /// environment, and the socket for `downbeat top`. It runs until the result is stopped or dropped.
    ///
    /// ```no_run
    /// let robot = downbeat::App::with_built_in_kinds().start("robots/darwin_op.toml")?;
    /// std::thread::sleep(std::time::Duration::from_secs(10));
    /// robot.stop()?;
    /// # Ok::<(), downbeat::Failure>(())
    /// ```
    ///
    /// For a recording, another domain, no node or inlets, use [`App::robot_file`] and [`PreparedRobot`]
    /// instead.
    ///
    /// # Errors
    /// Returns an error if the file is invalid or a part of the robot cannot be started.
    pub fn start(&self, path: impl AsRef<Path>) -> Result<RunningRobot, AppError> {
        let mut robot = PreparedRobot::new(self.robot_file(path)?)?;
        let options = ParticipantOptions::from_env().map_err(StartError::from)?;
        robot.expose(&options, None)?;
        #[cfg(feature = "view")]
        robot.view(None)?;
        Ok(robot.start()?)
    }

    /// Replays a bag of a robot with its modules and compares what they publish with the recording: bit for
    /// bit, unless `[replay]` of the robot file specifies other rules.
    ///
    /// # Errors
    /// Returns an error if the bag cannot be replayed. A replay that differs is not an error: the report
    /// contains the difference.
    pub fn replay(&self, robot: impl AsRef<Path>, bag: impl AsRef<Path>) -> Result<ReplayReport, AppError> {
        let file = self.robot_file(robot)?;
        let options = ReplayOptions::of(&file);
        Ok(replay::replay(file, &Reader::open(bag.as_ref())?, &options)?)
    }

    /// Runs the command line with all commands of `downbeat`. Errors are printed and lead to exit code 1.
    /// Sets up logging, reports panics through it, and handles SIGINT, SIGTERM, SIGHUP and SIGQUIT of the
    /// process.
    #[cfg(feature = "cli")]
    #[must_use]
    pub fn main(&self) -> ExitCode {
        self.main_with(std::env::args_os())
    }

    /// Runs a command line as [`main`](Self::main) does, for programs that another language starts: the name
    /// of the program comes first.
    #[cfg(feature = "cli")]
    #[must_use]
    pub fn main_with(&self, line: impl IntoIterator<Item = OsString>) -> ExitCode {
        downbeat_program::main(self.problem.as_ref().map_or(Ok(&self.catalog), Err), line)
    }
}
