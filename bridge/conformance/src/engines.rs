//! The engines of this repository.

use crate::engine::Engine;
#[cfg(any(feature = "rustdds", feature = "zenoh"))]
use crate::engine::KnownFailure;
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::middleware::rtps::RtpsParticipant;
#[cfg(feature = "rustdds")]
use downbeat_bridge::middleware::rustdds::RustddsParticipant;
#[cfg(feature = "zenoh")]
use downbeat_bridge::middleware::zenoh::ZenohParticipant;
use downbeat_bridge::middleware::{Middleware, MiddlewareError, ParticipantOptions};
#[cfg(feature = "security")]
use downbeat_bridge::middleware::{OptionsError, SecurityOptions};
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
        environment: Vec::new(),
        known_failures: &[],
    }
}

/// The engine of this project; with the program that is the other process, if there is one.
#[must_use]
pub fn rtps(peer: Option<PathBuf>) -> Engine {
    Engine {
        name: "downbeat-rtps",
        join: Box::new(join_rtps),
        has_network: true,
        peer,
        environment: Vec::new(),
        known_failures: &[],
    }
}

/// A participant of the engine of this project.
///
/// # Errors
/// Those of [`RtpsParticipant::new`].
pub fn join_rtps(options: &ParticipantOptions) -> Result<Box<dyn Middleware>, MiddlewareError> {
    Ok(Box::new(RtpsParticipant::new(options)?))
}

/// The engine of this project with an enclave of a keystore; with the program that is the other process, if
/// there is one.
#[cfg(feature = "security")]
#[must_use]
pub fn secured(keystore: PathBuf, enclave: &'static str, peer: Option<PathBuf>) -> Engine {
    let environment = vec![
        ("ROS_SECURITY_ENABLE", "true".to_owned()),
        ("ROS_SECURITY_STRATEGY", "Enforce".to_owned()),
        ("ROS_SECURITY_KEYSTORE", keystore.display().to_string()),
        ("ROS_SECURITY_ENCLAVE_OVERRIDE", enclave.to_owned()),
    ];
    let security = SecurityOptions {
        keystore: Some(keystore),
        enclave: enclave.to_owned(),
        enclave_override: None,
        is_enforced: true,
    };
    Engine {
        name: "downbeat-rtps with security",
        join: Box::new(move |options| {
            join_rtps(&ParticipantOptions { security: Some(security.clone()), ..options.clone() })
        }),
        has_network: true,
        peer,
        environment,
        known_failures: &[],
    }
}

/// A participant of the engine of this project, with the enclave of the environment.
///
/// # Errors
/// Those of [`RtpsParticipant::new`].
#[cfg(feature = "security")]
pub fn join_secured(options: &ParticipantOptions) -> Result<Box<dyn Middleware>, MiddlewareError> {
    let failed = |error: OptionsError| MiddlewareError::Security { reason: error.to_string() };
    let security = ParticipantOptions::from_env().map_err(failed)?.security;
    join_rtps(&ParticipantOptions { security, ..options.clone() })
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
        environment: Vec::new(),
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

/// Zenoh, with a router for the participants of this process and of the peer; with the program that is the
/// other process, if there is one.
///
/// # Panics
/// If the router does not start.
#[cfg(feature = "zenoh")]
#[must_use]
pub fn zenoh(peer: Option<PathBuf>) -> Engine {
    let free = std::net::TcpListener::bind(("127.0.0.1", 0)).and_then(|socket| socket.local_addr());
    let port = free.unwrap_or_else(|error| panic!("no port is free: {error}")).port();
    let settings = |overrides: String| {
        let overrides = Some(overrides);
        downbeat_zenoh::Settings { overrides, router_check_attempts: 10, ..Default::default() }
    };
    let router =
        downbeat_zenoh::Router::start(&settings(format!("listen/endpoints=[\"tcp/127.0.0.1:{port}\"]")));
    let router = router.unwrap_or_else(|error| panic!("no router: {error}"));
    let overrides =
        format!("connect/endpoints=[\"tcp/127.0.0.1:{port}\"];listen/endpoints=[\"tcp/127.0.0.1:0\"]");
    let of_session = settings(overrides.clone());
    Engine {
        name: "zenoh 1.10.2",
        join: Box::new(move |options| {
            // As long as there are participants.
            let _ = &router;
            let options = ParticipantOptions { zenoh: of_session.clone(), ..options.clone() };
            Ok(Box::new(ZenohParticipant::new(&options)?))
        }),
        has_network: true,
        peer,
        environment: vec![("ZENOH_CONFIG_OVERRIDE", overrides)],
        known_failures: ZENOH,
    }
}

/// A participant on Zenoh, with the configuration of the environment.
///
/// # Errors
/// Those of [`ZenohParticipant::new`].
#[cfg(feature = "zenoh")]
pub fn join_zenoh(options: &ParticipantOptions) -> Result<Box<dyn Middleware>, MiddlewareError> {
    let failed = |error: downbeat_zenoh::SettingsError| MiddlewareError::Zenoh {
        domain_id: options.domain_id,
        reason: error.to_string(),
    };
    let zenoh = downbeat_zenoh::Settings::from_variables(|name| std::env::var(name).ok()).map_err(failed)?;
    Ok(Box::new(ZenohParticipant::new(&ParticipantOptions { zenoh, ..options.clone() })?))
}

/// What Zenoh has not, or `rmw_zenoh_cpp` does not use.
#[cfg(feature = "zenoh")]
const ZENOH: &[KnownFailure] = &[
    KnownFailure {
        case: "a_reader_that_asks_for_more_than_is_offered_is_not_matched",
        limit: "quality of service is not compared",
        cause: "Zenoh delivers by key; `rmw_zenoh_cpp` compares nothing either",
        effect: "a reliable subscription receives from a best-effort publisher, and no event says so",
        remedy: "compare the profiles with `downbeat topic info -v`",
    },
    KnownFailure {
        case: "each_policy_keeps_apart_what_does_not_suit_and_is_named_on_both_sides",
        limit: "quality of service is not compared",
        cause: "Zenoh delivers by key; `rmw_zenoh_cpp` compares nothing either",
        effect: "no event on `bridge/qos_events` of this kind",
        remedy: "compare the profiles with `downbeat topic info -v`",
    },
    KnownFailure {
        case: "missed_deadlines_are_reported_on_both_sides",
        limit: "missed deadlines are not reported",
        cause: "`rmw_zenoh_cpp` announces deadlines and does not enforce them",
        effect: "no event on `bridge/qos_events`",
        remedy: "check the stamps of messages",
    },
    KnownFailure {
        case: "a_writer_with_manual_liveliness_lives_as_long_as_it_says_so",
        limit: "manual liveliness is not enforced",
        cause: "`rmw_zenoh_cpp` announces it and does not enforce it",
        effect: "no event on `bridge/qos_events`",
        remedy: "publish a heartbeat and check its age",
    },
    KnownFailure {
        case: "a_late_reader_gets_no_sample_past_its_lifespan",
        limit: "samples do not expire",
        cause: "`rmw_zenoh_cpp` announces lifespans and does not enforce them",
        effect: "a late subscription receives expired messages",
        remedy: "check the stamps of messages",
    },
    KnownFailure {
        case: "static_peers_are_announced_to",
        limit: "`ROS_STATIC_PEERS` has no effect",
        cause: "sessions connect to what their configuration names",
        effect: "a warning at the start",
        remedy: "set `connect/endpoints` by ZENOH_CONFIG_OVERRIDE",
    },
];
