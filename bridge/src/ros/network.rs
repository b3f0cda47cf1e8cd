//! The nodes and endpoints that a participant has discovered.

use super::{MessageType, Participant, ServiceName, TopicName};
use crate::middleware::{Direction, Gid, RemoteEndpoint};
use downbeat_msgs::downbeat_interfaces::msg::{NetworkEndpoint, NetworkGraph, NetworkNode};
use downbeat_msgs::qos::{Durability, Liveliness, Reliability};
use std::collections::BTreeMap;
use std::time::Duration;

/// The nodes and endpoints that a participant has discovered at one moment.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Found {
    /// Nodes, in the order of their names. Several may have the same name.
    pub nodes: Vec<FoundNode>,
    /// Endpoints of nodes, in the order of kind, name and node.
    pub endpoints: Vec<FoundEndpoint>,
}

/// A node of another participant.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FoundNode {
    /// Its namespace and name, `/robot/talker`.
    pub name: String,
    /// The participant it belongs to.
    pub participant: Gid,
    /// The implementation of the middleware, such as `eProsima Fast DDS`.
    pub vendor: String,
    /// With DDS Security the subject of its certificate, which it has proven, such as `CN=/robot`; else
    /// empty.
    pub identity: String,
}

/// An endpoint of a node of another participant on a topic or service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoundEndpoint {
    /// Its role.
    pub kind: EndpointKind,
    /// The absolute name of the topic or service.
    pub name: String,
    /// Its type, as in `std_srvs/srv/SetBool`.
    pub type_name: String,
    /// The node it belongs to, once the node is known.
    pub node: Option<String>,
    /// The endpoint itself; of a server or client that of requests.
    pub remote: RemoteEndpoint,
}

/// The role of a node on a topic or service.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum EndpointKind {
    /// Publishes a topic.
    Publisher,
    /// Subscribes to a topic.
    Subscription,
    /// Offers a service.
    Server,
    /// Calls a service.
    Client,
}

impl EndpointKind {
    /// Whether it belongs to a topic, not to a service.
    #[must_use]
    pub fn is_of_topic(self) -> bool {
        matches!(self, Self::Publisher | Self::Subscription)
    }
}

impl Participant {
    /// All nodes of others that are known at this moment, and their endpoints, in an order that does not
    /// depend on who was found first. Endpoints of programs that are no ROS 2 nodes are left out.
    ///
    /// Nodes that were there before are known after some seconds; until then their endpoints have no node.
    #[must_use]
    pub fn found(&self) -> Found {
        let remote = self.remote_endpoints();
        let heard = self.shared.graph.remote_owners(&remote);
        let of_engine = self.shared.middleware.nodes().map(|nodes| nodes.implementation().to_owned());
        let nodes = heard.nodes.into_iter().map(|(participant, name)| {
            let middleware = &self.shared.middleware;
            let vendor = of_engine.clone().unwrap_or_else(|| vendor(middleware.vendor_of(participant)));
            let identity = middleware.subject_of(participant).unwrap_or_default();
            FoundNode { name, participant, vendor, identity }
        });
        let mut nodes: Vec<_> = nodes.collect();
        nodes.sort();
        let mut endpoints: Vec<_> =
            remote.into_iter().filter_map(|remote| found(remote, &heard.owners)).collect();
        endpoints.sort_by(|a, b| {
            (a.kind, &a.name, &a.node, a.remote.gid).cmp(&(b.kind, &b.name, &b.node, b.remote.gid))
        });
        Found { nodes, endpoints }
    }

    /// What [`Participant::found`] returns, as a message.
    ///
    /// ```
    /// # use downbeat_bridge::middleware::in_process::Hub;
    /// use downbeat_bridge::ros::{MessageType, NodeName, Participant};
    /// use downbeat_msgs::qos::QosProfile;
    ///
    /// # let hub = Hub::new();
    /// let robot = Participant::on(std::sync::Arc::new(hub.join()))?;
    /// let observer = Participant::on(std::sync::Arc::new(hub.join()))?;
    /// let node = robot.create_node(NodeName::new("/", "robot")?)?;
    /// let _states = node.publish("states", &MessageType::new("sensor_msgs/msg/JointState")?, QosProfile::DEFAULT)?;
    /// let network = observer.network();
    /// assert_eq!(network.nodes[0].name, "/robot");
    /// assert_eq!((&*network.endpoints[0].name, &*network.endpoints[0].node), ("/states", "/robot"));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn network(&self) -> NetworkGraph {
        self.found().into()
    }
}

impl From<Found> for NetworkGraph {
    fn from(Found { nodes, endpoints }: Found) -> Self {
        let node = |FoundNode { name, participant, vendor, identity }| NetworkNode {
            name,
            vendor,
            identity,
            participant: participant.participant(),
        };
        Self {
            nodes: nodes.into_iter().map(node).collect(),
            endpoints: endpoints.into_iter().map(NetworkEndpoint::from).collect(),
        }
    }
}

/// `None` for what is no topic and no service of ROS 2, and for the second of the two endpoints of a server
/// or client.
fn found(remote: RemoteEndpoint, owners: &BTreeMap<Gid, String>) -> Option<FoundEndpoint> {
    let (kind, name, type_name) = match (TopicName::from_wire(&remote.topic_name), remote.direction) {
        (Some(topic), direction) => {
            let kind = match direction {
                Direction::Out => EndpointKind::Publisher,
                Direction::In => EndpointKind::Subscription,
            };
            (kind, topic.to_string(), MessageType::from_wire(&remote.type_name)?.to_string())
        }
        (None, direction) => {
            let service = ServiceName::of_requests(&remote.topic_name)?;
            let kind = match direction {
                Direction::Out => EndpointKind::Client,
                Direction::In => EndpointKind::Server,
            };
            let request = MessageType::from_wire(&remote.type_name)?;
            (kind, service.to_string(), request.as_str().strip_suffix("_Request")?.to_owned())
        }
    };
    let node = owners.get(&remote.gid).cloned();
    Some(FoundEndpoint { kind, name, type_name, node, remote })
}

impl From<FoundEndpoint> for NetworkEndpoint {
    fn from(found: FoundEndpoint) -> Self {
        let FoundEndpoint { kind, name, type_name, node, remote } = found;
        Self {
            kind: match kind {
                EndpointKind::Publisher => Self::PUBLISHER,
                EndpointKind::Subscription => Self::SUBSCRIPTION,
                EndpointKind::Server => Self::SERVER,
                EndpointKind::Client => Self::CLIENT,
            },
            name,
            r#type: type_name,
            type_hash: remote.type_hash.unwrap_or_default(),
            node: node.unwrap_or_default(),
            is_reliable: remote.reliability == Reliability::Reliable,
            is_transient_local: remote.durability == Durability::TransientLocal,
            deadline_ns: nanoseconds(remote.deadline),
            is_manual_by_topic: remote.liveliness == Liveliness::ManualByTopic,
            liveliness_lease_ns: nanoseconds(remote.liveliness_lease_duration),
        }
    }
}

fn nanoseconds(duration: Option<Duration>) -> i64 {
    duration.map_or(0, |duration| i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX))
}

/// The numbers that OMG has given to vendors
/// (<https://www.dds-foundation.org/dds-rtps-vendor-and-product-ids/>).
fn vendor(id: [u8; 2]) -> String {
    match id {
        [1, 1] => "RTI Connext".to_owned(),
        [1, 3] => "OpenDDS".to_owned(),
        [1, 15] => "eProsima Fast DDS".to_owned(),
        [1, 16] => "Eclipse Cyclone DDS".to_owned(),
        [1, 18] => "RustDDS".to_owned(),
        // Not among those numbers: this program.
        [1, 0x44] => "downbeat".to_owned(),
        [first, second] => format!("{first:02x}.{second:02x}"),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::middleware::in_process::Hub;
    use crate::middleware::{Endpoint, Middleware};
    use downbeat_msgs::cdr;
    use downbeat_msgs::qos::QosProfile;
    use downbeat_msgs::rmw_dds_common::msg::{Gid as GidMessage, NodeEntitiesInfo, ParticipantEntitiesInfo};
    use std::sync::Arc;

    #[test]
    fn all_is_heard_when_each_participant_has_announced_its_nodes_and_their_endpoints_are_known() {
        let hub = Hub::new();
        let observer = Participant::on(Arc::new(hub.join())).unwrap();
        assert!(!observer.has_heard_all(), "no participant has answered");
        let robot = Participant::on(Arc::new(hub.join())).unwrap();
        assert!(!observer.has_heard_all(), "it has announced no node");
        let node = robot.create_node(super::super::NodeName::new("/", "robot").unwrap()).unwrap();
        let string = MessageType::new("std_msgs/msg/String").unwrap();
        let _text = node.publish("text", &string, QosProfile::DEFAULT).unwrap();
        assert!(observer.has_heard_all());
        let other = hub.join();
        let _writer = other
            .create_writer(&Endpoint::new("rt/other", "std_msgs::msg::dds_::String_", QosProfile::DEFAULT))
            .unwrap();
        assert!(!observer.has_heard_all(), "another participant has announced no nodes");
    }

    #[test]
    fn names_of_others_reach_nobody_with_control_characters() {
        let hub = Hub::new();
        let observer = Participant::on(Arc::new(hub.join())).unwrap();
        let other = hub.join();
        let evil = "\x1b[2J\n\u{9b}31m\u{202e}\x07";
        let string = "std_msgs::msg::dds_::String_";
        let request = "std_srvs::srv::dds_::Trigger_Request_";
        let endpoints = [
            (format!("rt{evil}"), string.to_owned()),
            (format!("rt/{evil}"), string.to_owned()),
            ("rt/type".to_owned(), format!("std_msgs::msg::dds_::{evil}_")),
            ("rt/package".to_owned(), format!("{evil}::msg::dds_::String_")),
            (format!("rq{evil}Request"), request.to_owned()),
            (format!("rq/{evil}Request"), request.to_owned()),
            ("rt/fine".to_owned(), string.to_owned()),
        ];
        let created: Vec<_> = endpoints
            .iter()
            .map(|(topic, kind)| {
                other.create_writer(&Endpoint::new(topic, kind, QosProfile::DEFAULT)).unwrap()
            })
            .collect();
        let qos = QosProfile { durability: Durability::TransientLocal, ..QosProfile::DEFAULT };
        let kind = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";
        let graph = other.create_writer(&Endpoint::new("ros_discovery_info", kind, qos)).unwrap();
        let gids = created.iter().map(|writer| GidMessage { data: writer.gid().0 }).collect();
        let node = NodeEntitiesInfo {
            node_namespace: format!("/{evil}"),
            node_name: evil.to_owned(),
            reader_gid_seq: Vec::new(),
            writer_gid_seq: gids,
        };
        let info = ParticipantEntitiesInfo {
            gid: GidMessage { data: other.gid().0 },
            node_entities_info_seq: vec![node],
        };
        graph.write(cdr::to_vec(&info).into()).unwrap();
        let network = observer.network();
        assert_eq!(network.nodes.len(), 1);
        let names: Vec<_> = network.endpoints.iter().map(|endpoint| &*endpoint.name).collect();
        assert_eq!(names, ["/fine"]);
        let shown = format!("{} {}", network.nodes[0].name, network.endpoints[0].node);
        let nodes = observer.remote_nodes();
        assert_eq!(nodes[0].endpoints.len(), 1);
        let text = shown + &nodes[0].name;
        assert!(!text.contains(|shown: char| shown.is_control() || shown == '\u{202e}'), "{text:?}");
    }
}
