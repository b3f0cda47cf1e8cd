//! `downbeat run`

use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;

use super::logging::Log;
use super::network::participant_options;
use super::new_output::{Force, Output};
use super::parameters::ParameterArguments;
use super::screen::Screen;
#[cfg(feature = "security")]
use super::security::RobotReport;
use super::service::Service;
use super::statistics::{Statistics, Times};
use super::status::{Faults, Sources, StatusBlock};
use super::stop::Stop;
use downbeat_bags::{Recording, RecordingSummary};
use downbeat_bridge::middleware::Engine;
use downbeat_files::duration::parse as duration;
use downbeat_msgs::encoding::Encoding;
#[cfg(feature = "view")]
use downbeat_robot::running::RunningRobot;
#[cfg(feature = "security")]
use downbeat_robot::running::StartError;
use downbeat_robot::running::{PreparedRobot, RecordPlan, RobotNode, StopError};
use downbeat_robot::{Catalog, RobotFile, RosArgs};

#[derive(Args)]
pub(crate) struct RunArguments {
    /// The robot file, or the name of a carried robot, such as darwin_op (`downbeat robots list`).
    #[arg(value_name = "ROBOT.toml")]
    pub(crate) robot: PathBuf,
    /// Stop after this time: 500ms, 10s, 5min, 1h.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    pub(crate) duration: Option<Duration>,
    /// Run in simulated time, as fast as it can be computed; --duration is in that time. For robots without
    /// hardware.
    #[arg(long)]
    pub(crate) fast: bool,
    /// Record the topics of the robot file's [record] into this rosbag2 directory. If it exists already, the
    /// run is recorded into DIR_2, the next one into DIR_3, unless --force is given.
    #[arg(long, value_name = "DIR")]
    pub(crate) record: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) force: Force,
    /// Write messages as: cdr, json, cbor, protobuf, foxglove-protobuf, flatbuffers or foxglove-flatbuffers,
    /// instead of the encoding in the robot file's [record].
    #[arg(long, value_name = "ENCODING", requires = "record")]
    pub(crate) encoding: Option<Encoding>,
    /// Let this engine move the simulated world, instead of the robot file's: rapier, or mujoco if built with
    /// that feature.
    #[arg(long, value_name = "ENGINE")]
    pub(crate) physics: Option<String>,
    #[cfg(feature = "view")]
    #[command(flatten)]
    pub(crate) view: super::view::ViewArguments,
    /// The ROS domain, instead of ROS_DOMAIN_ID.
    #[arg(long, value_name = "N")]
    pub(crate) domain: Option<u16>,
    /// Use this engine instead of that of the robot file and of RMW_IMPLEMENTATION: rtps (DDS), or zenoh or
    /// rustdds if built with that feature.
    #[arg(long, value_name = "ENGINE")]
    pub(crate) engine: Option<Engine>,
    /// End with the process at the other end of standard input, which started this one.
    #[cfg(feature = "view")]
    #[arg(long, hide = true)]
    pub(crate) with_parent: bool,
    #[command(flatten)]
    pub(crate) parameters: ParameterArguments,
}

pub(crate) fn run(
    arguments: &RunArguments,
    catalog: &Catalog,
    ros: &RosArgs,
    screen: &Screen,
    log: &Log,
) -> anyhow::Result<()> {
    let record = arguments.record.as_deref().map(|path| arguments.force.next_run(path)).transpose()?;
    if let Some(directory) = &record {
        arguments.force.check(Output::Bag, directory)?;
    }
    let stop = Stop::new()?;
    #[cfg(feature = "view")]
    let stop = if arguments.with_parent { stop.with_parent(PATIENCE)? } else { stop };
    let mut file = arguments.parameters.read_robot(&arguments.robot, catalog, ros)?;
    if let Some(physics) = &arguments.physics {
        simulate_with(&mut file, physics)?;
    }
    file.expose.features.engine = arguments.engine.or(file.expose.features.engine);
    #[cfg(feature = "view")]
    arguments.view.apply(&mut file.view);
    // In simulated time the core ends by itself.
    let (mut robot, stop) = if arguments.fast {
        (WatchedRobot::simulated(file, arguments.duration)?, stop)
    } else {
        (WatchedRobot::new(file)?, stop.after(arguments.duration))
    };
    let options = ros.with_enclave(participant_options(arguments.domain)?);
    if let Err(error) = robot.prepared.expose(&options, Some(&log.of_node)) {
        // The error names only the first endpoint that is denied.
        #[cfg(feature = "security")]
        if let StartError::Middleware(_) | StartError::Node(_) | StartError::Expose(_) = error {
            let file = arguments.parameters.read_robot(&arguments.robot, catalog, ros)?;
            RobotReport::for_run(file, &options, log)?.map_or(Ok(()), |report| report.refuse_denied())?;
        }
        return Err(error.into());
    }
    if let Some(directory) = &record {
        let plan = RecordPlan::of_robot(directory, robot.prepared.file(), arguments.encoding);
        arguments.force.make_way(Output::Bag, directory, [])?;
        robot.prepared.record(plan)?;
    }
    #[cfg(feature = "view")]
    robot.prepared.view(Some(&log.of_node))?;
    robot.run(&stop, screen)
}

/// Sets the engine of the simulated world.
fn simulate_with(file: &mut RobotFile, physics: &str) -> anyhow::Result<()> {
    let simulates = |kind: &str| ["darwin_op_simulator", "humanoid_simulator"].contains(&kind);
    let simulators = file.modules.iter().filter(|module| simulates(module.kind.name()));
    let simulators: Vec<_> = simulators.map(|module| module.name.clone()).collect();
    anyhow::ensure!(
        !simulators.is_empty(),
        "--physics {physics}: no module of {} simulates a world",
        file.name
    );
    Ok(simulators
        .iter()
        .try_for_each(|name| file.set_from_argument(&format!("{name}.physics:={physics}")))?)
}

/// A robot whose state is shown on the screen while it runs.
pub(crate) struct WatchedRobot {
    pub(crate) prepared: PreparedRobot,
    statistics: Statistics,
    faults: Faults,
}

/// How long a robot may take to stop when the process that started it has ended.
#[cfg(any(feature = "football", feature = "view"))]
pub(crate) const PATIENCE: Duration = Duration::from_secs(20);

const REFRESH: Duration = Duration::from_millis(250);
const LOG_INTERVAL: Duration = Duration::from_secs(10);

impl WatchedRobot {
    pub(crate) fn new(file: RobotFile) -> anyhow::Result<Self> {
        Self::of(PreparedRobot::new(file)?)
    }

    fn simulated(file: RobotFile, duration: Option<Duration>) -> anyhow::Result<Self> {
        Self::of(PreparedRobot::simulated(file, duration)?)
    }

    fn of(mut prepared: PreparedRobot) -> anyhow::Result<Self> {
        let modules: Vec<_> = prepared.file().modules.iter().map(|module| module.name.clone()).collect();
        let statistics = Statistics::of(prepared.core().handle(), modules);
        let faults = Faults::watch(prepared.core())?;
        Ok(Self { prepared, statistics, faults })
    }

    /// Runs the robot until `stop`, then stops it and prints a report.
    pub(crate) fn run(mut self, stop: &Stop, screen: &Screen) -> anyhow::Result<()> {
        let topics = self.prepared.core().topics().cloned().collect();
        let Self { prepared, statistics, faults } = self;
        let robot = prepared.start()?;
        #[cfg(feature = "view")]
        print_urls(&robot);
        let name = |node: &RobotNode| format!("{}   domain {}", node.node().name(), node.domain());
        let title = robot.node().map_or_else(|| robot.file().name.clone(), name);
        let status = robot.node().map(|node| node.bridge().status());
        let mut block = StatusBlock::new(Sources {
            title: if robot.file().is_emulated() { format!("{title}   emulated") } else { title },
            topics,
            statistics: &statistics,
            bridge: status.as_ref(),
            recording: robot.recording(),
            faults: &faults,
        });
        let mut service = Service::of_process();
        service.ready();
        let (mut next_log, mut recording_fails) = (Instant::now() + LOG_INTERVAL, false);
        while !stop.is_due() && !robot.is_finished() {
            if screen.is_terminal() {
                screen.show(block.lines(screen.block_size()));
            } else if Instant::now() >= next_log {
                next_log += LOG_INTERVAL;
                tracing::info!("{}", block.line());
            }
            service.tend(robot.core(), || block.line());
            let failure =
                robot.recording().map(Recording::statistics).and_then(|recording| recording.failure);
            if let Some(failure) = failure.filter(|_| !recording_fails) {
                tracing::error!("the recording has stopped, the robot continues: {failure}");
                recording_fails = true;
            }
            stop.sleep(REFRESH);
        }
        service.stopping();
        screen.show(Vec::new());
        drop(block);
        match robot.stop() {
            Ok(summary) => report(&statistics, summary.as_ref()),
            Err(error) => {
                if matches!(error, StopError::Recording(_)) {
                    report(&statistics, None);
                }
                return Err(error.into());
            }
        }
        Ok(())
    }
}

/// Prints where viewers find the robot.
#[cfg(feature = "view")]
pub(super) fn print_urls(robot: &RunningRobot) {
    let Some(view) = robot.view() else { return };
    // Not into the log: that is published on /rosout, and the URLs hold the token.
    if let Some(url) = view.page_url() {
        eprintln!("open in a browser: {url}");
    }
    if let Some(url) = view.foxglove_url() {
        eprintln!("open in Foxglove, Lichtblick or PlotJuggler, as Foxglove WebSocket: {url}");
    }
}

fn report(statistics: &Statistics, summary: Option<&RecordingSummary>) {
    let collected = statistics.collected();
    tracing::info!("{} cycles: {}", collected.cycles, Times(collected.cycle));
    for known in &collected.loops {
        tracing::info!("{}: period {}; busy {}", known.module, Times(known.period), Times(known.busy));
    }
    report_recording(summary);
}

/// Says what was recorded.
pub(super) fn report_recording(summary: Option<&RecordingSummary>) {
    let Some(summary) = summary else { return };
    let (messages, lost) = (summary.message_count(), summary.lost_count());
    tracing::info!("recorded {messages} messages, lost {lost}, in {}", summary.path.display());
    for topic in summary.topics.iter().filter(|topic| topic.lost > 0) {
        tracing::warn!("{} messages of {} are not in the bag: the disk was too slow", topic.lost, topic.name);
    }
}
