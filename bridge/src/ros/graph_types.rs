//! What is known of nodes of other participants.

use super::{MessageType, TopicName};
use crate::middleware::{Direction, Gid, RemoteEndpoint};
use std::collections::BTreeMap;

/// A node of another participant, and its topics.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RemoteNode {
    /// Its namespace and name, `/robot/talker`.
    pub name: String,
    /// Its endpoints whose topic is known already.
    pub endpoints: Vec<RemoteTopic>,
}

/// An endpoint of a node of another participant on a topic.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct RemoteTopic {
    /// The absolute name of the topic.
    pub topic: TopicName,
    /// Its type.
    pub message_type: MessageType,
    /// Whether the node publishes it.
    pub is_published: bool,
}

/// Nodes of others, and whose endpoints are whose.
#[derive(Default)]
pub(super) struct Owners {
    /// The participant and the name of each node.
    pub(super) nodes: Vec<(Gid, String)>,
    /// The node of each endpoint.
    pub(super) owners: BTreeMap<Gid, String>,
}

/// The topic of an endpoint; `None` if it is none of ROS 2.
pub(super) fn remote_topic(endpoint: &RemoteEndpoint) -> Option<RemoteTopic> {
    Some(RemoteTopic {
        topic: TopicName::from_wire(&endpoint.topic_name)?,
        message_type: MessageType::from_wire(&endpoint.type_name)?,
        is_published: endpoint.direction == Direction::Out,
    })
}
