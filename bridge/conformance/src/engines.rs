//! The engines of this repository.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use downbeat_bridge::middleware::in_process::Hub;
#[cfg(feature = "rustdds")]
use downbeat_bridge::middleware::rustdds::RustddsParticipant;
use downbeat_bridge::middleware::{Middleware, MiddlewareError, ParticipantOptions};

use crate::engine::{Engine, KnownFailure};

/// The engine in memory.
#[must_use]
pub fn in_process() -> Engine {
    let hubs = Mutex::new(HashMap::<u16, Hub>::new());
    Engine {
        name: "in_process",
        join: Box::new(move |options| {
            let mut hubs = hubs.lock().unwrap_or_else(PoisonError::into_inner);
            Ok(Box::new(hubs.entry(options.domain_id).or_default().join()))
        }),
        has_network: false,
        peer: None,
        known_failures: &[],
    }
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
        case: "a_late_reader_gets_no_more_than_the_history_depth",
        limit: "the history depth of a latched topic is not kept to",
        cause: "histories are trimmed every 6 s (`rtps/writer.rs`)",
        effect: "a late subscription may get older messages too, up to 64, in order",
        remedy: "take the last; publish latched values seldom",
    },
    KnownFailure {
        case: "a_late_volatile_reader_gets_no_history",
        limit: "what was written before reaches volatile subscriptions of latched topics",
        cause: "history is sent whatever the subscription asks for",
        effect: "a late volatile subscription gets up to 64 older messages",
        remedy: "look at the stamp of messages",
    },
    KnownFailure {
        case: "a_killed_reader_does_not_stop_the_writer",
        limit: "a killed reliable subscription keeps its place until its lease is over (20 s of Fast DDS, 50 s of rustdds)",
        cause: "unacknowledged samples are kept in spite of keep last",
        effect: "above 200 messages/s on that topic messages to all its subscriptions are refused, and counted",
        remedy: "offer best effort above that rate",
    },
    KnownFailure {
        case: "the_hash_of_a_type_is_told",
        limit: "type hashes are not told",
        cause: "user data of an endpoint is read and cannot be sent",
        effect: "`ros2 topic info -v` shows INVALID; bags recorded elsewhere lack the hash",
        remedy: "nothing is needed: types are matched by name; `get_type_description` works",
    },
];
