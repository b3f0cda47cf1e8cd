//! Services of engines that have requests and replies of their own.

use super::{EventHandler, Gid, MatchHandler, MiddlewareError, NodeIdentity, WriteError};
use bytes::Bytes;
use downbeat_msgs::qos::QosProfile;
use std::time::Duration;

/// A service: its name and type, and the two topics that it is on DDS.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServiceEndpoint {
    /// The absolute name, also for errors and warnings.
    pub name: String,
    /// The type on DDS without the part, such as `std_srvs::srv::dds_::Trigger_`.
    pub type_name: String,
    /// The hash of the service, `RIHS01_` and 64 hex digits, for engines that announce it.
    pub type_hash: Option<String>,
    /// The node that has it, for engines that announce it with the endpoint.
    pub node: Option<NodeIdentity>,
    /// The topic of requests, such as `rq/resetRequest`.
    pub request_topic: String,
    /// The type of requests, such as `std_srvs::srv::dds_::Trigger_Request_`.
    pub request_type: String,
    /// The topic of replies, such as `rr/resetReply`.
    pub reply_topic: String,
    /// The type of replies, such as `std_srvs::srv::dds_::Trigger_Response_`.
    pub reply_type: String,
    /// What both topics offer and request.
    pub qos: QosProfile,
    /// The hashes of the types of requests and replies, `RIHS01_` and 64 hex digits, for engines that can
    /// announce them.
    pub type_hashes: [Option<String>; 2],
}

/// Takes the requests of one server, in the order of each client. It runs on a thread of the middleware, so
/// it must not block.
pub type ServiceRequestHandler = Box<dyn Fn(ServiceRequest) + Send + Sync>;

/// Makes servers and clients.
pub trait Services: Send + Sync {
    /// Creates a server that gives each request to `on_request`.
    ///
    /// # Errors
    /// [`MiddlewareError`] when the engine refuses it.
    fn create_server(
        &self,
        service: &ServiceEndpoint,
        on_request: ServiceRequestHandler,
    ) -> Result<Box<dyn ServiceServer>, MiddlewareError>;

    /// Creates a client.
    ///
    /// # Errors
    /// [`MiddlewareError`] when the engine refuses it.
    fn create_client(&self, service: &ServiceEndpoint) -> Result<Box<dyn ServiceClient>, MiddlewareError>;
}

/// Accepts requests. Dropping it removes the endpoint.
pub trait ServiceServer: Send + Sync {
    /// The identity of this endpoint.
    fn gid(&self) -> Gid;

    /// The number of matched clients.
    fn clients(&self) -> usize;

    /// Registers a handler for events of this endpoint: first the present state, then its changes.
    fn on_event(&self, handler: EventHandler);
}

/// Sends requests. Dropping it removes the endpoint.
pub trait ServiceClient: Send + Sync {
    /// The identity of this endpoint.
    fn gid(&self) -> Gid;

    /// The number of servers that receive a request now.
    fn servers(&self) -> usize;

    /// Registers a handler for changes of the servers, in place of the handler before.
    fn on_match(&self, handler: MatchHandler);

    /// Registers a handler for events of this endpoint: first the present state, then its changes.
    fn on_event(&self, handler: EventHandler);

    /// Sends a request with this number, from 1, without blocking. `on_reply` is called with the first reply
    /// that comes before `timeout` is over, on a thread of the middleware.
    ///
    /// # Errors
    /// [`WriteError`] when it was not sent.
    fn send(
        &self,
        number: i64,
        cdr: Bytes,
        timeout: Duration,
        on_reply: Box<dyn FnOnce(Bytes) + Send + Sync>,
    ) -> Result<(), WriteError>;
}

/// A request that a server received.
pub struct ServiceRequest {
    /// Encapsulation header and body.
    pub cdr: Bytes,
    /// The client.
    pub client: Gid,
    /// The number of the request at its client.
    pub number: i64,
    /// The way back.
    pub reply: Box<dyn ServiceReply>,
}

/// The way back of one request. Dropping it ends the request without an answer.
pub trait ServiceReply: Send {
    /// Whether the client that asked is known to have left.
    fn has_client_left(&self) -> bool;

    /// Sends the reply without blocking.
    ///
    /// # Errors
    /// [`WriteError`] when it was not sent.
    fn send(self: Box<Self>, cdr: Bytes) -> Result<(), WriteError>;
}
