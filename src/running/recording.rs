//! The recording of a running robot.

use std::path::{Path, PathBuf};

use downbeat_bags::{Recording, RecordingStatistics};
use downbeat_bridge::diagnostics::ProcessDiagnostics;
use downbeat_bridge::ros::{Node, NodeName};
use downbeat_edge::KnownType;
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticStatus, KeyValue};
use downbeat_msgs::encoding::Encoding;
use downbeat_msgs::qos::QosProfile;

use super::StartError;
use crate::recorder::{self, Unrecorded, WhenFull};
use crate::robot::{RecordOptions, Robot, RobotFile, Sources};
use crate::ros_recorder::{RecorderServices, TopicFilter, serve, split_events};

/// Options of a recording.
pub struct RecordPlan {
    /// The new rosbag2 directory.
    pub directory: PathBuf,
    /// Options of its files, of the queue between the robot and the files, and the serialization.
    pub options: RecordOptions,
    /// Which of the topics that the robot file names; all if `None`.
    pub filter: Option<TopicFilter>,
}

impl RecordPlan {
    /// As the robot file says, but for the encoding if another is asked for.
    #[must_use]
    pub fn of_robot(directory: &Path, file: &RobotFile, encoding: Option<Encoding>) -> Self {
        let mut options = file.record.options.clone();
        options.encoding = encoding.unwrap_or(options.encoding);
        Self { directory: directory.to_owned(), options, filter: None }
    }
}

/// The key in the metadata of bags that were recorded in simulated time: detached modules ran inside the cycle.
pub(crate) const SIMULATED_TIME: &str = "simulated_time";

/// A recording, and the services of ROS 2 that steer it.
pub(super) struct RobotRecording {
    pub(super) recording: Recording,
    /// Dropped after the recording has ended.
    pub(super) services: Option<RecorderServices>,
}

impl RobotRecording {
    /// Records what the robot file's `[record]` names, and of that what the plan's filter takes.
    pub(super) fn start(
        robot: &mut Robot,
        node: Option<&Node>,
        diagnostics: Option<&ProcessDiagnostics>,
        is_in_simulated_time: bool,
        plan: RecordPlan,
    ) -> Result<Self, StartError> {
        let RecordPlan { directory, options: RecordOptions { encoding, mut writer, recording }, filter } =
            plan;
        let mut topics = robot.recorded_topics()?;
        if let Some(filter) = filter {
            topics.retain(|topic| {
                let known = robot.file.catalog.interfaces.message_of(topic.message_type_id);
                let type_name = known.map_or(topic.message_type, KnownType::name);
                filter.takes_name_and_type(&format!("/{}", topic.name), type_name)
            });
        }
        if robot.file.is_emulated() {
            writer = writer.custom_data("emulated", "true");
        }
        if let Some((key, sources)) = Sources::of(&robot.file).entry() {
            writer = writer.custom_data(key, sources);
        }
        if is_in_simulated_time {
            writer = writer.custom_data(SIMULATED_TIME, "true");
        }
        let unrecorded = Unrecorded::of(&topics, &robot.file.catalog.interfaces);
        unrecorded.warn();
        let writer = unrecorded.note(writer.custom_data("robot", robot.file.name.clone()));
        let mut writer = writer.create(&directory)?;
        let node = node.map(recorder_node).transpose()?;
        let takes_snapshots = recording.takes_snapshots();
        match &node {
            Some(node) => writer.on_split(split_events(node)?),
            None if takes_snapshots => tracing::warn!("no snapshot can be asked for without a ROS 2 node"),
            None => {}
        }
        let recording = Recording::start_with(writer, &recording)
            .map_err(|source| StartError::Thread { what: "the bag's writer", source })?;
        let services = node.map(|node| serve(&node, &recording.control(), takes_snapshots)).transpose()?;
        let exposed = robot.exposed()?.topics;
        let qos_of = |name: &str| {
            let exposure = exposed.iter().find(|exposure| exposure.topic == name);
            exposure.and_then(|exposure| exposure.qos.profile()).unwrap_or(QosProfile::DEFAULT)
        };
        if let Some(diagnostics) = diagnostics {
            let (sender, name) = (recording.sender(), format!("{}: recording", robot.file.name));
            diagnostics.watch(move || vec![status(&name, &sender.statistics())]);
        }
        let Robot { file, core } = robot;
        let interfaces = &file.catalog.interfaces;
        recorder::record(core, &recording, &topics, WhenFull::Lose, encoding, interfaces, qos_of)?;
        tracing::info!("recording into {}", directory.display());
        Ok(Self { recording, services })
    }
}

/// The node that offers what the recorder of rosbag2 does, beside the robot's.
fn recorder_node(robot: &Node) -> Result<Node, StartError> {
    let name = NodeName::new(robot.name().namespace(), "rosbag2_recorder");
    Ok(robot.sibling(&name.map_err(downbeat_bridge::ros::NodeError::from)?)?)
}

fn status(name: &str, statistics: &RecordingStatistics) -> DiagnosticStatus {
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
