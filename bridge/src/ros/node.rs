//! A participant as ROS 2 sees it: nodes with publishers and subscriptions.

use super::graph::{Graph, RemoteNode};
use super::incompatible::Warned;
use super::{
    MessageType, NameError, NodeName, QosRequest, RemapRules, ServiceName, ServiceType, TopicName,
    type_description,
};
use crate::edge::KnownType;
use crate::middleware::rpc::{RequestServer, RpcThread};
use crate::middleware::{
    self, Direction, Endpoint, EventHandler, Gid, Middleware, MiddlewareError, ParticipantOptions, Reader,
    RemoteEndpoint, SampleHandler, WriteError, Writer,
};
use bytes::Bytes;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::type_description_interfaces::srv::GetTypeDescription;
use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use thiserror::Error;

/// A node or one of its endpoints could not be created.
#[derive(Debug, Error)]
pub enum NodeError {
    /// A name is not valid.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The participant has a node of that name already.
    #[error("this process has a ROS 2 node {0} already; give one of them another name or namespace")]
    Exists(NodeName),
    /// The engine refused.
    #[error(transparent)]
    Middleware(#[from] MiddlewareError),
}

/// What all nodes of a process share: one participant of the domain.
///
/// When the last node, publisher and subscription made from it is dropped too, it leaves the domain: its nodes are
/// gone from the graph of the others at once, and its threads have ended when the drop returns.
#[derive(Clone)]
pub struct Participant {
    shared: Arc<Shared>,
}

pub(super) struct Shared {
    // Fields drop in this order: the graph takes leave before the participant goes.
    pub(super) graph: Graph,
    /// What nodes offer by themselves. Here, since a service that its node held would keep the node.
    own_services: Mutex<HashMap<NodeName, Vec<RequestServer>>>,
    pub(super) rpc: RpcThread,
    pub(super) middleware: Arc<dyn Middleware>,
    remaps: RemapRules,
    /// The nodes there are, by the names they were asked for.
    nodes: Mutex<BTreeMap<NodeName, Weak<Membership>>>,
}

impl Participant {
    /// Joins the domain that the options name.
    ///
    /// # Errors
    /// [`MiddlewareError`] when the domain cannot be joined.
    pub fn join(options: &ParticipantOptions) -> Result<Self, MiddlewareError> {
        Self::on(middleware::join(options)?)
    }

    /// Joins the domain that the options name; the rules apply to all names of its nodes.
    ///
    /// # Errors
    /// [`MiddlewareError`] when the domain cannot be joined.
    pub fn join_with(options: &ParticipantOptions, remaps: RemapRules) -> Result<Self, MiddlewareError> {
        Self::on_with(middleware::join(options)?, remaps)
    }

    /// Stands on a participant that exists, of whatever engine.
    ///
    /// # Errors
    /// [`MiddlewareError`] when the endpoints of the node graph cannot be created.
    pub fn on(middleware: Arc<dyn Middleware>) -> Result<Self, MiddlewareError> {
        Self::on_with(middleware, RemapRules::default())
    }

    /// Stands on a participant that exists; the rules apply to all names of its nodes.
    ///
    /// # Errors
    /// [`MiddlewareError`] when the endpoints of the node graph cannot be created.
    pub fn on_with(middleware: Arc<dyn Middleware>, remaps: RemapRules) -> Result<Self, MiddlewareError> {
        let rpc = RpcThread::start().map_err(MiddlewareError::ServiceThread)?;
        let (graph, own_services, nodes) = (Graph::join(&*middleware)?, Mutex::default(), Mutex::default());
        Ok(Self { shared: Arc::new(Shared { graph, own_services, rpc, middleware, remaps, nodes }) })
    }

    /// Creates a node, under another name where a remapping rule says so. It offers the service
    /// `~/get_type_description`, as all nodes of Jazzy do.
    ///
    /// # Errors
    /// [`NodeError`] when this participant has a node of that name, or the engine refuses the service.
    pub fn create_node(&self, name: NodeName) -> Result<Node, NodeError> {
        let given = name;
        let name = self.shared.remaps.node(&given)?;
        if !self.shared.graph.add_node(&name) {
            return Err(NodeError::Exists(name));
        }
        let membership = Arc::new(Membership { shared: Arc::clone(&self.shared), name });
        let node = Node { membership };
        node.serve_own::<GetTypeDescription>(type_description::SERVICE, type_description::answer)?;
        self.shared.nodes().insert(given, Arc::downgrade(&node.membership));
        Ok(node)
    }

    /// The endpoints of other participants that are known at this moment.
    #[must_use]
    pub fn remote_endpoints(&self) -> Vec<RemoteEndpoint> {
        self.shared.middleware.remote_endpoints()
    }

    /// The nodes of other participants. Those that were there before take some seconds to be heard of.
    #[must_use]
    pub fn remote_nodes(&self) -> Vec<RemoteNode> {
        self.shared.graph.remote_nodes(&self.shared.middleware.remote_endpoints())
    }
}

/// A ROS 2 node. It is in the graph of the others until it and its publishers and subscriptions are dropped.
#[derive(Clone)]
pub struct Node {
    pub(super) membership: Arc<Membership>,
}

pub(super) struct Membership {
    pub(super) shared: Arc<Shared>,
    name: NodeName,
}

impl Shared {
    fn nodes(&self) -> std::sync::MutexGuard<'_, BTreeMap<NodeName, Weak<Membership>>> {
        self.nodes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Membership {
    fn drop(&mut self) {
        self.shared.graph.remove_node(&self.name);
        let services = self.own_services().remove(&self.name);
        // Not under the lock, which their going does not need.
        drop(services);
    }
}

impl Membership {
    fn own_services(&self) -> MutexGuard<'_, HashMap<NodeName, Vec<RequestServer>>> {
        self.shared.own_services.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Node {
    /// Offers a service for as long as the node lives, without keeping it alive.
    fn serve_own<S: downbeat_msgs::Service>(
        &self,
        service: &str,
        answer: impl Fn(&S::Request) -> S::Response + Send + 'static,
    ) -> Result<(), NodeError> {
        let Membership { shared, name: node } = &*self.membership;
        let name = self.service_name(service)?;
        let endpoint = name.endpoint(&ServiceType::new(S::TYPE_NAME)?, QosProfile::SERVICES);
        let on_request = super::service::typed::<S>(move |request, reply| {
            let result = reply.send(&answer(&request));
            if let Err(error) = result {
                tracing::warn!(service = name.as_str(), "a request is not answered: {error}");
            }
        });
        let server = RequestServer::new(&*shared.middleware, &shared.rpc, &endpoint, on_request)?;
        let (reader, writer) = server.gids();
        shared.graph.add_endpoint(node, Direction::In, reader);
        shared.graph.add_endpoint(node, Direction::Out, writer);
        self.membership.own_services().entry(node.clone()).or_default().push(server);
        Ok(())
    }

    /// Its namespace and name.
    #[must_use]
    pub fn name(&self) -> &NodeName {
        &self.membership.name
    }

    /// The node of the same participant that was asked for under that name; it is created where there is none.
    ///
    /// # Errors
    /// [`NodeError`] when a remapping rule gives it a name that is not valid, or one that another node has.
    pub fn sibling(&self, name: &NodeName) -> Result<Self, NodeError> {
        let shared = &self.membership.shared;
        let found = shared.nodes().get(name).and_then(Weak::upgrade);
        match found {
            Some(membership) => Ok(Self { membership }),
            None => Participant { shared: Arc::clone(shared) }.create_node(name.clone()),
        }
    }

    /// The topic that `topic` means to this node: expanded, and remapped where a rule says so.
    ///
    /// # Errors
    /// [`NameError`] when ROS 2 does not accept the name, or the one in its place.
    pub fn topic_name(&self, topic: &str) -> Result<TopicName, NameError> {
        self.membership.shared.remaps.topic(TopicName::expand(topic, self.name())?, self.name())
    }

    /// The service that `service` means to this node: expanded, and remapped where a rule says so.
    ///
    /// # Errors
    /// [`NameError`] when ROS 2 does not accept the name, or the one in its place.
    pub fn service_name(&self, service: &str) -> Result<ServiceName, NameError> {
        self.membership.shared.remaps.service(ServiceName::expand(service, self.name())?, self.name())
    }

    /// What to offer or request on a topic now, in view of the endpoints of others that are known.
    ///
    /// # Errors
    /// [`NameError`] when ROS 2 does not accept the name of the topic.
    pub fn resolve_qos(
        &self,
        topic: &str,
        direction: Direction,
        request: &QosRequest,
    ) -> Result<QosProfile, NameError> {
        if let Some(profile) = request.profile() {
            return Ok(profile);
        }
        let topic = self.topic_name(topic)?.to_wire();
        let mut peers = self.membership.shared.middleware.remote_endpoints();
        peers.retain(|peer| peer.topic_name == topic);
        Ok(request.resolve(direction, &peers))
    }

    /// Creates a publisher; `topic` may be absolute, relative or private (`~/…`).
    ///
    /// # Errors
    /// [`NodeError`] when a name is not valid or the engine refuses.
    pub fn publish(
        &self,
        topic: &str,
        message_type: &MessageType,
        qos: QosProfile,
    ) -> Result<Publisher, NodeError> {
        let topic = self.topic_name(topic)?;
        let endpoint = endpoint(&topic, message_type, qos);
        let writer = self.membership.shared.middleware.create_writer(&endpoint)?;
        let warned = Warned::default();
        writer.on_event(warned.and(&topic, Direction::Out, Box::new(|_| ())));
        let listed = Listed::new(&self.membership, Direction::Out, writer.gid());
        Ok(Publisher {
            topic,
            message_type: message_type.clone(),
            qos,
            warned,
            _listed: listed,
            writer,
            _membership: Arc::clone(&self.membership),
        })
    }

    /// Creates a subscription; `topic` may be absolute, relative or private (`~/…`). `on_sample` runs on the thread
    /// that all subscriptions of the participant share, so it must hand over and return.
    ///
    /// # Errors
    /// [`NodeError`] when a name is not valid or the engine refuses.
    pub fn subscribe(
        &self,
        topic: &str,
        message_type: &MessageType,
        qos: QosProfile,
        on_sample: SampleHandler,
    ) -> Result<Subscription, NodeError> {
        let topic = self.topic_name(topic)?;
        let endpoint = endpoint(&topic, message_type, qos);
        let reader = self.membership.shared.middleware.create_reader(&endpoint, on_sample)?;
        let warned = Warned::default();
        reader.on_event(warned.and(&topic, Direction::In, Box::new(|_| ())));
        let listed = Listed::new(&self.membership, Direction::In, reader.gid());
        Ok(Subscription {
            topic,
            message_type: message_type.clone(),
            qos,
            warned,
            _listed: listed,
            reader,
            _membership: Arc::clone(&self.membership),
        })
    }
}

/// Publishes serialized messages on one topic.
pub struct Publisher {
    topic: TopicName,
    message_type: MessageType,
    qos: QosProfile,
    warned: Warned,
    // Fields drop in this order: the entry in the graph, so that no tool sees an endpoint without a node; the endpoint;
    // and perhaps with the last of them the participant.
    _listed: Listed,
    writer: Box<dyn Writer>,
    _membership: Arc<Membership>,
}

impl Publisher {
    /// The absolute name of its topic.
    #[must_use]
    pub fn topic(&self) -> &TopicName {
        &self.topic
    }

    /// The type of its messages.
    #[must_use]
    pub fn message_type(&self) -> &MessageType {
        &self.message_type
    }

    /// What it offers.
    #[must_use]
    pub fn qos(&self) -> QosProfile {
        self.qos
    }

    /// How many subscriptions of other participants are matched.
    #[must_use]
    pub fn matched_subscriptions(&self) -> usize {
        self.writer.matched()
    }

    /// Has `handler` told what happens to the quality of service of this publisher: what holds already, then what changes.
    /// It runs on a thread of the middleware, so it must hand over and return. It replaces the one before.
    pub fn on_event(&self, handler: EventHandler) {
        self.writer.on_event(self.warned.and(&self.topic, Direction::Out, handler));
    }

    /// Publishes one message: encapsulation header (little-endian) and body. Does not block.
    ///
    /// # Errors
    /// [`WriteError`] when it was not sent.
    pub fn publish(&self, cdr: Bytes) -> Result<(), WriteError> {
        self.writer.write(cdr)
    }
}

/// Keeps a subscription alive.
pub struct Subscription {
    topic: TopicName,
    message_type: MessageType,
    qos: QosProfile,
    warned: Warned,
    // In this order, as in a publisher.
    _listed: Listed,
    reader: Box<dyn Reader>,
    _membership: Arc<Membership>,
}

impl Subscription {
    /// The absolute name of its topic.
    #[must_use]
    pub fn topic(&self) -> &TopicName {
        &self.topic
    }

    /// The type of its messages.
    #[must_use]
    pub fn message_type(&self) -> &MessageType {
        &self.message_type
    }

    /// What it requests.
    #[must_use]
    pub fn qos(&self) -> QosProfile {
        self.qos
    }

    /// How many publishers of other participants are matched.
    #[must_use]
    pub fn matched_publishers(&self) -> usize {
        self.reader.matched()
    }

    /// Has `handler` told what happens to the quality of service of this subscription: what holds already, then what
    /// changes. It runs on a thread of the middleware, so it must hand over and return. It replaces the one before.
    pub fn on_event(&self, handler: EventHandler) {
        self.reader.on_event(self.warned.and(&self.topic, Direction::In, handler));
    }
}

/// The entry of an endpoint in the graph, under its node.
pub(super) struct Listed {
    membership: Arc<Membership>,
    direction: Direction,
    endpoint: Gid,
}

impl Listed {
    pub(super) fn new(membership: &Arc<Membership>, direction: Direction, endpoint: Gid) -> Self {
        membership.shared.graph.add_endpoint(&membership.name, direction, endpoint);
        Self { membership: Arc::clone(membership), direction, endpoint }
    }
}

impl Drop for Listed {
    fn drop(&mut self) {
        let Membership { shared, name } = &*self.membership;
        shared.graph.remove_endpoint(name, self.direction, self.endpoint);
    }
}

fn endpoint(topic: &TopicName, message_type: &MessageType, qos: QosProfile) -> Endpoint {
    let send_window = if LARGE_MESSAGES.contains(&message_type.as_str()) {
        Endpoint::SEND_WINDOW_LARGE_SAMPLES
    } else {
        Endpoint::SEND_WINDOW
    };
    let type_hash = KnownType::named(message_type.as_str()).ok().map(|known| known.hash().to_owned());
    Endpoint { send_window, type_hash, ..Endpoint::new(topic.to_wire(), message_type.to_wire(), qos) }
}

/// Types whose messages have hundreds of kilobytes.
const LARGE_MESSAGES: [&str; 5] = [
    "nav_msgs/msg/OccupancyGrid",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/PointCloud",
    "sensor_msgs/msg/PointCloud2",
];
