//! Raw topics over a publish and subscribe engine, behind a trait that other engines can implement.
//!
//! The interface consists of topic names, type names and bytes. ROS names, message types and the node graph
//! belong to [`crate::ros`]. The bytes are a complete serialized payload: the four bytes of the CDR
//! encapsulation header and the body, as returned by `rclpy.serialization.serialize_message`.
//!
//! The engines behind [`Middleware`] are [`rtps`], the engine of this project, which communicates with every
//! ROS 2 node over DDS; the crate rustdds and Zenoh, with the features of those names; and [`in_process`], a
//! hub in memory for tests without a network. The package in `conformance/` tests all of them, including
//! requests and replies ([`rpc`]). On DDS these are samples that refer to the related sample, and the nodes
//! of a participant are samples too. An engine that has [`Services`] or [`Nodes`] of its own says so.

pub mod in_process;
pub mod rpc;
pub mod rtps;
#[cfg(feature = "rustdds")]
pub mod rustdds;
#[cfg(feature = "zenoh")]
pub mod zenoh;

mod endpoint;
mod error;
mod event;
mod options;
mod security;
mod service;

pub use endpoint::{
    Direction, Endpoint, Gid, NodeIdentity, Priority, RemoteEndpoint, RemoteNodeIdentity, Sample,
    SampleIdentity, SendOptions, WriteOptions,
};
pub use error::{MiddlewareError, WriteError};
pub use event::{Aliveness, EndpointEvent, EventHandler, QosPolicyKind};
pub use options::{DiscoveryRange, Engine, MAX_DOMAIN_ID, OptionsError, ParticipantOptions};
pub use rtps::SOCKET_BUFFER;
pub use security::SecurityOptions;

pub use service::{
    ServiceClient, ServiceEndpoint, ServiceReply, ServiceRequest, ServiceRequestHandler, ServiceServer,
    Services,
};

use bytes::Bytes;
use std::sync::Arc;
use std::time::Duration;

/// Receives the samples of one reader, in the order of each writer. It runs on a thread of the middleware
/// that all readers of the participant share, so it must pass the sample on and return.
pub type SampleHandler = Box<dyn FnMut(Sample) + Send>;

/// Counts the readers of a writer; 0 or the last count once the writer is dropped.
pub type ReaderCounter = Box<dyn Fn() -> usize + Send + Sync>;

/// Tells the state of security.
pub type SecurityWatch = Box<dyn Fn() -> SecurityState + Send>;

/// Handles changes of the matched endpoints. It runs on a thread of the middleware, so it must not block.
pub type MatchHandler = Box<dyn Fn() + Send + Sync>;

/// A participant of a domain: creates endpoints, and discovers those of others. Its readers also receive from
/// its own writers, so nodes of one process communicate with each other.
///
/// Dropping it makes it leave the domain. Drop its endpoints before.
pub trait Middleware: Send + Sync {
    /// The identity of this participant in its domain.
    fn gid(&self) -> Gid;

    /// Creates a writer of raw samples.
    ///
    /// # Errors
    /// [`MiddlewareError`] when the engine refuses the endpoint or its quality of service.
    fn create_writer(&self, endpoint: &Endpoint) -> Result<Box<dyn Writer>, MiddlewareError>;

    /// Creates a reader that gives each sample to `on_sample`. Once the returned reader is dropped,
    /// `on_sample` is not called any more.
    ///
    /// # Errors
    /// [`MiddlewareError`] when the engine refuses the endpoint or its quality of service.
    fn create_reader(
        &self,
        endpoint: &Endpoint,
        on_sample: SampleHandler,
    ) -> Result<Box<dyn Reader>, MiddlewareError>;

    /// The endpoints of other participants that are known at this moment.
    fn remote_endpoints(&self) -> Vec<RemoteEndpoint>;

    /// The participants that were discovered, whether or not their endpoints are known yet. `None` where the
    /// engine does not tell.
    fn remote_participants(&self) -> Option<Vec<[u8; 12]>> {
        None
    }

    /// The nodes, where the engine announces them itself. `None` where they are samples on
    /// `ros_discovery_info`, as on DDS.
    fn nodes(&self) -> Option<&dyn Nodes> {
        None
    }

    /// The services, where the engine has requests and replies itself. `None` where they are two topics, as
    /// on DDS.
    fn services(&self) -> Option<&dyn Services> {
        None
    }

    /// The vendor of the implementation of a participant or endpoint. In a protected domain its identity does
    /// not tell.
    fn vendor_of(&self, peer: Gid) -> [u8; 2] {
        peer.vendor()
    }

    /// The subject of the certificate of a participant that has proven its identity, such as `CN=/robot`.
    /// `None` without security.
    fn subject_of(&self, _participant: Gid) -> Option<String> {
        None
    }

    /// Tells the state of security, from any thread and without keeping the participant. `None` without it.
    fn security(&self) -> Option<SecurityWatch> {
        None
    }

    /// Leaves the domain at once, for a process that is about to end without dropping it. Without an effect
    /// in engines that cannot, whose peers then wait for the lease to expire.
    fn leave(&self) {}
}

/// The state of security of a participant.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SecurityState {
    /// The subject of its certificate.
    pub subject: String,
    /// The number of other participants that have proven their identity.
    pub authenticated: usize,
    /// How often somebody was refused, and the latest reasons.
    pub refused: u64,
    /// The latest reasons, each a sentence.
    pub refusals: Vec<String>,
    /// What should be mended soon, such as a certificate that expires.
    pub warnings: Vec<String>,
}

/// The nodes of an engine that announces them itself. Their endpoints name them in [`Endpoint::node`], and
/// those of others in [`RemoteEndpoint::node`].
pub trait Nodes: Send + Sync {
    /// Announces a node.
    ///
    /// # Errors
    /// [`MiddlewareError`] when the engine refuses it.
    fn add(&self, node: &NodeIdentity) -> Result<(), MiddlewareError>;

    /// Withdraws a node.
    fn remove(&self, node: &NodeIdentity);

    /// The nodes of other participants.
    fn remote(&self) -> Vec<RemoteNodeIdentity>;

    /// Whether everything that others have announced before this participant joined is known.
    fn has_heard_all(&self) -> bool;

    /// What tools call the implementation of these participants.
    fn implementation(&self) -> &'static str;
}

/// Writes samples to one topic. Dropping it removes the endpoint.
pub trait Writer: Send + Sync {
    /// The identity of this endpoint.
    fn gid(&self) -> Gid;

    /// The number of matched readers. A reliable reader counts once it has answered this writer, and so
    /// receives what is written now.
    fn matched(&self) -> usize;

    /// The number of readers of what is written now: matched ones, and those for which an engine keeps
    /// samples until they have answered.
    fn readers(&self) -> usize {
        self.matched()
    }

    /// Returns a function that counts the readers as [`readers`](Self::readers) does, from any thread,
    /// without keeping the endpoint.
    fn reader_counter(&self) -> ReaderCounter;

    /// The matched readers.
    fn matched_readers(&self) -> Vec<Gid>;

    /// See [`Middleware::vendor_of`].
    fn vendor_of(&self, peer: Gid) -> [u8; 2] {
        peer.vendor()
    }

    /// Registers a handler for changes of the matched readers, in place of the handler before.
    fn on_match(&self, handler: MatchHandler);

    /// Registers a handler for events of this endpoint: first the present state, then its changes. It
    /// replaces the handler before.
    fn on_event(&self, handler: EventHandler);

    /// Writes one sample, stamped with the present time. Never blocks: a sample that does not fit the send
    /// window (a reliable reader has died and its lease still runs) is refused.
    ///
    /// # Errors
    /// [`WriteError`] when this sample was not written.
    fn write(&self, cdr: Bytes) -> Result<(), WriteError> {
        self.write_with(cdr, WriteOptions::default()).map(drop)
    }

    /// The same, with options. Returns the number of the sample, from 1.
    ///
    /// # Errors
    /// [`WriteError`] when this sample was not written.
    fn write_with(&self, cdr: Bytes, options: WriteOptions) -> Result<i64, WriteError>;

    /// Asserts the liveliness of this writer without a sample, if it is manual. An engine may support samples
    /// as the only assertion.
    fn assert_liveliness(&self) {}

    /// Waits until every matched reliable reader has acknowledged all samples, at most for `timeout`. Returns
    /// true if all have.
    fn flush(&self, timeout: Duration) -> bool;
}

/// Keeps a subscription alive. Dropping it removes the endpoint.
pub trait Reader: Send + Sync {
    /// The identity of this endpoint.
    fn gid(&self) -> Gid;

    /// The number of matched writers.
    fn matched(&self) -> usize;

    /// The matched writers.
    fn matched_writers(&self) -> Vec<Gid>;

    /// Registers a handler for changes of the matched writers, in place of the handler before.
    fn on_match(&self, handler: MatchHandler);

    /// Registers a handler for events of this endpoint: first the present state, then its changes. It
    /// replaces the handler before.
    fn on_event(&self, handler: EventHandler);
}

/// Joins the domain that the options name: over its engine, or alone when discovery is off.
///
/// # Errors
/// [`MiddlewareError`] when the participant cannot be created.
pub fn join(options: &ParticipantOptions) -> Result<Arc<dyn Middleware>, MiddlewareError> {
    options.not_honoured().iter().for_each(|sentence| tracing::warn!("{sentence}"));
    if options.discovery_range == DiscoveryRange::Off {
        tracing::warn!("ROS_AUTOMATIC_DISCOVERY_RANGE=OFF: no other ROS 2 node will see this one");
    }
    if let Some(security) = options.security.as_ref().filter(|_| options.engine != Engine::Rtps) {
        let reason = format!(
            "keystores of ROS 2 protect DDS, not the engine {}; Zenoh has TLS and access control of its own \
             (ZENOH_SESSION_CONFIG_URI)",
            options.engine
        );
        if security.is_enforced {
            return Err(MiddlewareError::Security { reason });
        }
        tracing::warn!("ROS_SECURITY_ENABLE=true: {reason}. This node joins without it");
    }
    match options.engine {
        Engine::Rtps => Ok(Arc::new(rtps::RtpsParticipant::new(options)?)),
        #[cfg(feature = "rustdds")]
        Engine::Rustdds => Ok(Arc::new(rustdds::RustddsParticipant::new(options)?)),
        #[cfg(feature = "zenoh")]
        Engine::Zenoh => Ok(Arc::new(zenoh::ZenohParticipant::new(options)?)),
    }
}
