//! A robot while it runs: its core on a thread of its own, its node in ROS 2, its recording, and the socket
//! through which `downbeat top` looks at it.
//!
//! `App::start` of the package `downbeat` does all of it at once; [`PreparedRobot`] does it step by step, for
//! a program that adds more to the core.
//! Nothing here is global: any number of robots run in a process, each with its node.

mod expose_service;
mod inspected;
mod log_tail;
mod newcomers;
mod node;
#[cfg(feature = "view")]
mod page_host;
mod recording;
mod rehearsal;
mod revival;
mod snapshots;
#[cfg(feature = "view")]
mod view;

use std::io;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use downbeat_bags::{Recording, RecordingFailed, RecordingSummary, WriterError};
use downbeat_bridge::clock::{NodeClock, SimTimeError};
use downbeat_bridge::diagnostics::ProcessDiagnostics;
use downbeat_bridge::expose::ExposeError;
use downbeat_bridge::lifecycle::LifecycleError;
use downbeat_bridge::middleware::{MiddlewareError, OptionsError, ParticipantOptions};
use downbeat_bridge::ros::NodeError;
use downbeat_bridge::rosout::RosoutError;
use downbeat_executor::{Core, CoreHandle, ManualClock, RunError, SetupError, Time};

pub use log_tail::LogTail;
pub use node::{NodeLog, RobotNode};
pub use recording::RecordPlan;
pub(crate) use recording::{RECORDED_FROM, SIMULATED_TIME};
pub use rehearsal::{Rehearsal, RehearsedNetwork};

use crate::inspect::{ClaimError, DirectoryError, InspectionServer, SocketDirectory};
use crate::recorder::RecorderError;
use crate::ros_recorder::ServeError;
use crate::{ClockChoice, Robot, RobotFile, RobotFileError};
use expose_service::ExposeService;
use inspected::InspectedRobot;
use newcomers::Newcomers;
use recording::RobotRecording;
use revival::Revival;

/// Why a robot cannot start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The robot file does not describe a robot.
    #[error(transparent)]
    Robot(#[from] RobotFileError),
    /// A module cannot join the core.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// Another robot has the node name.
    #[error(transparent)]
    Claim(#[from] ClaimError),
    /// An environment variable that configures ROS 2 has an invalid value.
    #[error(transparent)]
    Options(#[from] OptionsError),
    /// The DDS domain cannot be joined.
    #[error(transparent)]
    Middleware(#[from] MiddlewareError),
    /// A node, or something of it, cannot be created.
    #[error(transparent)]
    Node(#[from] NodeError),
    /// An entry of `[expose]` cannot be exposed.
    #[error(transparent)]
    Expose(#[from] ExposeError),
    /// `/rosout` cannot be published.
    #[error(transparent)]
    Rosout(#[from] RosoutError),
    /// `use_sim_time` cannot be set.
    #[error(transparent)]
    SimTime(#[from] SimTimeError),
    /// Modules cannot be shown as managed nodes.
    #[error(transparent)]
    Lifecycle(#[from] LifecycleError),
    /// The bag cannot be created.
    #[error(transparent)]
    Bag(#[from] WriterError),
    /// The condition of snapshots cannot be evaluated.
    #[error("snapshot_when of [record]: {0}")]
    SnapshotCondition(String),
    /// The services of the recorder cannot be offered.
    #[error(transparent)]
    RecorderServices(#[from] ServeError),
    /// The robot cannot be recorded.
    #[error(transparent)]
    Recorder(#[from] RecorderError),
    /// The server for viewers cannot start.
    #[cfg(feature = "view")]
    #[error(transparent)]
    View(#[from] downbeat_view::ViewError),
    /// The server for viewers has no token.
    #[cfg(feature = "view")]
    #[error("viewers: {0}")]
    ViewToken(#[from] downbeat_view::TokenError),
    /// A thread cannot be started.
    #[error("cannot start the thread of {what}: {source}")]
    Thread {
        /// Its purpose.
        what: &'static str,
        /// Why not.
        source: io::Error,
    },
}

/// A failure while a robot ran or stopped.
#[derive(Debug, thiserror::Error)]
pub enum StopError {
    /// The core could not run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The core's thread panicked.
    #[error("the core's thread panicked")]
    Panicked,
    /// The bag does not hold all of the run.
    #[error("the recording is not complete: {0}")]
    Recording(#[from] RecordingFailed),
}

/// When robots in simulated time start: not at 0, which is no time in ROS 2.
pub const SIMULATION_START: Time = Time::from_nanos(1_000_000_000);

/// The time of a robot that does not run by the machine's clock.
struct SimulatedTime {
    clock: ManualClock,
    end: Option<Time>,
    /// At most, as a factor of real time.
    speed: Option<f64>,
}

/// A robot ready to run.
pub struct PreparedRobot {
    robot: Robot,
    clock: NodeClock,
    /// The clock of a robot in simulated time.
    simulated: Option<SimulatedTime>,
    diagnostics: Option<ProcessDiagnostics>,
    node: Option<RobotNode>,
    recording: Option<RobotRecording>,
    #[cfg(feature = "view")]
    view: Option<view::RobotView>,
}

impl PreparedRobot {
    /// Builds a core with the modules of the file.
    ///
    /// # Errors
    /// If a module cannot be set up as the file says.
    pub fn new(file: RobotFile) -> Result<Self, StartError> {
        let clock = NodeClock::default();
        Self::on(Core::new().with_clock(clock.clone()), file, clock)
    }

    /// Builds a core with the modules of the file that runs in simulated time, as fast as it can be computed,
    /// from [`SIMULATION_START`] for this duration, or until it is stopped. Two runs give the same messages
    /// if nothing comes from outside. Modules with devices need devices that live in that time, such as the
    /// simulated Darwin OP. The time is published on `/clock`.
    ///
    /// # Errors
    /// If a module cannot be set up as the file says.
    pub fn simulated(mut file: RobotFile, duration: Option<Duration>) -> Result<Self, StartError> {
        if !matches!(file.expose.features.clock, ClockChoice::Publish(_)) {
            let period = Duration::from_secs_f64(1.0 / downbeat_bridge::clock::DEFAULT_RATE_HZ);
            file.expose.features.clock = ClockChoice::Publish(period);
        }
        let clock = ManualClock::new(SIMULATION_START);
        let prepared = Self::on(Core::new().with_clock(clock.clone()), file, NodeClock::default())?;
        let end = duration.map(|duration| SIMULATION_START + duration);
        Ok(Self { simulated: Some(SimulatedTime { clock, end, speed: None }), ..prepared })
    }

    /// Lets simulated time pass at most so many times as fast as real time, for those who watch.
    #[must_use]
    pub fn at_speed(mut self, speed: f64) -> Self {
        if let Some(simulated) = &mut self.simulated {
            simulated.speed = Some(speed);
        }
        self
    }

    fn on(mut core: Core, mut file: RobotFile, clock: NodeClock) -> Result<Self, StartError> {
        #[cfg(not(feature = "view"))]
        if file.view.foxglove.is_some() || file.view.page.is_some() {
            tracing::warn!(
                "[view] has no effect: this program is {}",
                crate::features::built_without("view")
            );
        }
        let diagnostics = add_diagnostics(&mut core, &file)?;
        file.modules.iter_mut().for_each(|module| module.versions.may_be_late = true);
        let robot = file.build(core)?;
        if let Some(diagnostics) = diagnostics.as_ref().filter(|_| !robot.file.latencies.is_empty()) {
            diagnostics.watch(robot.latencies.diagnostics(&robot.file.name));
        }
        Ok(Self {
            robot,
            clock,
            simulated: None,
            diagnostics,
            node: None,
            recording: None,
            #[cfg(feature = "view")]
            view: None,
        })
    }

    /// Creates the node with all that the robot file exposes. If `log` is given, the log of the program is
    /// published on `/rosout`.
    ///
    /// # Errors
    /// If the domain cannot be joined, or something cannot be exposed as the file says.
    pub fn expose(&mut self, options: &ParticipantOptions, log: Option<&NodeLog>) -> Result<(), StartError> {
        let diagnostics = self.diagnostics.as_ref();
        self.node = Some(RobotNode::start(&mut self.robot, &self.clock, diagnostics, options, log)?);
        Ok(())
    }

    /// Records while the robot runs.
    ///
    /// # Errors
    /// If the bag cannot be created, or a topic that is to be recorded cannot.
    pub fn record(&mut self, plan: RecordPlan) -> Result<(), StartError> {
        let (node, diagnostics) = (self.node.as_ref().map(RobotNode::node), self.diagnostics.as_ref());
        let is_simulated = self.simulated.is_some();
        let recording = RobotRecording::start(&mut self.robot, node, diagnostics, is_simulated, plan)?;
        self.recording = Some(recording);
        Ok(())
    }

    /// Starts the servers for Foxglove, Lichtblick, PlotJuggler and the page that the robot file's `[view]`
    /// asks for. Call it last, so that viewers see all topics and services from the start, and the page the
    /// recording. If `log` is given, the page shows the log of the program. Once this was called,
    /// `downbeat view` can open the page of the running robot.
    ///
    /// # Errors
    /// If the address is in use, or a service cannot be shown.
    #[cfg(feature = "view")]
    pub fn view(&mut self, log: Option<&NodeLog>) -> Result<(), StartError> {
        let recording = self.recording.as_ref().map(|robot| &robot.recording);
        let is_simulated = self.simulated.is_some();
        self.view = Some(view::RobotView::start(&mut self.robot, is_simulated, log, recording)?);
        Ok(())
    }

    /// The robot file.
    #[must_use]
    pub fn file(&self) -> &RobotFile {
        &self.robot.file
    }

    /// The core, for modules, inlets and outlets of the program's own.
    pub fn core(&mut self) -> &mut Core {
        &mut self.robot.core
    }

    /// Starts the robot.
    ///
    /// # Errors
    /// If a thread cannot be started.
    pub fn start(self) -> Result<RunningRobot, StartError> {
        #[cfg(feature = "view")]
        let view = self.view.map(Arc::new);
        let newcomers = Newcomers::of(
            &self.robot,
            self.node.as_ref(),
            self.recording.as_ref().map(|recording| recording.growing.clone()),
            #[cfg(feature = "view")]
            view.clone(),
        );
        let Self { robot: Robot { file, mut core, latencies }, simulated, node, recording, .. } = self;
        let (handle, file) = (core.handle(), Arc::new(file));
        let revival = Revival::start(&file, &mut core, newcomers)?;
        let thread = std::thread::Builder::new().name("core".into());
        let thread = thread.spawn(move || match simulated {
            None => core.run(),
            Some(SimulatedTime { clock, end, speed }) => core.run_simulated_at(&clock, end, speed),
        });
        let thread = thread.map_err(|source| StartError::Thread { what: "the core", source })?;
        let inspected = Arc::new(InspectedRobot {
            core: handle.clone(),
            bridge: node.as_ref().map(|node| node.bridge().clone()),
            file: Arc::clone(&file),
            latencies,
            #[cfg(feature = "view")]
            view: view.clone(),
        });
        let inspection = inspection(&file.name, Arc::clone(&inspected));
        let offered = node.as_ref().filter(|_| file.expose.features.expose_service);
        let expose_service = offered.and_then(|node| {
            let started = ExposeService::start(node.node(), inspected);
            started.inspect_err(|error| tracing::error!("~/expose is not offered: {error}")).ok()
        });
        Ok(RunningRobot {
            core: handle,
            thread: Some(thread),
            revival,
            inspection,
            expose_service,
            recording,
            #[cfg(feature = "view")]
            view,
            node,
            file,
        })
    }
}

/// A robot that runs, until it is stopped or dropped.
pub struct RunningRobot {
    core: CoreHandle,
    thread: Option<JoinHandle<Result<(), RunError>>>,
    revival: Option<Revival>,
    inspection: Option<InspectionServer>,
    expose_service: Option<ExposeService>,
    recording: Option<RobotRecording>,
    #[cfg(feature = "view")]
    view: Option<Arc<view::RobotView>>,
    node: Option<RobotNode>,
    file: Arc<RobotFile>,
}

impl RunningRobot {
    /// The handle of its core, which publishes, calls, sets, adds modules and stops from any thread.
    #[must_use]
    pub fn core(&self) -> &CoreHandle {
        &self.core
    }

    /// Its node in ROS 2, if it is exposed.
    #[must_use]
    pub fn node(&self) -> Option<&RobotNode> {
        self.node.as_ref()
    }

    /// Its recording, if it is recorded.
    #[must_use]
    pub fn recording(&self) -> Option<&Recording> {
        self.recording.as_ref().map(|robot| &robot.recording)
    }

    /// Its server for viewers, if it has one. Its URLs hold the token and are not logged.
    #[cfg(feature = "view")]
    #[must_use]
    pub fn view(&self) -> Option<&downbeat_view::ViewServer> {
        self.view.as_ref()?.server()
    }

    /// The robot file.
    #[must_use]
    pub fn file(&self) -> &RobotFile {
        &self.file
    }

    /// True if the core has stopped by itself, or was stopped by its handle.
    #[must_use]
    pub fn is_finished(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Stops the modules, then finishes the recording and leaves ROS 2. Returns what was recorded.
    ///
    /// # Errors
    /// If the core could not run, or the recording is not complete.
    pub fn stop(mut self) -> Result<Option<RecordingSummary>, StopError> {
        self.end()
    }

    fn end(&mut self) -> Result<Option<RecordingSummary>, StopError> {
        let Some(thread) = self.thread.take() else { return Ok(None) };
        self.core.stop();
        let ran = thread.join();
        self.revival = None;
        self.inspection = None;
        self.expose_service = None;
        #[cfg(feature = "view")]
        if let Some(view) = &self.view {
            view.finish_recording();
        }
        let summary = self.recording.take().map(|RobotRecording { recording, services, .. }| {
            let summary = recording.finish();
            drop(services);
            summary
        });
        #[cfg(feature = "view")]
        if let Some(view) = self.view.take() {
            view.close();
        }
        self.node = None;
        ran.map_err(|_| StopError::Panicked)??;
        Ok(summary.transpose()?)
    }
}

impl Drop for RunningRobot {
    fn drop(&mut self) {
        if let Err(error) = self.end() {
            tracing::error!("{}: {error}", self.file.name);
        }
    }
}

/// Adds the diagnostics of the process, unless the robot file disables them. They come before the robot's
/// modules, so that their topic can be exposed.
pub fn add_diagnostics(core: &mut Core, file: &RobotFile) -> Result<Option<ProcessDiagnostics>, SetupError> {
    file.expose.features.diagnostics.then(|| ProcessDiagnostics::add(core, &file.name)).transpose()
}

/// A robot runs even if the socket cannot be created.
fn inspection(name: &str, robot: Arc<InspectedRobot>) -> Option<InspectionServer> {
    let unseen =
        |error: &dyn std::error::Error| tracing::warn!("`downbeat top` will not see this robot: {error}");
    let directory = SocketDirectory::open().inspect_err(|error| match error {
        // A user cannot change this. The command that looks into the robot reports it.
        DirectoryError::Unsupported => tracing::debug!("{error}"),
        _ => unseen(error),
    });
    let directory = directory.ok()?;
    InspectionServer::start(&directory, name, robot).inspect_err(|error| unseen(error)).ok()
}
