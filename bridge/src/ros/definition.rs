//! Warnings about matched endpoints of others whose type has the same name and another definition.
//!
//! DDS matches by names, so their messages are exchanged and may be read wrongly. Nodes of Jazzy announce the
//! hash of each type (REP-2016), by which the difference is known before the first message.

use super::membership::Shared;
use super::{ServiceName, ServiceType};
use crate::middleware::{EndpointEvent, EventHandler, Gid, Middleware};
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
        hashes: &[Option<String>; 2],
    ) -> [EventHandler; 2] {
        let of = |part, hashes| {
            Self::new(shared, format!("service '{service}'"), &format!("{service_type}_{part}"), hashes)
                .handler()
        };
        let [request, response] = hashes.clone();
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
