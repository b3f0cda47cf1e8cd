//! A robot while it runs: its core on a thread, the bridge and the recorder beside it, the status on the screen.

use std::path::Path;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use downbeat::bags::{Compression, Recording, RecordingSummary, WriterOptions};
use downbeat::bridge::expose::{self, BridgeStatus};
use downbeat::bridge::middleware::{self, ParticipantOptions};
use downbeat::bridge::ros::Participant;
use downbeat::executor::{Core, RunError};
use downbeat::inspect::{InspectionServer, SocketDirectory};
use downbeat::msgs::encoding::Encoding;
use downbeat::msgs::qos::QosProfile;
use downbeat::recorder::{self, WhenFull};
use downbeat::robot::{Robot, RobotFile};

use super::faults::Faults;
use super::inspected::InspectedRobot;
use super::screen::Screen;
use super::statistics::Statistics;
use super::status::{Sources, StatusBlock};
use super::stop::Stop;

/// A robot ready to run, with all that watches it.
pub(crate) struct Session {
    robot: Robot,
    statistics: Arc<Statistics>,
    faults: Faults,
    bridge: Option<Bridge>,
    recording: Option<Recording>,
}

struct Bridge {
    status: BridgeStatus,
    title: String,
    /// Its node is in the graph of ROS 2 until it is dropped.
    /// Answered until it is dropped.
    _parameters: Option<expose::ParameterServices>,
    bridge: expose::Bridge,
}

const REFRESH: Duration = Duration::from_millis(250);
const LOG_INTERVAL: Duration = Duration::from_secs(10);

impl Session {
    pub(crate) fn new(file: RobotFile) -> anyhow::Result<Self> {
        let statistics = Arc::new(Statistics::default());
        let core = Core::new().with_probe(Arc::clone(&statistics) as _);
        let mut robot = file.build(core)?;
        let faults = Faults::watch(&mut robot.core)?;
        Ok(Self { robot, statistics, faults, bridge: None, recording: None })
    }

    /// Shows to ROS 2 what the robot file exposes.
    pub(crate) fn expose(&mut self, options: &ParticipantOptions) -> anyhow::Result<()> {
        let Robot { file, .. } = &self.robot;
        let exposures = self.robot.exposures()?;
        let participant = Participant::join_with(options, file.remaps.clone())?;
        let node = participant.create_node(file.given_node_name()?)?;
        let title = format!("{}   domain {}", node.name(), options.domain_id);
        let bridge = expose::Bridge::start(&mut self.robot.core, &node, &exposures)?;
        for endpoint in bridge.status().endpoints() {
            let arrow = match endpoint.direction {
                middleware::Direction::Out => "to ROS 2",
                middleware::Direction::In => "from ROS 2",
            };
            tracing::info!("exposed {arrow}: {} [{}]", endpoint.ros_topic, endpoint.type_name);
        }
        let (offered, called) = (self.robot.service_exposures()?, self.robot.call_exposures()?);
        let services = expose::expose_services(&mut self.robot.core, &node, &offered, &called)?;
        for (name, ..) in services.services() {
            tracing::info!("exposed service: {name}");
        }
        let parameters = self.robot.parameter_exposure()?;
        let parameters =
            parameters.map(|exposure| expose::expose_parameters(&self.robot.core, &node, exposure));
        let parameters = parameters.transpose()?;
        self.bridge = Some(Bridge { status: bridge.status(), title, _parameters: parameters, bridge });
        Ok(())
    }

    /// Records what the robot file's `[record]` names, with its compression and encoding unless others are asked for.
    pub(crate) fn record(
        &mut self,
        directory: &Path,
        compression: Option<Compression>,
        encoding: Option<Encoding>,
    ) -> anyhow::Result<()> {
        let file = &self.robot.file;
        let mut options = WriterOptions::new().compression(compression.unwrap_or(file.record.compression));
        if file.is_emulated() {
            options = options.custom_data("emulated", "true");
        }
        let writer = options.custom_data("robot", file.name.clone()).create(directory)?;
        let recording = Recording::start(writer, Recording::DEFAULT_QUEUE_BYTES)
            .context("cannot start the thread that writes the bag")?;
        let topics = self.robot.recorded_topics()?;
        let exposed = self.robot.exposures()?;
        let qos_of = |name: &str| {
            let exposure = exposed.iter().find(|exposure| exposure.topic == name);
            exposure.and_then(|exposure| exposure.qos.profile()).unwrap_or(QosProfile::DEFAULT)
        };
        let encoding = encoding.unwrap_or(file.record.encoding);
        recorder::record(&mut self.robot.core, &recording, &topics, WhenFull::Lose, encoding, qos_of)?;
        tracing::info!("recording into {}", directory.display());
        self.recording = Some(recording);
        Ok(())
    }

    /// Runs the robot until `stop`, then stops it and tells how it went.
    pub(crate) fn run(self, stop: &Stop, screen: &Screen) -> anyhow::Result<()> {
        let topics = self.robot.core.topics().cloned().collect();
        let Self { robot: Robot { file, mut core }, statistics, faults, bridge, recording } = self;
        let handle = core.handle();
        let core: JoinHandle<Result<(), RunError>> = std::thread::Builder::new()
            .name("core".into())
            .spawn(move || core.run())
            .context("cannot start the thread of the core")?;
        let file = Arc::new(file);
        let inspected = InspectedRobot {
            core: handle.clone(),
            bridge: bridge.as_ref().map(|bridge| bridge.bridge.clone()),
            file: Arc::clone(&file),
        };
        let inspection = inspection(&file.name, inspected);
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
        let summary = recording.map(Recording::finish).transpose();
        if let Some(bridge) = bridge {
            // Off the graph before the last lines, which may be what a script waits for.
            drop(bridge);
        }
        tell(&statistics, summary.as_ref().ok().and_then(Option::as_ref));
        summary.map(drop).context("the recording is not complete")
    }
}

/// A robot that nobody can look at runs all the same.
fn inspection(name: &str, robot: InspectedRobot) -> Option<InspectionServer> {
    let open = || -> anyhow::Result<_> {
        Ok(InspectionServer::start(&SocketDirectory::open()?, name, Arc::new(robot))?)
    };
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
