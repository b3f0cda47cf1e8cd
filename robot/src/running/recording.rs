//! The recording of a running robot.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use downbeat_bags::{Recording, RecordingSender, RecordingStatistics, Writer, WriterError, WriterOptions};
use downbeat_bridge::diagnostics::ProcessDiagnostics;
use downbeat_bridge::expose::Exposure;
use downbeat_bridge::ros::{Node, NodeName};
use downbeat_edge::{CoreAccess, Interfaces, KnownType};
use downbeat_executor::{Clock, CoreHandle, Inbox, ModuleEvent, Outlet, OutletInbox, Received, TopicInfo};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticStatus, KeyValue};
use downbeat_msgs::encoding::Encoding;
use downbeat_msgs::qos::QosProfile;
use parking_lot::Mutex;

use super::StartError;
use super::snapshots::SnapshotWatch;
use crate::recorder::{self, RecorderError, Unrecorded, WhenFull};
use crate::ros_recorder::{
    RecorderServices, SteeredRecording, TopicFilter, serve, serve_robot, split_events,
};
use crate::{RecordOptions, RecordedSettings, Robot, RobotFile, SourcedModules, Sources, VersionLog};

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

/// The key in the metadata of bags that were recorded in simulated time: detached modules ran inside the
/// cycle.
pub(crate) const SIMULATED_TIME: &str = "simulated_time";

/// The key in the metadata of bags whose recording began while the robot ran: the time, in nanoseconds, from
/// which on all topics are in it.
pub(crate) const RECORDED_FROM: &str = "recorded_from";

/// What of a robot can be recorded, from the start or while it runs.
pub(super) struct Recordable {
    robot: String,
    /// Of `[record]` in the robot file; for recordings that the page starts.
    #[cfg_attr(not(feature = "view"), allow(dead_code))]
    pub(super) options: RecordOptions,
    /// What every bag says of the robot.
    custom_data: Vec<(&'static str, String)>,
    /// The modules in other languages: a bag says what they run when it begins.
    modules: SourcedModules,
    settings: RecordedSettings,
    filter: Option<TopicFilter>,
    interfaces: Interfaces,
    clock: Arc<dyn Clock>,
    known: Mutex<KnownTopics>,
}

/// The topics so far: modules may bring more while the robot runs.
#[derive(Default)]
struct KnownTopics {
    topics: Vec<TopicInfo>,
    /// The offered QoS of exposed topics.
    qos: BTreeMap<String, QosProfile>,
}

/// A recording that takes messages out of a core.
pub(super) struct Taking {
    recording: RecordingSender,
    encoding: Encoding,
    /// The names of the topics.
    taken: BTreeSet<Arc<str>>,
    /// Dropped after the core has stopped.
    outlets: Vec<Outlet>,
}

/// A bag that a recording of a robot begins.
pub(super) struct NewBag {
    directory: PathBuf,
    sources: Sources,
    versions: VersionLog,
    /// See [`RECORDED_FROM`].
    recorded_from: Arc<AtomicI64>,
}

impl Recordable {
    /// What the robot file's `[record]` names and the filter takes.
    pub(super) fn of(
        robot: &Robot,
        is_in_simulated_time: bool,
        filter: Option<TopicFilter>,
    ) -> Result<Self, StartError> {
        let file = &robot.file;
        let mut custom_data = vec![("robot", file.name.clone())];
        if file.is_emulated() {
            custom_data.push(("emulated", "true".to_owned()));
        }
        if is_in_simulated_time {
            custom_data.push((SIMULATED_TIME, "true".to_owned()));
        }
        let recordable = Self {
            robot: file.name.clone(),
            options: file.record.options.clone(),
            custom_data,
            modules: SourcedModules::of(file),
            settings: RecordedSettings::of(robot),
            filter,
            interfaces: file.catalog.interfaces.clone(),
            clock: robot.core.clock(),
            known: Mutex::default(),
        };
        recordable.extend(&robot.recorded_topics()?, &robot.exposed()?.topics);
        Ok(recordable)
    }

    /// Adds topics, and what is exposed of them.
    pub(super) fn extend(&self, topics: &[TopicInfo], exposed: &[Exposure]) {
        let mut known = self.known.lock();
        for topic in topics.iter().filter(|topic| self.takes(topic)) {
            if known.topics.iter().all(|other| other.name != topic.name) {
                known.topics.push(topic.clone());
            }
        }
        let qos = |exposure: &Exposure| Some((exposure.topic.clone(), exposure.qos.profile()?));
        known.qos.extend(exposed.iter().filter_map(qos));
    }

    fn takes(&self, topic: &TopicInfo) -> bool {
        let known = self.interfaces.message_in(topic);
        let type_name = known.map_or(topic.message_type, KnownType::name);
        let name = format!("/{}", topic.name);
        self.filter.as_ref().is_none_or(|filter| filter.takes_name_and_type(&name, type_name))
    }

    /// Creates the bag, which says what runs now and how it is set.
    pub(super) fn create(
        &self,
        core: &CoreAccess<'_>,
        directory: &Path,
        writer: WriterOptions,
    ) -> Result<(Writer, NewBag), WriterError> {
        let (sources, versions) = (self.modules.sources(), VersionLog::default());
        let recorded_from = Arc::new(AtomicI64::new(i64::MAX));
        let data = self.custom_data.iter().cloned().chain(sources.entries());
        let data = data.chain(self.settings.entry(|module| core.settings(module)));
        let mut writer = data.fold(writer, |writer, (key, value)| writer.custom_data(key, value));
        if !sources.is_empty() {
            writer = versions.note_in(writer);
        }
        if let CoreAccess::Running(_) = core {
            let from = Arc::clone(&recorded_from);
            writer = writer.counted_data(RECORDED_FROM, move || from.load(Ordering::Relaxed).to_string());
        }
        let unrecorded = Unrecorded::of(&self.known.lock().topics, &self.interfaces);
        unrecorded.warn();
        let writer = unrecorded.note(writer).create(directory)?;
        sources.keep_in(directory);
        tracing::info!("recording into {}", directory.display());
        Ok((writer, NewBag { directory: directory.to_owned(), sources, versions, recorded_from }))
    }

    /// Records while the returned value is there.
    pub(super) fn record(
        &self,
        core: &mut CoreAccess<'_>,
        recording: &Recording,
        encoding: Encoding,
        NewBag { directory, sources, versions, recorded_from }: NewBag,
    ) -> Result<Taking, RecorderError> {
        let recording = recording.sender();
        let mut taking = Taking { recording, encoding, taken: BTreeSet::new(), outlets: Vec::new() };
        if !sources.is_empty() {
            let inbox = OutletInbox::new("sources", Inbox::KeepAll);
            let keep = move |event: Received<'_, ModuleEvent>| versions.take(&event, &directory);
            taking.outlets.push(core.outlet(ModuleEvent::TOPIC, &inbox, keep)?);
        }
        self.record_more(core, &mut taking)?;
        recorded_from.store(self.clock.now().as_nanos(), Ordering::Relaxed);
        Ok(taking)
    }

    /// Records also the topics that were added since.
    pub(super) fn record_more(
        &self,
        core: &mut CoreAccess<'_>,
        taking: &mut Taking,
    ) -> Result<(), RecorderError> {
        let (topics, qos) = {
            let known = self.known.lock();
            let is_new = |topic: &&TopicInfo| !taking.taken.contains(&topic.name);
            (known.topics.iter().filter(is_new).cloned().collect::<Vec<_>>(), known.qos.clone())
        };
        let qos_of = |name: &str| qos.get(name).cloned().unwrap_or(QosProfile::DEFAULT);
        let Taking { recording, encoding, .. } = &*taking;
        let outlets = recorder::record_while(
            core,
            recording,
            &topics,
            WhenFull::Lose,
            *encoding,
            &self.interfaces,
            qos_of,
        )?;
        taking.outlets.extend(outlets);
        taking.taken.extend(topics.into_iter().map(|topic| topic.name));
        Ok(())
    }
}

/// A recording, and the services of ROS 2 that steer it.
pub(super) struct RobotRecording {
    pub(super) recording: Recording,
    pub(super) growing: Growing,
    /// Dropped after the recording has ended.
    pub(super) services: Option<[RecorderServices; 2]>,
    pub(super) _snapshots: SnapshotWatch,
}

/// A recording that takes in what modules bring while it runs. Clones are of the same recording.
#[derive(Clone)]
pub(super) struct Growing {
    recordable: Arc<Recordable>,
    taking: Arc<Mutex<Taking>>,
}

impl Growing {
    /// Takes in topics of the core that runs.
    pub(super) fn extend(
        &self,
        core: &CoreHandle,
        topics: &[TopicInfo],
        exposed: &[Exposure],
    ) -> Result<(), RecorderError> {
        self.recordable.extend(topics, exposed);
        self.recordable.record_more(&mut CoreAccess::Running(core), &mut self.taking.lock())
    }
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
        let RecordPlan { directory, options, filter } = plan;
        let writer = options.writer(true);
        let recording = options.recording(true);
        let RecordOptions { encoding, snapshot_triggers: triggers, .. } = options;
        let recordable = Recordable::of(robot, is_in_simulated_time, filter)?;
        let core = &mut CoreAccess::Idle(&mut robot.core);
        let (mut writer, bag) = recordable.create(core, &directory, writer)?;
        let node = node.map(recorder_node).transpose()?;
        let takes_snapshots = recording.takes_snapshots();
        match &node {
            Some(node) => writer.on_split(split_events(node)?),
            None if takes_snapshots && !triggers.are_some() => {
                tracing::warn!("no snapshot can be asked for without a ROS 2 node")
            }
            None => {}
        }
        let recording = Recording::start_with(writer, &recording)
            .map_err(|source| StartError::Thread { what: "the bag's writer", source })?;
        let steered = SteeredRecording::new(recording.control());
        let offer = |node: Node| -> Result<_, StartError> {
            Ok([serve(&node, &steered, takes_snapshots)?, serve_robot(&node, &steered)?])
        };
        let services = node.map(offer).transpose()?;
        if let Some(diagnostics) = diagnostics {
            let (sender, name) = (recording.sender(), format!("{}: recording", recordable.robot));
            diagnostics.watch(move || vec![status(&name, &sender.statistics())]);
        }
        let taking = Arc::new(Mutex::new(recordable.record(core, &recording, encoding, bag)?));
        let snapshots = SnapshotWatch::start(robot, &recording.control(), &triggers)?;
        let growing = Growing { recordable: Arc::new(recordable), taking };
        Ok(Self { recording, growing, services, _snapshots: snapshots })
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
