//! Warnings about matched endpoints of others whose type has the same name and another definition.
//!
//! DDS matches by names, so their messages are exchanged and may be read wrongly. Nodes of Jazzy announce the
//! hash of each type (REP-2016), by which the difference is known before the first message.

use super::membership::Shared;
use super::{ServiceName, ServiceType};
use crate::middleware::{EndpointEvent, EventHandler, Gid, Middleware, ServiceEndpoint};
use crate::worker::WorkerLink;
use downbeat_msgs::printable;
use parking_lot::Mutex;
use std::collections::HashSet;
use std::sync::{Arc, Weak};

/// The most peers that are logged for one endpoint.
const MOST_PEERS: usize = 64;

/// The definition of the type of one endpoint. The default compares nothing.
#[derive(Clone, Default)]
pub(super) struct Definition(Option<Arc<Comparison>>);

struct Comparison {
    /// What the endpoint is of: `topic '/scan'`.
    of: String,
    type_name: String,
    /// Those that peers with the same definition announce.
    hashes: Vec<String>,
    middleware: Weak<dyn Middleware>,
    worker: WorkerLink,
    peers: Mutex<Peers>,
}

#[derive(Default)]
struct Peers {
    /// Matched, but not compared yet.
    waiting: Vec<Gid>,
    logged: HashSet<Gid>,
}

impl Definition {
    /// That of an endpoint on `of`, such as `topic '/scan'`, whose peers announce one of `hashes`. Without a
    /// hash nothing is compared.
    pub(super) fn new(shared: &Shared, of: String, type_name: &str, hashes: Vec<String>) -> Self {
        let comparison = Comparison {
            of,
            type_name: type_name.to_owned(),
            hashes,
            middleware: Arc::downgrade(&shared.middleware),
            worker: shared.worker.link(),
            peers: Mutex::default(),
        };
        Self((!comparison.hashes.is_empty()).then(|| Arc::new(comparison)))
    }

    /// Handlers for the events of the two endpoints of a service, of requests and of replies.
    pub(super) fn of_service(
        shared: &Shared,
        service: &ServiceName,
        service_type: &ServiceType,
        endpoint: &ServiceEndpoint,
    ) -> [EventHandler; 2] {
        if shared.middleware.services().is_some() {
            // One endpoint, and the engine compares.
            return [of_engine(service, service_type, endpoint.type_hash.clone()), Box::new(|_| ())];
        }
        let of = |part, hashes| {
            Self::new(shared, format!("service '{service}'"), &format!("{service_type}_{part}"), hashes)
                .handler()
        };
        let [request, response] = endpoint.type_hashes.clone();
        // rmw_fastrtps_cpp announces the hash of the request on both topics.
        let replies = response.into_iter().chain(request.clone()).collect();
        [of("Request", request.into_iter().collect()), of("Response", replies)]
    }

    fn handler(self) -> EventHandler {
        Box::new(move |event| {
            if let EndpointEvent::Matched { peer } = event {
                self.compare(*peer);
            }
        })
    }

    /// The hash of the type; `None` if it is unknown.
    pub(super) fn hash(&self) -> Option<&str> {
        self.0.as_ref()?.hashes.first().map(String::as_str)
    }

    /// Logs a matched endpoint if it announces another definition. Runs on a thread of the middleware, which
    /// must not be asked there.
    pub(super) fn compare(&self, peer: Gid) {
        let Some(comparison) = &self.0 else { return };
        let is_first = {
            let waiting = &mut comparison.peers.lock().waiting;
            waiting.push(peer);
            waiting.len() == 1
        };
        if is_first {
            let compared = Arc::clone(comparison);
            comparison.worker.run(move || compared.compare_waiting());
        }
    }
}

/// Logs endpoints of others on a service whose requests or replies would not arrive.
fn of_engine(service: &ServiceName, service_type: &ServiceType, ours: Option<String>) -> EventHandler {
    let (service, service_type) = (service.clone(), service_type.clone());
    let logged = Mutex::new(HashSet::new());
    let is_new = move |peer: Gid| {
        let mut logged = logged.lock();
        logged.len() < MOST_PEERS && logged.insert(peer)
    };
    Box::new(move |event| match event {
        EndpointEvent::IncompatibleDefinition { peer, type_hash } if is_new(*peer) => {
            let of = format!("service '{service}'");
            let ours = ours.as_deref().unwrap_or("unknown");
            let text =
                apart(&of, service_type.as_str(), ours, type_hash.as_deref(), "Calls are not answered");
            tracing::warn!(%peer, "{text}");
        }
        EndpointEvent::IncompatibleType { peer, type_name } if is_new(*peer) => tracing::warn!(
            %peer,
            "service '{service}': another node has it with type {}, this node with {service_type}. Calls are not answered. Give one \
             of them another name",
            printable(type_name),
        ),
        _ => {}
    })
}

/// The warning of an endpoint with which nothing is exchanged, since the definitions differ.
pub(super) fn apart(of: &str, type_name: &str, ours: &str, theirs: Option<&str>, effect: &str) -> String {
    let theirs = theirs.map_or_else(|| "unknown".into(), printable);
    format!(
        "{of}: another node has another definition of {type_name}: its hash is {theirs}, that of this node {ours}. {effect}. \
         Build both nodes with one definition"
    )
}

impl Comparison {
    fn compare_waiting(&self) {
        let waiting: HashSet<Gid> = std::mem::take(&mut self.peers.lock().waiting).into_iter().collect();
        let Some(middleware) = self.middleware.upgrade() else { return };
        for remote in middleware.remote_endpoints() {
            let Some(theirs) = remote.type_hash.filter(|_| waiting.contains(&remote.gid)) else { continue };
            let is_new = !self.hashes.contains(&theirs) && {
                let logged = &mut self.peers.lock().logged;
                logged.len() < MOST_PEERS && logged.insert(remote.gid)
            };
            if is_new {
                tracing::warn!(peer = %remote.gid, "{}", self.warning(&theirs));
            }
        }
    }

    fn warning(&self, theirs: &str) -> String {
        let Self { of, type_name, hashes, .. } = self;
        format!(
            "{of}: another node has another definition of {type_name}: its hash is {theirs}, that of this node {ours}. Messages \
             are exchanged and may be read wrongly; those that cannot be read are counted. Build both nodes with one definition",
            theirs = printable(theirs),
            ours = hashes[0],
        )
    }
}
