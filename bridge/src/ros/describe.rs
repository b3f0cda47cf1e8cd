//! The definition of a type that only a node on the network knows: a publisher is asked by
//! `get_type_description`.

use super::membership::Membership;
use super::{Client, MessageType, Node, NodeError, ServiceName, ServiceType, Subscription, TopicName};
use crate::edge::KnownType;
use crate::middleware::RemoteEndpoint;
use crate::middleware::rpc::CallError;
use crate::worker::{WorkerLink, oneshot};
use downbeat_msgs::dynamic::{Definitions, DescribedTypes, TypeDefinition, TypeError, TypeLookupError};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::type_description_interfaces::srv::{
    GetTypeDescription, GetTypeDescriptionRequest, GetTypeDescriptionResponse,
};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};
use thiserror::Error;

/// A type was not described.
#[derive(Debug, Error)]
pub enum DescribeError {
    /// No node is known that could describe the type.
    #[error(
        "no node is known that has topic {topic} with type {type_name} and announces its hash: it may not have been found yet, or be no node \
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
        /// Its reason.
        reason: String,
    },
    /// The description is not that of the type.
    #[error(transparent)]
    Type(#[from] TypeError),
    /// The description is incomplete.
    #[error(transparent)]
    Lookup(#[from] TypeLookupError),
}

impl Node {
    /// Asks a node of another participant that has the topic for the definition of the type, and waits for
    /// the answer. Handlers of the middleware must not call this: they would wait for themselves.
    ///
    /// # Errors
    /// [`DescribeError`] if no node is known that could describe the type, or the response is invalid.
    pub fn describe(
        &self,
        topic: &TopicName,
        message_type: &MessageType,
        timeout: Duration,
    ) -> Result<TypeDefinition, DescribeError> {
        self.describe_endpoint(&topic.to_wire(), topic.as_str(), message_type, message_type.as_str(), timeout)
    }

    /// The same for the request and the response of a service. Nodes of rcl do not describe these by
    /// themselves; those of downbeat do.
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
        // An engine with services announces the hash of the service, and only the topic of requests.
        let is_whole = self.membership.shared.middleware.services().is_some();
        let replies = if is_whole { requests.clone() } else { replies };
        let describe = |topic: &str, part: &str| {
            let message_type =
                MessageType::new(&format!("{service_type}_{part}")).map_err(NodeError::from)?;
            let asked = if is_whole { service_type.as_str() } else { message_type.as_str() };
            self.describe_endpoint(topic, service.as_str(), &message_type, asked, timeout)
        };
        Ok([describe(&requests, "Request")?, describe(&replies, "Response")?])
    }

    fn describe_endpoint(
        &self,
        topic: &str,
        name: &str,
        message_type: &MessageType,
        asked: &str,
        timeout: Duration,
    ) -> Result<TypeDefinition, DescribeError> {
        let inquiry = self.inquire(topic, name, message_type, asked)?;
        // If the service is missing the call reports it.
        let _ = inquiry.client.wait_for_service(timeout);
        let answer = inquiry.client.call_and_wait(&inquiry.request(), timeout);
        inquiry.read(answer)
    }

    /// `topic` as on DDS; `name` for errors; `asked` is the type that is announced with the hash, which has
    /// `message_type` as a part.
    fn inquire(
        &self,
        topic: &str,
        name: &str,
        message_type: &MessageType,
        asked: &str,
    ) -> Result<Inquiry, DescribeError> {
        let (type_name, on_wire) = (message_type.as_str().to_owned(), message_type.to_wire());
        let shared = &self.membership.shared;
        let endpoints = shared.middleware.remote_endpoints();
        let owners = shared.graph.remote_owners(&endpoints).owners;
        let is_whole = asked != type_name;
        let is_of_type = |endpoint: &RemoteEndpoint| is_whole || endpoint.type_name == on_wire;
        let mut known = endpoints
            .iter()
            .filter(|endpoint| endpoint.topic_name == topic && is_of_type(endpoint))
            .filter_map(|endpoint| Some((owners.get(&endpoint.gid)?.clone(), endpoint.type_hash.clone()?)));
        let Some((node, hash)) = known.next() else {
            return Err(DescribeError::NobodyToAsk { topic: name.to_owned(), type_name });
        };
        let service = format!("{node}/get_type_description");
        let client = self.client::<GetTypeDescription>(&service, QosProfile::SERVICES)?;
        Ok(Inquiry { node, type_name, asked: asked.to_owned(), hash, client })
    }
}

/// A question for the definition of a type.
struct Inquiry {
    /// The node to ask.
    node: String,
    type_name: String,
    asked: String,
    hash: String,
    client: Client<GetTypeDescription>,
}

impl Inquiry {
    fn request(&self) -> GetTypeDescriptionRequest {
        GetTypeDescriptionRequest {
            type_name: self.asked.clone(),
            type_hash: self.hash.clone(),
            include_type_sources: false,
        }
    }

    /// Asks, as a task of the worker.
    async fn ask(self, worker: &WorkerLink) -> Result<TypeDefinition, DescribeError> {
        let patience = Instant::now() + PATIENCE;
        while !self.client.is_available() && Instant::now() < patience {
            worker.sleep(LOOK).await;
        }
        let (sender, answer) = oneshot();
        self.client.call(&self.request(), PATIENCE, move |result| sender.send(result));
        let service = self.client.name().to_string();
        let answer = answer.await.unwrap_or(Err(CallError::Closed { service }));
        self.read(answer)
    }

    fn read(
        self,
        answer: Result<GetTypeDescriptionResponse, CallError>,
    ) -> Result<TypeDefinition, DescribeError> {
        let Self { node, type_name, asked, hash, .. } = self;
        let answer = answer.map_err(|error| DescribeError::Call { node: node.clone(), error })?;
        if !answer.successful {
            return Err(DescribeError::Refused { node, type_name: asked, reason: answer.failure_reason });
        }
        let mut described = DescribedTypes::new(&node);
        described.add(&answer.type_description, &hash)?;
        Ok(Definitions::new().with(described).describe(&type_name)?)
    }
}

/// Between two attempts: names of nodes that were there before take some seconds to come.
const PAUSE: Duration = Duration::from_millis(500);

/// How long a node may take to be found, and to answer.
const PATIENCE: Duration = Duration::from_secs(1);

/// Between two looks whether a service is available.
const LOOK: Duration = Duration::from_millis(10);

/// Asks the publishers of a topic for the definition of a raw type that is unknown, until it is known or the
/// subscription is dropped.
pub(crate) fn learn(node: &Node, subscription: &Arc<Subscription>, message_type: KnownType) {
    if !message_type.is_raw() || !message_type.hash().is_empty() {
        return;
    }
    let (worker, node, subscription) = (node.worker(), node.downgrade(), Arc::downgrade(subscription));
    worker.clone().spawn(async move {
        let mut is_logged = false;
        while message_type.hash().is_empty() {
            worker.sleep(PAUSE).await;
            let Some(inquiry) = inquire_publisher(&node, &subscription) else { return };
            let definition = match inquiry {
                Ok(None) => continue,
                Ok(Some(inquiry)) => inquiry.ask(&worker).await,
                Err(error) => Err(error),
            };
            match definition {
                Ok(definition) => message_type.learn(definition),
                Err(error) if !is_logged => {
                    is_logged = true;
                    tracing::debug!("{error}");
                }
                Err(_) => {}
            }
        }
    });
}

/// `None` when the subscription or its node was dropped; no inquiry while there is no publisher.
fn inquire_publisher(
    node: &Weak<Membership>,
    subscription: &Weak<Subscription>,
) -> Option<Result<Option<Inquiry>, DescribeError>> {
    let (node, subscription) = (Node::of(node.upgrade()?), subscription.upgrade()?);
    if subscription.matched_publishers() == 0 {
        return Some(Ok(None));
    }
    // The client of an inquiry does not keep the node.
    let (topic, message_type) = (subscription.topic(), subscription.message_type());
    let node = node.by_itself();
    let inquiry = node.inquire(&topic.to_wire(), topic.as_str(), message_type, message_type.as_str());
    Some(inquiry.map(Some))
}
