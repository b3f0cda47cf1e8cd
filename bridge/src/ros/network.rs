//! What a participant has found in its domain: nodes, and what they publish, hear, offer and call.

use super::{MessageType, Participant, TopicName};
use crate::middleware::{Direction, Gid, RemoteEndpoint};
use downbeat_msgs::downbeat_interfaces::msg::{NetworkEndpoint, NetworkGraph, NetworkNode};
use downbeat_msgs::qos::{Durability, Liveliness, Reliability};
use std::collections::BTreeMap;
use std::time::Duration;

impl Participant {
    /// All nodes of others that are known at this moment, and their endpoints, in an order that does not depend on who was
    /// found first. Endpoints of programs that are no ROS 2 nodes are not among them.
    ///
    /// Nodes that were there before take some seconds to be heard of; until then their endpoints have no node.
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
        let found = self.remote_endpoints();
        let heard = self.shared.graph.remote_owners(&found);
        let mut nodes: Vec<_> = heard
            .nodes
            .into_iter()
            .map(|(participant, name)| NetworkNode {
                name,
                vendor: vendor(participant),
                participant: participant.participant(),
            })
            .collect();
        nodes.sort_by(|a, b| (&a.name, a.participant).cmp(&(&b.name, b.participant)));
        let endpoint =
            |found: &RemoteEndpoint| endpoint(found, &heard.owners).map(|known| (found.gid, known));
        let mut endpoints: Vec<_> = found.iter().filter_map(endpoint).collect();
        endpoints.sort_by(|(a_gid, a), (b_gid, b)| {
            (a.kind, &a.name, &a.node, a_gid).cmp(&(b.kind, &b.name, &b.node, b_gid))
        });
        NetworkGraph { nodes, endpoints: endpoints.into_iter().map(|(_, endpoint)| endpoint).collect() }
    }
}

/// Nodes of others, and whose endpoints are whose.
#[derive(Default)]
pub(super) struct Owners {
    /// The participant and the name of each node.
    pub(super) nodes: Vec<(Gid, String)>,
    /// The node of each endpoint.
    pub(super) owners: BTreeMap<Gid, String>,
}

/// Nothing for what is no topic and no service of ROS 2, and for the second of the two endpoints of a server or client.
fn endpoint(found: &RemoteEndpoint, owners: &BTreeMap<Gid, String>) -> Option<NetworkEndpoint> {
    let (kind, name, type_name) = match (TopicName::from_wire(&found.topic_name), found.direction) {
        (Some(topic), direction) => {
            let kind = match direction {
                Direction::Out => NetworkEndpoint::PUBLISHER,
                Direction::In => NetworkEndpoint::SUBSCRIPTION,
            };
            (kind, topic.to_string(), MessageType::from_wire(&found.type_name)?.to_string())
        }
        (None, direction) => {
            let name = found.topic_name.strip_prefix("rq")?.strip_suffix("Request")?;
            let kind = match direction {
                Direction::Out => NetworkEndpoint::CLIENT,
                Direction::In => NetworkEndpoint::SERVER,
            };
            let request = MessageType::from_wire(&found.type_name)?;
            (kind, name.to_owned(), request.as_str().strip_suffix("_Request")?.to_owned())
        }
    };
    Some(NetworkEndpoint {
        kind,
        name,
        r#type: type_name,
        type_hash: found.type_hash.clone().unwrap_or_default(),
        node: owners.get(&found.gid).cloned().unwrap_or_default(),
        is_reliable: found.reliability == Reliability::Reliable,
        is_transient_local: found.durability == Durability::TransientLocal,
        deadline_ns: nanoseconds(found.deadline),
        is_manual_by_topic: found.liveliness == Liveliness::ManualByTopic,
        liveliness_lease_ns: nanoseconds(found.liveliness_lease_duration),
    })
}

fn nanoseconds(duration: Option<Duration>) -> i64 {
    duration.map_or(0, |duration| i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX))
}

/// The numbers that OMG has given to vendors (<https://www.dds-foundation.org/dds-rtps-vendor-and-product-ids/>).
fn vendor(participant: Gid) -> String {
    match participant.vendor() {
        [1, 1] => "RTI Connext".to_owned(),
        [1, 3] => "OpenDDS".to_owned(),
        [1, 15] => "eProsima Fast DDS".to_owned(),
        [1, 16] => "Eclipse Cyclone DDS".to_owned(),
        [1, 18] => "RustDDS".to_owned(),
        [first, second] => format!("{first:02x}.{second:02x}"),
    }
}
