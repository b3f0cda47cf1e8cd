//! The QoS that publishers offer: what to request, and what to write into the bag.
//!
//! The rules are those of `rosbag2_storage/qos.cpp` and `rosbag2_transport/recorder.cpp`, branch jazzy.

use downbeat_bags::metadata::RecordedQos;
use downbeat_bridge::middleware::RemoteEndpoint;
use downbeat_msgs::qos::{Durability, QosProfile, Reliability};

/// Samples that wait in the middleware, for bursts.
const DEPTH: u32 = 1000;

/// What to request so that all publishers match. Logs a warning if some publishers offer more.
pub(super) fn request_for(topic: &str, publishers: &[&RemoteEndpoint]) -> QosProfile {
    let all = |is_so: fn(&RemoteEndpoint) -> bool| publishers.iter().all(|publisher| is_so(publisher));
    let any = |is_so: fn(&RemoteEndpoint) -> bool| publishers.iter().any(|publisher| is_so(publisher));
    let mut profile = QosProfile::DEFAULT.keep_last(DEPTH);
    if publishers.is_empty() {
        return profile;
    }
    if !all(is_reliable) {
        if any(is_reliable) {
            tracing::warn!(
                "Some, but not all, publishers on topic \"{topic}\" are offering reliable messages. Falling back to \
                 best effort as it will connect to all publishers. Some messages from reliable publishers could be dropped."
            );
        }
        profile.reliability = Reliability::BestEffort;
    }
    if all(is_transient_local) {
        profile.durability = Durability::TransientLocal;
    } else if any(is_transient_local) {
        tracing::warn!(
            "Some, but not all, publishers on topic \"{topic}\" are offering transient local messages. Falling back to \
             volatile as it will connect to all publishers. Previously published latched messages will not be retrieved."
        );
    }
    profile
}

/// Why a publisher that came later does not match, if so.
pub(super) fn mismatch(requested: &QosProfile, publisher: &RemoteEndpoint) -> Option<&'static str> {
    if requested.reliability == Reliability::Reliable && !is_reliable(publisher) {
        return Some("best effort, but the recorder requests reliable");
    }
    if requested.durability == Durability::TransientLocal && !is_transient_local(publisher) {
        return Some("volatile, but the recorder requests transient local");
    }
    None
}

/// The offered QoS for the bag: discovery does not reveal the history.
pub(super) fn noted(publisher: &RemoteEndpoint) -> RecordedQos {
    RecordedQos::from(QosProfile { lifespan: None, ..publisher.qos() }).without_history()
}

/// The hash that all publishers agree on that announce one.
pub(super) fn common_hash<'a>(topic: &str, publishers: &[&'a RemoteEndpoint]) -> Option<&'a str> {
    let mut hashes = publishers.iter().filter_map(|publisher| publisher.type_hash.as_deref());
    let first = hashes.next()?;
    match hashes.find(|other| *other != first) {
        Some(other) => {
            tracing::warn!("the type hashes of topic {topic} conflict: {first} != {other}");
            None
        }
        None => Some(first),
    }
}

fn is_reliable(publisher: &RemoteEndpoint) -> bool {
    publisher.reliability == Reliability::Reliable
}

fn is_transient_local(publisher: &RemoteEndpoint) -> bool {
    publisher.durability == Durability::TransientLocal
}
