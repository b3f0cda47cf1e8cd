//! The recording of a running robot.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use downbeat_bags::{Recording, RecordingStatistics, Writer, WriterError, WriterOptions};
use downbeat_bridge::diagnostics::ProcessDiagnostics;
use downbeat_bridge::ros::{Node, NodeName};
use downbeat_edge::{CoreAccess, Interfaces, KnownType};
use downbeat_executor::{Inbox, ModuleEvent, ModuleEventKind, Outlet, OutletInbox, Received, TopicInfo};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticStatus, KeyValue};
use downbeat_msgs::encoding::Encoding;
use downbeat_msgs::qos::QosProfile;

use super::StartError;
use crate::recorder::{self, RecorderError, Unrecorded, WhenFull};
use crate::robot::{RecordOptions, Robot, RobotFile, Sources, Version, record_settings};
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

/// What of a robot can be recorded, from the start or while it runs.
pub(super) struct Recordable {
    robot: String,
    /// Of `[record]` in the robot file; for recordings that the page starts.
    #[cfg_attr(not(feature = "view"), allow(dead_code))]
    pub(super) options: RecordOptions,
    /// What the bag says of the robot.
    custom_data: Vec<(&'static str, String)>,
    /// What the modules in other languages started with.
    sources: Sources,
    topics: Vec<TopicInfo>,
    /// The offered QoS of exposed topics.
    qos: BTreeMap<String, QosProfile>,
    interfaces: Interfaces,
}

impl Recordable {
    /// What the robot file's `[record]` names.
    pub(super) fn of(robot: &Robot, is_in_simulated_time: bool) -> Result<Self, StartError> {
        let file = &robot.file;
        let mut custom_data = vec![("robot", file.name.clone())];
        if file.is_emulated() {
            custom_data.push(("emulated", "true".to_owned()));
        }
        let sources = Sources::of(file);
        custom_data.extend(sources.entries());
        custom_data.extend(record_settings(robot));
        if is_in_simulated_time {
            custom_data.push((SIMULATED_TIME, "true".to_owned()));
        }
        let exposed = robot.exposed()?.topics.into_iter();
        let qos =
            exposed.filter_map(|exposure| Some((exposure.topic.clone(), exposure.qos.profile()?))).collect();
        Ok(Self {
            robot: file.name.clone(),
            options: file.record.options.clone(),
            custom_data,
            sources,
            topics: robot.recorded_topics()?,
            qos,
            interfaces: file.catalog.interfaces.clone(),
        })
    }

    /// Leaves out what the filter does not take.
    fn retain(&mut self, filter: &TopicFilter) {
        let interfaces = &self.interfaces;
        self.topics.retain(|topic| {
            let known = interfaces.message_in(topic);
            let type_name = known.map_or(topic.message_type, KnownType::name);
            filter.takes_name_and_type(&format!("/{}", topic.name), type_name)
        });
    }

    /// Creates the bag.
    pub(super) fn create(&self, directory: &Path, writer: WriterOptions) -> Result<Writer, WriterError> {
        let data = self.custom_data.iter();
        let writer = data.fold(writer, |writer, (key, value)| writer.custom_data(*key, value.clone()));
        let unrecorded = Unrecorded::of(&self.topics, &self.interfaces);
        unrecorded.warn();
        let writer = unrecorded.note(writer).create(directory)?;
        self.sources.keep_in(directory);
        tracing::info!("recording into {}", directory.display());
        Ok(writer)
    }

    /// Records while the returned outlets are there.
    pub(super) fn record(
        &self,
        core: &mut CoreAccess<'_>,
        recording: &Recording,
        encoding: Encoding,
        directory: &Path,
    ) -> Result<Vec<Outlet>, RecorderError> {
        let qos_of = |name: &str| self.qos.get(name).cloned().unwrap_or(QosProfile::DEFAULT);
        let mut outlets = recorder::record_while(
            core,
            recording,
            &self.topics,
            WhenFull::Lose,
            encoding,
            &self.interfaces,
            qos_of,
        )?;
        // Versions of which the bag holds only the hash.
        if !self.sources.are_copied() {
            return Ok(outlets);
        }
        let (directory, inbox) = (directory.to_owned(), OutletInbox::new("sources", Inbox::KeepAll));
        let keep = move |event: Received<'_, ModuleEvent>| {
            if let ModuleEventKind::Made { description, .. } = &event.kind
                && let Ok(version) = serde_json::from_slice::<Version>(description)
            {
                version.keep_in(&directory);
            }
        };
        outlets.push(core.outlet(ModuleEvent::TOPIC, &inbox, keep)?);
        Ok(outlets)
    }
}

/// A recording, and the services of ROS 2 that steer it.
pub(super) struct RobotRecording {
    pub(super) recording: Recording,
    /// Dropped after the core has stopped.
    _outlets: Vec<Outlet>,
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
        let RecordPlan { directory, options: RecordOptions { encoding, writer, recording }, filter } = plan;
        let mut recordable = Recordable::of(robot, is_in_simulated_time)?;
        if let Some(filter) = filter {
            recordable.retain(&filter);
        }
        let mut writer = recordable.create(&directory, writer)?;
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
        if let Some(diagnostics) = diagnostics {
            let (sender, name) = (recording.sender(), format!("{}: recording", recordable.robot));
            diagnostics.watch(move || vec![status(&name, &sender.statistics())]);
        }
        let outlets =
            recordable.record(&mut CoreAccess::Idle(&mut robot.core), &recording, encoding, &directory)?;
        Ok(Self { recording, _outlets: outlets, services })
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
