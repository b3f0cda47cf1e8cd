//! The services of the recorder of rosbag2, and its event after each split.
//!
//! # References
//! `rosbag2_transport/recorder.cpp` and `rosbag2_interfaces`, branch jazzy.

use downbeat_bags::{FileSplit, RecordingControl};
use downbeat_bridge::ros::{MessageType, Node, NodeError, Service};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rosbag2_interfaces::msg::WriteSplitEvent;
use downbeat_msgs::rosbag2_interfaces::srv::{
    IsPaused, IsPausedResponse, Pause, PauseResponse, Resume, ResumeResponse, Snapshot, SnapshotResponse,
    SplitBagfile, SplitBagfileResponse, Stop, StopResponse,
};
use downbeat_msgs::{Message, cdr};

/// Why a recorder cannot be asked for anything.
#[derive(Debug, thiserror::Error)]
#[error("cannot offer the services of the recorder: {0}")]
pub struct ServeError(#[from] NodeError);

/// The services of a recorder, until this is dropped.
pub struct RecorderServices {
    _services: Vec<Service>,
}

/// Offers `~/pause`, `~/resume`, `~/is_paused`, `~/split_bagfile`, `~/stop` and, where a recording keeps
/// messages for it, `~/snapshot`. A split and a snapshot are answered when they are done.
///
/// # Errors
/// If the middleware refuses a service.
pub fn serve(
    node: &Node,
    control: &RecordingControl,
    takes_snapshots: bool,
) -> Result<RecorderServices, ServeError> {
    let qos = QosProfile::SERVICES;
    let own = || control.clone();
    let (pausing, resuming, asked, splitting, stopping) = (own(), own(), own(), own(), own());
    let mut services = vec![
        node.serve::<Pause>("~/pause", qos, move |_| {
            if pausing.pause() {
                tracing::info!("Pausing recording.");
            }
            PauseResponse::default()
        })?,
        node.serve::<Resume>("~/resume", qos, move |_| {
            if resuming.resume() {
                tracing::info!("Resuming recording.");
            }
            ResumeResponse::default()
        })?,
        node.serve::<IsPaused>("~/is_paused", qos, move |_| IsPausedResponse { paused: asked.is_paused() })?,
        node.serve_later::<SplitBagfile>("~/split_bagfile", qos, move |_, reply| {
            splitting.split(move |result| {
                if let Err(error) = &result {
                    tracing::warn!("the bag is not split: {error}");
                }
                sent(reply.send(&SplitBagfileResponse::default()));
            });
        })?,
        node.serve::<Stop>("~/stop", qos, move |_| {
            stopping.stop();
            StopResponse::default()
        })?,
    ];
    if takes_snapshots {
        let control = own();
        services.push(node.serve_later::<Snapshot>("~/snapshot", qos, move |_, reply| {
            control.snapshot(move |result| {
                if let Err(error) = &result {
                    tracing::warn!("no snapshot is written: {error}");
                }
                sent(reply.send(&SnapshotResponse { success: result.is_ok() }));
            });
        })?);
    }
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
