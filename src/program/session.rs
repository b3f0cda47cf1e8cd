//! A robot while it runs: its core on a thread, the bridge and the recorder beside it, the status on the screen.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::bags::{Recording, RecordingOptions, RecordingStatistics, RecordingSummary, WriterOptions};
use crate::bridge::clock::{self, NodeClock, SimTime};
use crate::bridge::diagnostics::ProcessDiagnostics;
use crate::bridge::edge::KnownType;
use crate::bridge::expose::{self, BridgeStatus, ParameterExposure, ParameterServer};
use crate::bridge::lifecycle::{LifecycleExposure, LifecycleNodes, expose_lifecycle};
use crate::bridge::middleware::{self, ParticipantOptions};
use crate::bridge::network::NetworkWatch;
use crate::bridge::robot_description::RobotDescription;
use crate::bridge::ros::{Furnishing, Node, NodeName, Participant};
use crate::bridge::rosout::{LoggerServices, Rosout, RosoutPublisher};
use crate::executor::{Core, RunError};
use crate::inspect::{InspectionServer, SocketDirectory};
use crate::msgs::diagnostic_msgs::msg::{DiagnosticStatus, KeyValue};
use crate::msgs::encoding::Encoding;
use crate::msgs::qos::QosProfile;
use crate::recorder::{self, WhenFull};
use crate::robot::{ClockChoice, Robot, RobotFile};
use crate::ros_recorder::{RecorderServices, TopicFilter, serve, split_events};
use anyhow::{Context, anyhow};

use super::expose_service::ExposeService;
use super::faults::Faults;
use super::inspected::InspectedRobot;
use super::logging::Log;
use super::screen::Screen;
use super::statistics::Statistics;
use super::status::{Sources, StatusBlock};
use super::stop::Stop;

/// What to record, and how.
pub(crate) struct RecordPlan {
    pub(crate) directory: PathBuf,
    pub(crate) writer: WriterOptions,
    pub(crate) recording: RecordingOptions,
    pub(crate) encoding: Encoding,
    /// Which of the topics that the robot file names.
    pub(crate) filter: Option<TopicFilter>,
}

impl RecordPlan {
    /// As the robot file says, but for the encoding if another is asked for.
    pub(crate) fn of_robot(directory: &Path, file: &RobotFile, encoding: Option<Encoding>) -> Self {
        Self {
            directory: directory.to_owned(),
            writer: file.record.writer_options(),
            recording: file.record.recording_options(),
            encoding: encoding.unwrap_or(file.record.encoding),
            filter: None,
        }
    }
}

/// A robot ready to run, with all that watches it.
pub(crate) struct Session {
    robot: Robot,
    statistics: Arc<Statistics>,
    faults: Faults,
    clock: NodeClock,
    diagnostics: Option<ProcessDiagnostics>,
    bridge: Option<Bridge>,
    recording: Option<Recording>,
    /// By which ROS 2 steers the recording, until they are dropped.
    recorder_services: Option<RecorderServices>,
}

struct Bridge {
    status: BridgeStatus,
    title: String,
    /// The robot's.
    node: Node,
    _sim_time: Option<SimTime>,
    _description: Option<RobotDescription>,
    /// Dropped before the node, so that the last lines are sent.
    _rosout: Option<RosoutPublisher>,
    _logger_services: Option<LoggerServices>,
    /// Answered until they are dropped.
    _parameters: expose::ParameterServices,
    _lifecycle: LifecycleNodes,
    _network: Option<NetworkWatch>,
    _furnishing: Furnishing,
    /// Its node is in the graph of ROS 2 until it is dropped.
    bridge: expose::Bridge,
}

const REFRESH: Duration = Duration::from_millis(250);
const LOG_INTERVAL: Duration = Duration::from_secs(10);

impl Session {
    pub(crate) fn new(file: RobotFile) -> anyhow::Result<Self> {
        let statistics = Arc::new(Statistics::of(file.modules.iter().map(|module| module.name.clone())));
        let clock = NodeClock::default();
        let mut core = Core::new().with_probe(Arc::clone(&statistics) as _).with_clock(clock.clone());
        let diagnostics = add_diagnostics(&mut core, &file)?;
        let mut robot = file.build(core)?;
        let faults = Faults::watch(&mut robot.core)?;
        Ok(Self {
            robot,
            statistics,
            faults,
            clock,
            diagnostics,
            bridge: None,
            recording: None,
            recorder_services: None,
        })
    }

    /// Shows to ROS 2 what the robot file exposes.
    pub(crate) fn expose(&mut self, options: &ParticipantOptions, log: &Log) -> anyhow::Result<()> {
        let Robot { file, .. } = &self.robot;
        let exposed = self.robot.exposed()?;
        let participant = Participant::join_with(options, file.remaps.clone())?;
        let node = participant.create_node(file.given_node_name()?)?;
        let title = format!("{}   domain {}", node.name(), options.domain_id);
        let features = &file.expose.features;
        log.names.set_node(node.name());
        let rosout = if features.rosout && !file.is_rosout_disabled {
            Some(log.rosout.publish(&node)?)
        } else {
            log.rosout.turn_off();
            None
        };
        let logger_services = features.logger_service.then(|| log.levels.serve(&node)).transpose()?;
        let urdf = file.robot_description()?;
        let description = urdf.map(|urdf| RobotDescription::publish(&node, &urdf)).transpose()?;
        let has_network = features.network;
        if let ClockChoice::Publish(period) = features.clock {
            clock::publish(&mut self.robot.core, &node, period)?;
        }
        let network = has_network.then(|| NetworkWatch::start(&mut self.robot.core, &participant));
        let network = network.transpose()?;
        let sim_time = self.sim_time(&node)?;
        let parameters = ParameterServer::start(&self.robot.core, sim_time.clone())
            .context("cannot start the thread of the parameters")?;
        let of_robot = parameters.serve(&node, self.robot.parameter_exposure()?)?;
        let furnishing =
            self.furnish(&participant, parameters, rosout.is_some().then(|| log.rosout.clone()))?;
        let managed = self.robot.lifecycle_exposures()?;
        let lifecycle = expose_lifecycle(&self.robot.core, &participant, &managed)?;
        for (LifecycleExposure { module, .. }, node) in managed.iter().zip(lifecycle.nodes()) {
            log.names.set_module(module, node.name());
            tracing::info!("exposed lifecycle: {}", node.name());
        }
        let bridge = expose::Bridge::start(&mut self.robot.core, &node, &exposed.topics)?;
        if let Some(diagnostics) = &self.diagnostics {
            diagnostics.watch_endpoints(bridge.status());
        }
        for endpoint in bridge.status().endpoints() {
            let arrow = match endpoint.direction {
                middleware::Direction::Out => "to ROS 2",
                middleware::Direction::In => "from ROS 2",
            };
            tracing::info!("exposed {arrow}: {} [{}]", endpoint.ros_topic, endpoint.type_name);
        }
        let introspection = self.robot.file.expose.introspection;
        let services = expose::expose_services_with(
            &mut self.robot.core,
            &node,
            &exposed.services,
            &exposed.calls,
            introspection,
        )?;
        for (name, ..) in services.services() {
            tracing::info!("exposed service: {name}");
        }
        self.bridge = Some(Bridge {
            status: bridge.status(),
            title,
            node: node.clone(),
            _sim_time: sim_time,
            _description: description,
            _rosout: rosout,
            _logger_services: logger_services,
            _parameters: of_robot,
            _lifecycle: lifecycle,
            _network: network,
            _furnishing: furnishing,
            bridge,
        });
        Ok(())
    }

    /// Gives the other nodes that the robot file names what every node has, parameters and `/rosout`, and to those that stand
    /// for a module its settings and its lines.
    fn furnish(
        &self,
        participant: &Participant,
        parameters: ParameterServer,
        rosout: Option<Rosout>,
    ) -> anyhow::Result<Furnishing> {
        let (file, settings) = (&self.robot.file, self.robot.parameter_exposure()?.settings);
        let module = |exposure: LifecycleExposure| Ok((file.remaps.node(&exposure.node)?, exposure.module));
        let modules = self.robot.lifecycle_exposures()?.into_iter().map(module);
        let modules: BTreeMap<_, _> = modules.collect::<anyhow::Result<_>>()?;
        Ok(participant.furnish(move |node| {
            let module = modules.get(node.name());
            if let Some(rosout) = &rosout {
                node.attach(rosout.publish_also(node, module.map(String::as_str))?);
            }
            let exposure = module.map_or_else(ParameterExposure::default, |module| ParameterExposure {
                settings: settings.clone(),
                of_module: Some(module.clone()),
            });
            node.attach(parameters.serve(node, exposure)?);
            Ok(())
        }))
    }

    /// What `use_sim_time` sets, unless others follow the time of this robot.
    fn sim_time(&self, node: &Node) -> anyhow::Result<Option<SimTime>> {
        let choice = self.robot.file.expose.features.clock;
        if matches!(choice, ClockChoice::Publish(_)) {
            return Ok(None);
        }
        let sim_time = self.clock.sim_time(node, &self.robot.core.handle());
        sim_time.set(choice == ClockChoice::Follow)?;
        Ok(Some(sim_time))
    }

    /// What the robot file says.
    pub(crate) fn file(&self) -> &RobotFile {
        &self.robot.file
    }

    /// Records what the robot file's `[record]` names, and of that what the plan's filter takes.
    pub(crate) fn record(&mut self, plan: RecordPlan) -> anyhow::Result<()> {
        let RecordPlan { directory, mut writer, recording, encoding, filter } = plan;
        let file = &self.robot.file;
        let mut topics = self.robot.recorded_topics()?;
        if let Some(filter) = filter {
            topics.retain(|topic| {
                let known = KnownType::of_rust_type(topic.message_type_id);
                known.is_some_and(|known| {
                    filter.takes_name_and_type(&format!("/{}", topic.name), known.name())
                })
            });
        }
        if file.is_emulated() {
            writer = writer.custom_data("emulated", "true");
        }
        let mut writer = writer.custom_data("robot", file.name.clone()).create(&directory)?;
        let node = self.bridge.as_ref().map(|bridge| recorder_node(&bridge.node)).transpose()?;
        let takes_snapshots = recording.takes_snapshots();
        match &node {
            Some(node) => writer.on_split(split_events(node)?),
            None if takes_snapshots => tracing::warn!("no snapshot can be asked for without a ROS 2 node"),
            None => {}
        }
        let recording = Recording::start_with(writer, &recording)
            .context("cannot start the thread that writes the bag")?;
        let services = node.map(|node| serve(&node, &recording.control(), takes_snapshots));
        self.recorder_services = services.transpose()?;
        let exposed = self.robot.exposed()?.topics;
        let qos_of = |name: &str| {
            let exposure = exposed.iter().find(|exposure| exposure.topic == name);
            exposure.and_then(|exposure| exposure.qos.profile()).unwrap_or(QosProfile::DEFAULT)
        };
        if let Some(diagnostics) = &self.diagnostics {
            let (sender, name) = (recording.sender(), format!("{}: recording", file.name));
            diagnostics.watch(move || vec![recording_status(&name, &sender.statistics())]);
        }
        recorder::record(&mut self.robot.core, &recording, &topics, WhenFull::Lose, encoding, qos_of)?;
        tracing::info!("recording into {}", directory.display());
        self.recording = Some(recording);
        Ok(())
    }

    /// Runs the robot until `stop`, then stops it and tells how it went.
    pub(crate) fn run(self, stop: &Stop, screen: &Screen) -> anyhow::Result<()> {
        let topics = self.robot.core.topics().cloned().collect();
        let Self {
            robot: Robot { file, mut core },
            statistics,
            faults,
            bridge,
            recording,
            recorder_services,
            ..
        } = self;
        let handle = core.handle();
        let core: JoinHandle<Result<(), RunError>> = std::thread::Builder::new()
            .name("core".into())
            .spawn(move || core.run())
            .context("cannot start the thread of the core")?;
        let file = Arc::new(file);
        let inspected = Arc::new(InspectedRobot {
            core: handle.clone(),
            bridge: bridge.as_ref().map(|bridge| bridge.bridge.clone()),
            file: Arc::clone(&file),
        });
        let inspection = inspection(&file.name, Arc::clone(&inspected));
        let node = bridge.as_ref().map(|bridge| bridge.bridge.node());
        let expose_service = node.filter(|_| file.expose.features.expose_service);
        let expose_service = expose_service.and_then(|node| {
            let started = ExposeService::start(node, inspected);
            started.inspect_err(|error| tracing::error!("~/expose is not offered: {error:#}")).ok()
        });
        let title = bridge.as_ref().map_or_else(|| file.name.clone(), |bridge| bridge.title.clone());
        let mut block = StatusBlock::new(Sources {
            title: if file.is_emulated() { format!("{title}   emulated") } else { title },
            topics,
            statistics: &statistics,
            bridge: bridge.as_ref().map(|bridge| &bridge.status),
            recording: recording.as_ref(),
            faults: &faults,
        });
        let (mut next_log, mut recording_fails) = (Instant::now() + LOG_INTERVAL, false);
        while !stop.is_due() && !core.is_finished() {
            if screen.is_terminal() {
                screen.show(block.lines());
            } else if Instant::now() >= next_log {
                next_log += LOG_INTERVAL;
                tracing::info!("{}", block.line());
            }
            let failure = recording.as_ref().and_then(|recording| recording.statistics().failure);
            if let Some(failure) = failure.filter(|_| !recording_fails) {
                tracing::error!("the recording has stopped, the robot goes on: {failure}");
                recording_fails = true;
            }
            stop.sleep(REFRESH);
        }
        screen.show(Vec::new());
        handle.stop();
        core.join().map_err(|_| anyhow!("the core's thread panicked"))??;
        drop(inspection);
        drop(expose_service);
        let summary = recording.map(Recording::finish).transpose();
        drop(recorder_services);
        // Off the graph before the last lines, which may be what a script waits for.
        drop(bridge);
        tell(&statistics, summary.as_ref().ok().and_then(Option::as_ref));
        summary.map(drop).context("the recording is not complete")
    }
}

/// The node that offers what the recorder of rosbag2 does, beside the robot's.
fn recorder_node(robot: &Node) -> anyhow::Result<Node> {
    Ok(robot.sibling(&NodeName::new(robot.name().namespace(), "rosbag2_recorder")?)?)
}

/// The process tells of itself, unless the robot file says otherwise. Before the robot's modules, so that its topic is there when
/// what is exposed is looked up.
pub(crate) fn add_diagnostics(
    core: &mut Core,
    file: &RobotFile,
) -> anyhow::Result<Option<ProcessDiagnostics>> {
    let add = || ProcessDiagnostics::add(core, &file.name);
    Ok(file.expose.features.diagnostics.then(add).transpose()?)
}

fn recording_status(name: &str, statistics: &RecordingStatistics) -> DiagnosticStatus {
    let lost = statistics.summary.lost_count();
    let (level, message) = match &statistics.failure {
        Some(failure) => (DiagnosticStatus::ERROR, format!("stopped: {failure}")),
        None if lost > 0 => (DiagnosticStatus::WARN, format!("{lost} messages lost, the disk is too slow")),
        None => (DiagnosticStatus::OK, "recording".to_owned()),
    };
    let value = |key: &str, value: String| KeyValue { key: key.to_owned(), value };
    DiagnosticStatus {
        level,
        name: name.to_owned(),
        message,
        values: vec![
            value("bag", statistics.summary.path.display().to_string()),
            value("messages", statistics.summary.message_count().to_string()),
            value("messages lost", lost.to_string()),
            value("bytes", statistics.summary.bytes.to_string()),
            value("bytes waiting", statistics.queued_bytes.to_string()),
        ],
        ..DiagnosticStatus::default()
    }
}

/// A robot that nobody can look at runs all the same.
fn inspection(name: &str, robot: Arc<InspectedRobot>) -> Option<InspectionServer> {
    let open =
        || -> anyhow::Result<_> { Ok(InspectionServer::start(&SocketDirectory::open()?, name, robot)?) };
    open().inspect_err(|error| tracing::warn!("`downbeat top` will not see this robot: {error}")).ok()
}

fn tell(statistics: &Statistics, summary: Option<&RecordingSummary>) {
    let collected = statistics.collected();
    tracing::info!("{} cycles: {}", collected.cycles, collected.cycle);
    for (module, times) in &collected.detached {
        tracing::info!("{module}: period {}; busy {}", times.period, times.busy);
    }
    let Some(summary) = summary else { return };
    let (messages, lost) = (summary.message_count(), summary.lost_count());
    tracing::info!("recorded {messages} messages, lost {lost}, in {}", summary.path.display());
    for topic in summary.topics.iter().filter(|topic| topic.lost > 0) {
        tracing::warn!("{} messages of {} are not in the bag: the disk was too slow", topic.lost, topic.name);
    }
}
