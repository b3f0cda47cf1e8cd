//! The services of the recorder of rosbag2, and its event after each split.
//!
//! # References
//! `rosbag2_transport/recorder.cpp` and `rosbag2_interfaces`, branch jazzy.

use std::sync::Arc;

use downbeat_bags::{FileSplit, RecordingControl};
use downbeat_bridge::ros::{MessageType, Node, NodeError, Service};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rosbag2_interfaces::msg::WriteSplitEvent;
use downbeat_msgs::rosbag2_interfaces::srv::{
    IsDiscoveryRunning, IsDiscoveryRunningResponse, IsPaused, IsPausedResponse, Pause, PauseResponse, Record,
    RecordResponse, Resume, ResumeResponse, Snapshot, SnapshotResponse, SplitBagfile, SplitBagfileResponse,
    StartDiscovery, StartDiscoveryResponse, Stop, StopDiscovery, StopDiscoveryResponse, StopResponse,
    TogglePaused, TogglePausedResponse,
};
use downbeat_msgs::{Message, cdr};
use parking_lot::Mutex;

/// Why a recorder cannot be asked for anything.
#[derive(Debug, thiserror::Error)]
#[error("cannot offer the services of the recorder: {0}")]
pub struct ServeError(#[from] NodeError);

/// The recording that the services of a recorder act on: the current one, or the last. Clones share it.
#[derive(Clone)]
pub struct SteeredRecording {
    current: Arc<Mutex<RecordingControl>>,
}

impl SteeredRecording {
    /// The services act on this recording.
    #[must_use]
    pub fn new(control: RecordingControl) -> Self {
        Self { current: Arc::new(Mutex::new(control)) }
    }

    /// The services act on this recording from now on.
    pub fn replace(&self, control: RecordingControl) {
        *self.current.lock() = control;
    }

    /// The recording.
    #[must_use]
    pub fn control(&self) -> RecordingControl {
        self.current.lock().clone()
    }
}

/// The services of a recorder, until this is dropped.
pub struct RecorderServices {
    _services: Vec<Service>,
}

/// Offers `~/pause`, `~/resume`, `~/toggle_paused`, `~/is_paused`, `~/split_bagfile` and, where a recording
/// keeps messages for it, `~/snapshot`. A split and a snapshot are answered when they are done.
///
/// # Errors
/// If the middleware refuses a service.
pub fn serve(
    node: &Node,
    steered: &SteeredRecording,
    takes_snapshots: bool,
) -> Result<RecorderServices, ServeError> {
    let qos = QosProfile::SERVICES;
    let own = || steered.clone();
    let (pausing, resuming, toggling, asked, splitting) = (own(), own(), own(), own(), own());
    let mut services = vec![
        node.serve::<Pause>("~/pause", qos, move |_| {
            if pausing.control().pause() {
                tracing::info!("Pausing recording.");
            }
            PauseResponse::default()
        })?,
        node.serve::<Resume>("~/resume", qos, move |_| {
            if resuming.control().resume() {
                tracing::info!("Resuming recording.");
            }
            ResumeResponse::default()
        })?,
        node.serve::<TogglePaused>("~/toggle_paused", qos, move |_| {
            let is_paused = toggling.control().toggle_paused();
            tracing::info!("{} recording.", if is_paused { "Pausing" } else { "Resuming" });
            TogglePausedResponse::default()
        })?,
        node.serve::<IsPaused>("~/is_paused", qos, move |_| IsPausedResponse {
            paused: asked.control().is_paused(),
        })?,
        node.serve_later::<SplitBagfile>("~/split_bagfile", qos, move |_, reply| {
            splitting.control().split(move |result| {
                if let Err(error) = &result {
                    tracing::warn!("the bag is not split: {error}");
                }
                sent(reply.send(&SplitBagfileResponse::default()));
            });
        })?,
    ];
    if takes_snapshots {
        let steered = own();
        services.push(node.serve_later::<Snapshot>("~/snapshot", qos, move |_, reply| {
            steered.control().snapshot(move |result| {
                if let Err(error) = &result {
                    tracing::warn!("no snapshot is written: {error}");
                }
                sent(reply.send(&SnapshotResponse { success: result.is_ok() }));
            });
        })?);
    }
    Ok(RecorderServices { _services: services })
}

/// Offers `~/stop`, which stops the recording, and what the recorder of a robot refuses: `~/record`, since a
/// run has one bag, and the services of discovery, since the topics of a robot are known.
///
/// # Errors
/// If the middleware refuses a service.
pub fn serve_robot(node: &Node, steered: &SteeredRecording) -> Result<RecorderServices, ServeError> {
    let qos = QosProfile::SERVICES;
    let (stopping, asked) = (steered.clone(), steered.clone());
    let services = vec![
        node.serve::<Stop>("~/stop", qos, move |_| {
            stopping.control().stop();
            StopResponse::default()
        })?,
        node.serve::<Record>("~/record", qos, move |_| {
            let error_string = match asked.control().is_stopped() {
                false => "a recording is running already",
                true => "a robot records one bag in a run: start it again with --record for another",
            };
            RecordResponse { return_code: 1, error_string: error_string.to_owned() }
        })?,
        node.serve::<StartDiscovery>("~/start_discovery", qos, |_| StartDiscoveryResponse {
            return_code: 1,
            error_string:
                "a robot records its own topics, which [record] of its file selects: there is no discovery"
                    .to_owned(),
        })?,
        node.serve::<StopDiscovery>("~/stop_discovery", qos, |_| StopDiscoveryResponse {
            return_code: 1,
            error_string: "discovery is not running".to_owned(),
        })?,
        node.serve::<IsDiscoveryRunning>("~/is_discovery_running", qos, |_| IsDiscoveryRunningResponse {
            running: false,
        })?,
    ];
    Ok(RecorderServices { _services: services })
}

/// Publishes on `events/write_split` that a file was closed: for [`downbeat_bags::Writer::on_split`].
///
/// # Errors
/// If the middleware refuses the publisher.
pub fn split_events(node: &Node) -> Result<impl FnMut(&FileSplit) + Send + use<>, ServeError> {
    let message_type = MessageType::new(WriteSplitEvent::TYPE_NAME).map_err(NodeError::from)?;
    let qos = QosProfile::DEFAULT.keep_last(1);
    let publisher = node.publish("events/write_split", &message_type, qos)?;
    let node_name = node.name().to_string();
    Ok(move |split: &FileSplit| {
        let path = |path: &std::path::Path| path.display().to_string();
        let event = WriteSplitEvent {
            closed_file: path(&split.closed),
            opened_file: split.opened.as_deref().map(path).unwrap_or_default(),
            node_name: node_name.clone(),
        };
        if let Err(error) = publisher.publish(cdr::to_vec(&event).into()) {
            tracing::warn!("a split is not published on {}: {error}", publisher.topic());
        }
    })
}

fn sent(result: Result<(), impl std::fmt::Display>) {
    if let Err(error) = result {
        tracing::debug!("a reply was not sent: {error}");
    }
}
