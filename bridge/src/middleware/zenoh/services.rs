//! Servers and clients of services.

use super::domain::{Announcement, Domain, now_ns, of_service};
use super::topics::payload;
use crate::middleware::rtps::is_cdr;
use crate::middleware::{
    EventHandler, Gid, MatchHandler, MiddlewareError, ServiceClient, ServiceEndpoint, ServiceReply,
    ServiceRequest, ServiceRequestHandler, ServiceServer, WriteError,
};
use bytes::Bytes;
use downbeat_zenoh::wire::{Attachment, Role, key};
use downbeat_zenoh::zenoh::qos::CongestionControl;
use downbeat_zenoh::zenoh::query::{ConsolidationMode, Querier, Query, QueryTarget, Queryable, Reply};
use downbeat_zenoh::zenoh::{Error, Wait};
use parking_lot::Mutex;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// The longest time that a query stays open. `rmw_zenoh_cpp` waits 600 s, and for results of actions for
/// ever.
const LONGEST_QUERY: Duration = Duration::from_secs(7 * 24 * 3600);

pub(super) struct ZenohServer {
    announcement: Announcement,
    domain: Arc<Domain>,
    _queryable: Queryable<()>,
}

impl ZenohServer {
    pub(super) fn new(
        domain: &Arc<Domain>,
        service: &ServiceEndpoint,
        on_request: ServiceRequestHandler,
    ) -> Result<Self, MiddlewareError> {
        let refused = |error: &Error| refused("server", service, error);
        let token = of_service(service, Role::Server);
        let key = key(domain.domain_id, &token.name, &token.type_name, token.hash.as_deref());
        let take = {
            let (domain, name, key) = (Arc::downgrade(domain), service.name.clone(), key.clone());
            move |query: Query| {
                let Some(domain) = domain.upgrade() else { return };
                match request(&domain, query, &key) {
                    Ok(request) => on_request(request),
                    Err(reason) => domain.skipped.count(&name, reason),
                }
            }
        };
        let queryable = domain.session.declare_queryable(key).complete(true).callback(take);
        let queryable = queryable.wait().map_err(|error| refused(&error))?;
        let described = domain.describe(service.node.as_ref(), token);
        let announcement = domain.announce(described, refused)?;
        Ok(Self { announcement, domain: Arc::clone(domain), _queryable: queryable })
    }
}

impl ServiceServer for ZenohServer {
    fn gid(&self) -> Gid {
        self.announcement.gid
    }

    fn clients(&self) -> usize {
        self.domain.graph.match_count(self.announcement.gid).load(Ordering::Relaxed)
    }

    fn on_event(&self, handler: EventHandler) {
        self.domain.graph.on_event(self.announcement.gid, handler);
    }
}

/// What a peer asked, if it is a request of ROS 2.
fn request(domain: &Arc<Domain>, query: Query, key: &str) -> Result<ServiceRequest, &'static str> {
    let (Some(attachment), Some(received)) = (query.attachment(), query.payload()) else {
        return Err("the request has no payload or no attachment");
    };
    let attachment =
        Attachment::parse(&attachment.to_bytes()).ok_or("its attachment is not that of ROS 2")?;
    let cdr = payload(received)?;
    let client = Gid(attachment.gid);
    let reply = QueryReply {
        was_client_known: domain.graph.is_known(client),
        domain: Arc::clone(domain),
        query,
        key: key.to_owned(),
        attachment,
    };
    Ok(ServiceRequest { cdr, client, number: attachment.sequence_number, reply: Box::new(reply) })
}

/// Answers a query, which ends when this is dropped.
struct QueryReply {
    domain: Arc<Domain>,
    query: Query,
    key: String,
    /// That of the request.
    attachment: Attachment,
    was_client_known: bool,
}

impl ServiceReply for QueryReply {
    fn has_client_left(&self) -> bool {
        self.was_client_known && !self.domain.graph.is_known(Gid(self.attachment.gid))
    }

    fn send(self: Box<Self>, cdr: Bytes) -> Result<(), WriteError> {
        if !is_cdr(&cdr) {
            return Err(WriteError::Encapsulation { found: cdr[..cdr.len().min(4)].to_vec() });
        }
        let Self { domain, query, key, attachment, .. } = *self;
        let attachment = Attachment { source_time_ns: now_ns(), ..attachment };
        domain.outbox.send(cdr.len(), move || {
            let reply = query.reply(key, cdr).attachment(attachment.to_bytes().as_slice());
            if let Err(error) = reply.wait() {
                tracing::debug!(%error, "a reply was not sent");
            }
        })
    }
}

pub(super) struct ZenohClient {
    announcement: Announcement,
    domain: Arc<Domain>,
    service: ServiceEndpoint,
    /// Knows whether a server is reached. `None` while the hash of the service is unknown.
    querier: Mutex<Option<Arc<Querier<'static>>>>,
}

impl ZenohClient {
    pub(super) fn new(domain: &Arc<Domain>, service: &ServiceEndpoint) -> Result<Self, MiddlewareError> {
        let token = of_service(service, Role::Client);
        let described = domain.describe(service.node.as_ref(), token);
        let announcement = domain.announce(described, |error| refused("client", service, error))?;
        let client = Self {
            announcement,
            domain: Arc::clone(domain),
            service: service.clone(),
            querier: Mutex::default(),
        };
        client.querier();
        Ok(client)
    }

    /// The querier for servers with the hash of this client, or of any server if it knows none.
    fn querier(&self) -> Option<Arc<Querier<'static>>> {
        let mut querier = self.querier.lock();
        if querier.is_none() {
            let ServiceEndpoint { name, type_name, type_hash, .. } = &self.service;
            let hash = match type_hash {
                Some(hash) => Some(hash.clone()),
                None if self.announced() == 0 => return None,
                None => self.domain.graph.server_hash(name, type_name),
            };
            let key = key(self.domain.domain_id, name, type_name, hash.as_deref());
            let declared = self.domain.session.declare_querier(key).target(QueryTarget::AllComplete).wait();
            let listening = declared.and_then(|declared| {
                let (domain, gid) = (Arc::downgrade(&self.domain), self.announcement.gid);
                let changed = move |_| {
                    if let Some(domain) = domain.upgrade() {
                        domain.graph.way_changed(gid);
                    }
                };
                declared.matching_listener().callback(changed).background().wait()?;
                Ok(declared)
            });
            match listening {
                Ok(declared) => *querier = Some(Arc::new(declared)),
                Err(error) => tracing::debug!(service = name, %error, "no querier"),
            }
        }
        querier.clone()
    }

    /// The number of servers that are announced with the hash of this client.
    fn announced(&self) -> usize {
        self.domain.graph.match_count(self.announcement.gid).load(Ordering::Relaxed)
    }
}

impl ServiceClient for ZenohClient {
    fn gid(&self) -> Gid {
        self.announcement.gid
    }

    fn servers(&self) -> usize {
        // A token may come before the way to its server is known.
        let is_reached = |querier: Arc<Querier<'_>>| {
            querier.matching_status().wait().is_ok_and(|status| status.matching())
        };
        if self.querier().is_some_and(is_reached) { self.announced() } else { 0 }
    }

    fn on_match(&self, handler: MatchHandler) {
        self.domain.graph.on_match(self.announcement.gid, handler);
    }

    fn on_event(&self, handler: EventHandler) {
        self.domain.graph.on_event(self.announcement.gid, handler);
    }

    fn send(
        &self,
        number: i64,
        cdr: Bytes,
        timeout: Duration,
        on_reply: Box<dyn FnOnce(Bytes) + Send + Sync>,
    ) -> Result<(), WriteError> {
        if !is_cdr(&cdr) {
            return Err(WriteError::Encapsulation { found: cdr[..cdr.len().min(4)].to_vec() });
        }
        let querier = self.querier().ok_or_else(|| WriteError::Engine("no server is known".to_owned()))?;
        let attachment =
            Attachment { sequence_number: number, source_time_ns: now_ns(), gid: self.announcement.gid.0 };
        let first = Mutex::new(Some(on_reply));
        let (domain, name) = (Arc::downgrade(&self.domain), self.service.name.clone());
        let take = move |reply: Reply| {
            let received = match reply.result() {
                Ok(sample) => payload(sample.payload()),
                Err(_) => Err("the server answers with an error"),
            };
            match received {
                Ok(cdr) => {
                    let on_reply = first.lock().take();
                    if let Some(on_reply) = on_reply {
                        on_reply(cdr);
                    }
                }
                Err(reason) => {
                    domain.upgrade().into_iter().for_each(|domain| domain.skipped.count(&name, reason));
                }
            }
        };
        let session = self.domain.session.clone();
        self.domain.outbox.send(cdr.len(), move || {
            let get = session.get(querier.key_expr()).target(QueryTarget::AllComplete);
            let get = get.consolidation(ConsolidationMode::None).congestion_control(CongestionControl::Block);
            let get = get.timeout(timeout.min(LONGEST_QUERY)).payload(cdr).callback(take);
            if let Err(error) = get.attachment(attachment.to_bytes().as_slice()).wait() {
                tracing::debug!(%error, "a request was not sent");
            }
        })
    }
}

fn refused(kind: &'static str, service: &ServiceEndpoint, error: &Error) -> MiddlewareError {
    MiddlewareError::Endpoint {
        endpoint: kind,
        topic_name: service.name.clone(),
        type_name: service.type_name.clone(),
        reason: error.to_string(),
    }
}
