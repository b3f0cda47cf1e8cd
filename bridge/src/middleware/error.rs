//! Errors at the boundary to the engine.

use thiserror::Error;

/// A participant or endpoint could not be created.
#[derive(Debug, Error)]
pub enum MiddlewareError {
    /// The engine could not join the domain.
    #[error(
        "joining ROS domain {domain_id} failed: {reason}. Is the domain full (120 participants a host), or is a \
         firewall closing its UDP ports?"
    )]
    Join {
        /// The domain.
        domain_id: u16,
        /// What the engine said.
        reason: String,
    },
    /// Zenoh could not be joined.
    #[error("joining ROS domain {domain_id} over Zenoh failed: {reason}")]
    Zenoh {
        /// The domain.
        domain_id: u16,
        /// What Zenoh said.
        reason: String,
    },
    /// The participant cannot be protected as it must be.
    #[error("security: {reason}")]
    Security {
        /// Why, and what to do.
        reason: String,
    },
    /// The engine refused an endpoint.
    #[error("creating a {endpoint} on topic {topic_name:?} (type {type_name}) failed: {reason}")]
    Endpoint {
        /// Such as "writer" or "reader".
        endpoint: &'static str,
        /// The topic on the wire.
        topic_name: String,
        /// The type on the wire.
        type_name: String,
        /// What the engine said.
        reason: String,
    },
    /// The engine does not support the quality of service.
    #[error("topic {topic_name:?}: {reason}")]
    Qos {
        /// The topic on the wire.
        topic_name: String,
        /// What is not supported, and the alternative.
        reason: String,
    },
    /// The thread that serves the readers could not start.
    #[error("starting a thread of the engine failed: {0}")]
    ReaderThread(#[from] std::io::Error),
    /// The thread that runs the handlers of services could not start.
    #[error("starting the thread of the services failed: {0}")]
    ServiceThread(std::io::Error),
    /// The engine panicked; the participant must not be used any more.
    #[error("the DDS engine panicked while {doing}; restart the bridge")]
    Panicked {
        /// What was being done.
        doing: &'static str,
    },
}

/// A sample was not written.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum WriteError {
    /// The send window is full: a reliable reader does not acknowledge.
    #[error("the send window is full: a reliable reader does not acknowledge (its process may have died)")]
    WindowFull,
    /// The payload does not begin with an encapsulation header the engine can send.
    #[error(
        "a payload must begin with an encapsulation header of CDR that the engine sends, 00 01 00 00 for little-endian; found \
         {found:02x?}"
    )]
    Encapsulation {
        /// The first bytes of the payload, at most four.
        found: Vec<u8>,
    },
    /// The engine failed.
    #[error("the engine failed: {0}")]
    Engine(String),
    /// The engine panicked.
    #[error("the DDS engine panicked while writing")]
    Panicked,
}
