//! The engines of this repository.

use crate::engine::Engine;
#[cfg(feature = "rustdds")]
use crate::engine::KnownFailure;
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::middleware::rtps::RtpsParticipant;
#[cfg(feature = "rustdds")]
use downbeat_bridge::middleware::rustdds::RustddsParticipant;
use downbeat_bridge::middleware::{Middleware, MiddlewareError, ParticipantOptions};
use parking_lot::Mutex;
use std::collections::HashMap;
use std::path::PathBuf;

/// The engine in memory.
#[must_use]
pub fn in_process() -> Engine {
    let hubs = Mutex::new(HashMap::<u16, Hub>::new());
    Engine {
        name: "in_process",
        join: Box::new(move |options| {
            let mut hubs = hubs.lock();
            Ok(Box::new(hubs.entry(options.domain_id).or_default().join()))
        }),
        has_network: false,
        peer: None,
        known_failures: &[],
    }
}

/// The engine of this project; with the program that is the other process, if there is one.
#[must_use]
pub fn rtps(peer: Option<PathBuf>) -> Engine {
    Engine { name: "downbeat-rtps", join: Box::new(join_rtps), has_network: true, peer, known_failures: &[] }
}

/// A participant of the engine of this project.
///
/// # Errors
/// Those of [`RtpsParticipant::new`].
pub fn join_rtps(options: &ParticipantOptions) -> Result<Box<dyn Middleware>, MiddlewareError> {
    Ok(Box::new(RtpsParticipant::new(options)?))
}

#[cfg(feature = "rustdds")]
/// rustdds; with the program that is the other process, if there is one.
#[must_use]
pub fn rustdds(peer: Option<PathBuf>) -> Engine {
    Engine {
        name: "rustdds 0.15.1",
        join: Box::new(join_rustdds),
        has_network: true,
        peer,
        known_failures: RUSTDDS,
    }
}

#[cfg(feature = "rustdds")]
/// A participant of rustdds.
///
/// # Errors
/// Those of [`RustddsParticipant::new`].
pub fn join_rustdds(options: &ParticipantOptions) -> Result<Box<dyn Middleware>, MiddlewareError> {
    Ok(Box::new(RustddsParticipant::new(options)?))
}

#[cfg(feature = "rustdds")]
/// Causes are in the source of rustdds 0.15.1 where a path is given.
const RUSTDDS: &[KnownFailure] = &[
    KnownFailure {
        case: "a_participant_hears_itself",
        limit: "nodes of one process do not communicate with each other",
        cause: "it matches its own endpoints only when it announces them again",
        effect: "a subscription in the same process receives nothing",
        remedy: "connect modules through the executor",
    },
    KnownFailure {
        case: "payloads_of_either_byte_order_arrive_as_they_were_written",
        limit: "payloads of big-endian CDR are not sent",
        cause: "the encoding is a constant of the writer's type",
        effect: "messages of a bag that was recorded on a big-endian machine are refused",
        remedy: "none",
    },
    KnownFailure {
        case: "a_peer_with_another_type_is_reported_on_both_sides_and_not_matched",
        limit: "endpoints of another type are matched",
        cause: "only the names of topics are compared (`rtps/dp_event_loop.rs`)",
        effect: "messages of another type arrive, and are counted as errors when they cannot be decoded",
        remedy: "compare the types with `ros2 topic info -v`",
    },
    KnownFailure {
        case: "missed_deadlines_are_reported_on_both_sides",
        limit: "missed deadlines are not reported",
        cause: "it has no such event for writers, nor for the kind of reader that is used",
        effect: "no event on `bridge/qos_events`",
        remedy: "none",
    },
    KnownFailure {
        case: "a_writer_with_manual_liveliness_lives_as_long_as_it_says_so",
        limit: "changes of liveliness are not reported",
        cause: "it has no such events",
        effect: "no event on `bridge/qos_events`",
        remedy: "none",
    },
    KnownFailure {
        case: "a_late_reader_gets_no_sample_past_its_lifespan",
        limit: "samples do not expire",
        cause: "lifespan is announced, but not applied",
        effect: "a late subscription receives expired messages",
        remedy: "check the stamps of messages",
    },
    KnownFailure {
        case: "large_requests_and_replies_arrive_whole",
        limit: "replies of more than 1372 bytes are refused",
        cause: "inline QoS of fragments is corrupted (`rtps/writer.rs`)",
        effect: "a service with large answers times out",
        remedy: "none",
    },
    KnownFailure {
        case: "a_late_reader_gets_no_more_than_the_history_depth",
        limit: "the history depth of a latched topic is exceeded",
        cause: "histories are trimmed every 6 s (`rtps/writer.rs`)",
        effect: "a late subscription may also receive older messages, up to 64, in order",
        remedy: "use the last one; publish latched values rarely",
    },
    KnownFailure {
        case: "a_late_volatile_reader_gets_no_history",
        limit: "volatile subscriptions of latched topics receive earlier messages",
        cause: "history is sent regardless of what the subscription requests",
        effect: "a late volatile subscription receives up to 64 older messages",
        remedy: "check the stamps of messages",
    },
    KnownFailure {
        case: "a_killed_reader_does_not_stop_the_writer",
        limit: "a killed reliable subscription stays matched until its lease expires (20 s with Fast DDS, 50 s with rustdds)",
        cause: "unacknowledged samples are kept even with `keep_last`",
        effect: "above 200 messages/s, messages on that topic are refused for all subscriptions, and counted",
        remedy: "offer best effort above that rate",
    },
    KnownFailure {
        case: "the_hash_of_a_type_is_announced",
        limit: "type hashes are not announced",
        cause: "user data of an endpoint can be received, but not sent",
        effect: "`ros2 topic info -v` shows INVALID; bags recorded elsewhere lack the hash",
        remedy: "none needed: types are matched by name; `get_type_description` works",
    },
    KnownFailure {
        case: "static_peers_are_announced_to",
        limit: "`ROS_STATIC_PEERS` has no effect",
        cause: "it announces itself by multicast only",
        effect: "hosts that multicast does not reach are not discovered",
        remedy: "none",
    },
];
