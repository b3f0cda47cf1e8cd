//! What a type looks like that only a node on the network knows: asked of a publisher by `get_type_description`.

use super::node::Membership;
use super::{MessageType, Node, NodeError, ServiceName, ServiceType, TopicName};
use crate::middleware::rpc::CallError;
use downbeat_msgs::dynamic::{Definitions, DescribedTypes, LookupError, TypeDefinition, TypeError};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::type_description_interfaces::srv::{GetTypeDescription, GetTypeDescriptionRequest};
use std::sync::Weak;
use std::time::Duration;
use thiserror::Error;

/// A type was not described.
#[derive(Debug, Error)]
pub enum DescribeError {
    /// There is nobody to ask.
    #[error(
        "no node is known that has topic {topic} with type {type_name} and tells its hash: it may not have been found yet, or be no node \
         of ROS 2"
    )]
    NobodyToAsk {
        /// The topic.
        topic: String,
        /// The type.
        type_name: String,
    },
    /// The service could not be called.
    #[error("asking {node} for its types: {error}")]
    Call {
        /// The node.
        node: String,
        /// Why not.
        error: CallError,
    },
    /// There is no client for the service.
    #[error(transparent)]
    Client(#[from] NodeError),
    /// The node does not know the type.
    #[error("{node} does not describe {type_name}: {reason}")]
    Refused {
        /// The node.
        node: String,
        /// The type.
        type_name: String,
        /// What it said.
        reason: String,
    },
    /// What it described is not the type.
    #[error(transparent)]
    Type(#[from] TypeError),
    /// What it described is not all of it.
    #[error(transparent)]
    Lookup(#[from] LookupError),
}

/// A node that is not kept alive by this.
pub(crate) struct WeakNode(Weak<Membership>);

impl WeakNode {
    /// The node, if it is still there.
    pub(crate) fn upgrade(&self) -> Option<Node> {
        self.0.upgrade().map(Node::of)
    }
}

impl Node {
    pub(crate) fn weak(&self) -> WeakNode {
        WeakNode(self.downgrade())
    }

    /// Asks a node of another participant that has the topic what the type looks like, and waits for the answer. Not for
    /// handlers of the middleware, which would wait for themselves.
    ///
    /// # Errors
    /// [`DescribeError`] where nobody is known that could be asked, or the answer is none.
    pub fn describe(
        &self,
        topic: &TopicName,
        message_type: &MessageType,
        timeout: Duration,
    ) -> Result<TypeDefinition, DescribeError> {
        self.describe_endpoint(&topic.to_wire(), topic.as_str(), message_type, timeout)
    }

    /// The same for the request and the response of a service. Nodes of rcl do not describe these by themselves; those of
    /// downbeat do.
    ///
    /// # Errors
    /// As [`Node::describe`].
    pub fn describe_service(
        &self,
        service: &ServiceName,
        service_type: &ServiceType,
        timeout: Duration,
    ) -> Result<[TypeDefinition; 2], DescribeError> {
        let [requests, replies] = service.topics();
        let describe = |topic: &str, part: &str| {
            let message_type =
                MessageType::new(&format!("{service_type}_{part}")).map_err(NodeError::from)?;
            self.describe_endpoint(topic, service.as_str(), &message_type, timeout)
        };
        Ok([describe(&requests, "Request")?, describe(&replies, "Response")?])
    }

    /// `topic` as on the wire; `name` for errors.
    fn describe_endpoint(
        &self,
        topic: &str,
        name: &str,
        message_type: &MessageType,
        timeout: Duration,
    ) -> Result<TypeDefinition, DescribeError> {
        let (type_name, on_wire) = (message_type.as_str(), message_type.to_wire());
        let shared = &self.membership.shared;
        let endpoints = shared.middleware.remote_endpoints();
        let owners = shared.graph.remote_owners(&endpoints).owners;
        let mut known = endpoints
            .iter()
            .filter(|endpoint| endpoint.topic_name == topic && endpoint.type_name == on_wire)
            .filter_map(|endpoint| Some((owners.get(&endpoint.gid)?.clone(), endpoint.type_hash.clone()?)));
        let Some((node, hash)) = known.next() else {
            let (topic, type_name) = (name.to_owned(), type_name.to_owned());
            return Err(DescribeError::NobodyToAsk { topic, type_name });
        };
        let service = format!("{node}/get_type_description");
        let client = self.client::<GetTypeDescription>(&service, QosProfile::SERVICES)?;
        // Where it is not there the call says so.
        let _ = client.wait_for_service(timeout);
        let request = GetTypeDescriptionRequest {
            type_name: type_name.to_owned(),
            type_hash: hash.clone(),
            include_type_sources: false,
        };
        let answer = client.call_and_wait(&request, timeout);
        let answer = answer.map_err(|error| DescribeError::Call { node: node.clone(), error })?;
        if !answer.successful {
            let (type_name, reason) = (type_name.to_owned(), answer.failure_reason);
            return Err(DescribeError::Refused { node, type_name, reason });
        }
        let mut described = DescribedTypes::new(&node);
        described.add(&answer.type_description, &hash)?;
        Ok(Definitions::new().with(described).describe(type_name)?)
    }
}
