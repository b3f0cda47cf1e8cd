//! Nodes: a name in the graph, and the endpoints under it.

use super::membership::{Membership, Shared};
use super::{NameError, NodeName, ServiceName, TopicName};
use crate::middleware::{Direction, Gid, RemoteEndpoint};
use crate::worker::WorkerLink;
use downbeat_msgs::qos::{QosProfile, QosRequest};
use parking_lot::Mutex;
use std::any::Any;
use std::sync::{Arc, Weak};

/// A ROS 2 node. It is in the graph of the others until it and its publishers and subscriptions are dropped.
#[derive(Clone)]
pub struct Node {
    pub(super) membership: Arc<Membership>,
    /// True if its endpoints do not keep the node alive.
    is_by_itself: bool,
}

impl Node {
    pub(super) fn new(shared: &Arc<Shared>, name: NodeName) -> Self {
        let membership = Membership { shared: Arc::clone(shared), name, attached: Mutex::default() };
        Self { membership: Arc::new(membership), is_by_itself: false }
    }

    pub(super) fn of(membership: Arc<Membership>) -> Self {
        Self { membership, is_by_itself: false }
    }

    /// Its namespace and name.
    #[must_use]
    pub fn name(&self) -> &NodeName {
        &self.membership.name
    }

    /// The same node, for its own endpoints: endpoints created from this handle do not keep the node alive.
    ///
    /// ```
    /// # use downbeat_bridge::middleware::in_process::Hub;
    /// use downbeat_bridge::ros::{MessageType, NodeName, Participant};
    /// use downbeat_msgs::qos::QosProfile;
    ///
    /// # let hub = Hub::new();
    /// let participant = Participant::on(std::sync::Arc::new(hub.join()))?;
    /// let observer = Participant::on(std::sync::Arc::new(hub.join()))?;
    /// let node = participant.create_node(NodeName::new("/", "robot")?)?;
    /// let kind = MessageType::new("std_msgs/msg/Empty")?;
    /// let beat = node.by_itself().publish("~/beat", &kind, QosProfile::DEFAULT)?;
    /// assert_eq!(observer.remote_nodes().len(), 1);
    /// drop(node);
    /// assert_eq!(observer.remote_nodes().len(), 0);
    /// # drop(beat);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn by_itself(&self) -> Self {
        Self { membership: Arc::clone(&self.membership), is_by_itself: true }
    }

    /// Keeps a value until the node disappears from the graph. The value must not hold the node.
    pub fn attach(&self, thing: impl Any + Send) {
        let mut attached = self.membership.attached.lock();
        attached.push(Box::new(thing));
    }

    /// The topic that `topic` means to this node: expanded, and remapped if a rule applies.
    ///
    /// # Errors
    /// [`NameError`] if the name, or the name after remapping, is not valid in ROS 2.
    pub fn topic_name(&self, topic: &str) -> Result<TopicName, NameError> {
        self.membership.shared.remaps.topic(TopicName::expand(topic, self.name())?, self.name())
    }

    /// The service that `service` means to this node: expanded, and remapped if a rule applies.
    ///
    /// # Errors
    /// [`NameError`] if the name, or the name after remapping, is not valid in ROS 2.
    pub fn service_name(&self, service: &str) -> Result<ServiceName, NameError> {
        self.membership.shared.remaps.service(ServiceName::expand(service, self.name())?, self.name())
    }

    /// Resolves the quality of service to offer or request on a topic, depending on the known endpoints of
    /// others.
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
        Ok(resolve(request, direction, &peers))
    }

    /// The worker of the participant.
    pub(crate) fn worker(&self) -> WorkerLink {
        self.membership.shared.worker.link()
    }

    pub(super) fn hold(&self) -> Hold {
        match self.is_by_itself {
            true => Hold::Belongs(self.downgrade()),
            false => Hold::Keeps(Arc::clone(&self.membership)),
        }
    }

    pub(super) fn downgrade(&self) -> Weak<Membership> {
        Arc::downgrade(&self.membership)
    }
}

/// `peers` of the same direction have no influence.
fn resolve(request: &QosRequest, direction: Direction, peers: &[RemoteEndpoint]) -> QosProfile {
    let others = peers.iter().filter(|peer| peer.direction != direction);
    let others: Vec<_> = others.map(RemoteEndpoint::qos).collect();
    match direction {
        Direction::Out => request.offered_to(&others),
        Direction::In => request.requested_of(&others),
    }
}

/// The handle that an endpoint has of its node.
#[derive(Clone)]
pub(super) enum Hold {
    /// The endpoint keeps the node alive.
    Keeps(Arc<Membership>),
    /// The node owns the endpoint.
    Belongs(Weak<Membership>),
}

/// The entry of an endpoint in the graph, under its node.
pub(super) struct Listed {
    hold: Hold,
    direction: Direction,
    endpoint: Gid,
}

impl Listed {
    pub(super) fn new(hold: Hold, direction: Direction, endpoint: Gid) -> Self {
        if let Some(membership) = hold.membership() {
            membership.shared.graph.add_endpoint(&membership.name, direction, endpoint);
        }
        Self { hold, direction, endpoint }
    }
}

impl Hold {
    /// `None` if the node has disappeared from the graph, with all its entries.
    fn membership(&self) -> Option<Arc<Membership>> {
        match self {
            Self::Keeps(membership) => Some(Arc::clone(membership)),
            Self::Belongs(membership) => membership.upgrade(),
        }
    }
}

impl Drop for Listed {
    fn drop(&mut self) {
        if let Some(membership) = self.hold.membership() {
            membership.shared.graph.remove_endpoint(&membership.name, self.direction, self.endpoint);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use downbeat_msgs::qos::Reliability;

    #[test]
    fn endpoints_of_the_same_direction_do_not_decide_on_qos() {
        let qos = QosProfile::SENSOR_DATA;
        let subscription = RemoteEndpoint {
            gid: Gid::default(),
            direction: Direction::In,
            topic_name: "rt/t".into(),
            type_name: "T".into(),
            reliability: qos.reliability,
            durability: qos.durability,
            deadline: qos.deadline,
            lifespan: qos.lifespan,
            liveliness: qos.liveliness,
            liveliness_lease_duration: qos.liveliness_lease_duration,
            type_hash: None,
            node: None,
        };
        let best = resolve(&QosRequest::BEST_AVAILABLE, Direction::In, &[subscription]);
        assert_eq!(best.reliability, Reliability::Reliable, "it is not a publisher");
    }
}
