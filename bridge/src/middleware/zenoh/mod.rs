//! Zenoh as the nodes of `rmw_zenoh_cpp` (Jazzy) speak it, behind [`Middleware`].
//!
//! Keys, tokens and attachments are those of [`downbeat_zenoh::wire`]. Every publisher and subscription is an
//! advanced one of zenoh-ext, which is how transient local samples reach late subscriptions. There is no
//! matching of quality of service: all publishers of a key reach all subscriptions of it. As in
//! `rmw_zenoh_cpp`, deadlines, lifespans and manual liveliness are announced and not enforced, and samples
//! are not acknowledged.
//!
//! Handlers of samples run on threads of the session, on the thread that writes for subscriptions of the
//! same participant, or on that of `repair.rs` for samples that waited for others. Only what must not be
//! dropped goes through a thread of this engine (`outbox.rs`).

mod domain;
mod graph;
mod order;
mod outbox;
mod qos;
mod recheck;
mod repair;
mod services;
mod topics;

use super::{
    Direction, DiscoveryRange, Endpoint, Gid, Middleware, MiddlewareError, NodeIdentity, Nodes,
    ParticipantOptions, Reader, RemoteEndpoint, RemoteNodeIdentity, SampleHandler, ServiceClient,
    ServiceEndpoint, ServiceRequestHandler, ServiceServer, Services, Writer,
};
use domain::{Domain, participant};
use downbeat_msgs::printable;
use downbeat_zenoh::wire::{Role, tokens_of};
use downbeat_zenoh::zenoh::Wait;
use downbeat_zenoh::zenoh::pubsub::Subscriber;
use downbeat_zenoh::zenoh::query::Reply;
use downbeat_zenoh::zenoh::sample::{Sample as ZenohSample, SampleKind};
use downbeat_zenoh::{Reach, RouterCheck};
use graph::{Known, NodeKey};
use services::{ZenohClient, ZenohServer};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use topics::{ZenohReader, ZenohWriter};

/// A session in a ROS domain.
pub struct ZenohParticipant {
    domain: Arc<Domain>,
    _tokens: Subscriber<()>,
    has_heard_all: Arc<AtomicBool>,
}

impl ZenohParticipant {
    /// Joins a domain. Without a router it goes on alone, and meets others when one comes.
    ///
    /// # Errors
    /// [`MiddlewareError::Zenoh`] when the configuration cannot be used or the session is not opened.
    pub fn new(options: &ParticipantOptions) -> Result<Self, MiddlewareError> {
        let domain_id = options.domain_id;
        let reach = match options.discovery_range {
            DiscoveryRange::Off => Reach::Off,
            DiscoveryRange::Localhost | DiscoveryRange::Subnet => Reach::Configured,
        };
        let failed = |reason: String| MiddlewareError::Zenoh { domain_id, reason };
        let (session, check) =
            downbeat_zenoh::open(&options.zenoh, reach).map_err(|error| failed(error.to_string()))?;
        if check == RouterCheck::Missing {
            tracing::warn!(
                "no Zenoh router is there: nodes of other processes are found once one runs. Start it with `downbeat router` or \
                 `ros2 run rmw_zenoh_cpp rmw_zenohd`"
            );
        }
        let domain = Arc::new(Domain::new(session, domain_id)?);
        let arrivals = Arc::new(recheck::start(&domain, &options.zenoh)?);
        let (heard, arrivals_heard) = (Arc::downgrade(&domain), Arc::clone(&arrivals));
        let hear = move |sample: ZenohSample| {
            let Some(domain) = heard.upgrade() else { return };
            match sample.kind() {
                SampleKind::Put => {
                    if domain.graph.appeared(sample.key_expr()) {
                        arrivals_heard.add();
                    }
                }
                SampleKind::Delete => domain.graph.disappeared(sample.key_expr()),
            }
        };
        let tokens = domain.session.liveliness().declare_subscriber(tokens_of(domain_id));
        let tokens = tokens.callback(hear).wait().map_err(|error| domain.failed(&error))?;
        let has_heard_all = Arc::<AtomicBool>::default();
        // Only a question says when all that was there before has been told.
        let asked = Asked {
            domain: Arc::downgrade(&domain),
            arrivals,
            has_heard_all: (check == RouterCheck::Found).then(|| Arc::clone(&has_heard_all)),
        };
        let get = domain.session.liveliness().get(tokens_of(domain_id));
        let get = get.callback(move |reply: Reply| asked.take(&reply)).wait();
        get.map_err(|error| domain.failed(&error))?;
        Ok(Self { domain, _tokens: tokens, has_heard_all })
    }

    /// The number of messages of peers that were no messages of ROS 2 and not passed on.
    #[must_use]
    pub fn skipped(&self) -> u64 {
        self.domain.skipped.total()
    }
}

/// The question for the tokens that were there before. Dropped when all answers have come.
struct Asked {
    domain: std::sync::Weak<Domain>,
    arrivals: Arc<recheck::Arrivals>,
    has_heard_all: Option<Arc<AtomicBool>>,
}

impl Asked {
    fn take(&self, reply: &Reply) {
        if let (Some(domain), Ok(token)) = (self.domain.upgrade(), reply.result())
            && domain.graph.appeared(token.key_expr())
        {
            self.arrivals.add();
        }
    }
}

impl Drop for Asked {
    fn drop(&mut self) {
        if let Some(has_heard_all) = &self.has_heard_all {
            has_heard_all.store(true, Ordering::Release);
        }
    }
}

impl Middleware for ZenohParticipant {
    fn gid(&self) -> Gid {
        self.domain.gid()
    }

    fn create_writer(&self, endpoint: &Endpoint) -> Result<Box<dyn Writer>, MiddlewareError> {
        Ok(Box::new(ZenohWriter::new(&self.domain, endpoint)?))
    }

    fn create_reader(
        &self,
        endpoint: &Endpoint,
        on_sample: SampleHandler,
    ) -> Result<Box<dyn Reader>, MiddlewareError> {
        Ok(Box::new(ZenohReader::new(&self.domain, endpoint, on_sample)?))
    }

    fn remote_endpoints(&self) -> Vec<RemoteEndpoint> {
        self.domain.graph.remote().into_iter().map(|(gid, known)| remote(gid, known)).collect()
    }

    fn nodes(&self) -> Option<&dyn Nodes> {
        Some(self)
    }

    fn services(&self) -> Option<&dyn Services> {
        Some(self)
    }

    fn leave(&self) {
        if let Err(error) = self.domain.session.close().wait() {
            tracing::debug!(%error, "the Zenoh session did not close in order");
        }
    }
}

impl Drop for ZenohParticipant {
    fn drop(&mut self) {
        self.leave();
    }
}

impl Nodes for ZenohParticipant {
    fn add(&self, node: &NodeIdentity) -> Result<(), MiddlewareError> {
        self.domain.add_node(node)
    }

    fn remove(&self, node: &NodeIdentity) {
        self.domain.remove_node(node);
    }

    fn remote(&self) -> Vec<RemoteNodeIdentity> {
        self.domain.graph.remote_nodes().iter().map(identity).collect()
    }

    fn has_heard_all(&self) -> bool {
        self.has_heard_all.load(Ordering::Acquire)
    }

    fn implementation(&self) -> &'static str {
        "Zenoh"
    }
}

impl Services for ZenohParticipant {
    fn create_server(
        &self,
        service: &ServiceEndpoint,
        on_request: ServiceRequestHandler,
    ) -> Result<Box<dyn ServiceServer>, MiddlewareError> {
        Ok(Box::new(ZenohServer::new(&self.domain, service, on_request)?))
    }

    fn create_client(&self, service: &ServiceEndpoint) -> Result<Box<dyn ServiceClient>, MiddlewareError> {
        Ok(Box::new(ZenohClient::new(&self.domain, service)?))
    }
}

/// Another endpoint with the names it would have on DDS; that of a service stands for its requests.
fn remote(gid: Gid, known: Known) -> RemoteEndpoint {
    let Known { node, endpoint } = known;
    let direction = match endpoint.role {
        Role::Publisher | Role::Client => Direction::Out,
        Role::Subscription | Role::Server => Direction::In,
    };
    let is_topic = matches!(endpoint.role, Role::Publisher | Role::Subscription);
    let (topic_name, type_name) = match is_topic {
        true => (format!("rt{}", endpoint.name), endpoint.type_name),
        false => (format!("rq{}Request", endpoint.name), format!("{}Request_", endpoint.type_name)),
    };
    let profile = qos::from_token(&endpoint.qos);
    RemoteEndpoint {
        gid,
        direction,
        topic_name,
        type_name,
        reliability: profile.reliability,
        durability: profile.durability,
        deadline: profile.deadline,
        lifespan: profile.lifespan,
        liveliness: profile.liveliness,
        liveliness_lease_duration: profile.liveliness_lease_duration,
        type_hash: endpoint.hash,
        node: Some(identity(&node)),
    }
}

fn identity(node: &NodeKey) -> RemoteNodeIdentity {
    RemoteNodeIdentity {
        participant: participant(&node.session),
        // Lists and logs print it.
        name: printable(&node.name.to_string()).into_owned(),
    }
}
