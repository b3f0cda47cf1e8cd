//! ROS 2 on top of raw topics: names, nodes, and the graph that tools show.

mod client;
mod definition;
mod describe;
mod discovery_info;
mod graph;
mod graph_types;
mod incompatible;
mod introspection;
mod membership;
mod names;
mod network;
mod node;
mod participant;
mod publisher;
mod remap;
mod service;
mod service_name;
mod subscription;
mod type_description;

pub use client::{Client, RawClient};
pub use describe::DescribeError;
pub(crate) use describe::learn;
pub use graph::{RemoteNode, RemoteTopic};
pub use introspection::{Introspection, UnknownIntrospection};
pub use membership::NodeError;
pub use names::{MessageType, NameError, NodeName, TopicName};
pub use network::{EndpointKind, Found, FoundEndpoint, FoundNode};
pub use node::Node;
pub use participant::{Furnishing, Participant, leave_all};
pub use publisher::Publisher;
pub use remap::{Named, ParameterRule, Remap, RemapRule, RemapRules, RuleError};
pub use service::{Reply, Service};
pub use service_name::{ServiceName, ServiceType};
pub use subscription::Subscription;

pub use downbeat_msgs::qos::{Policy, QosRequest};
