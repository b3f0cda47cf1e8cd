//! Servers and clients of services.

use super::domain::{Announcement, Domain, now_ns, of_service};
use super::repair::{Question, WAITS};
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
use std::sync::atomic::Ordering;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

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
    service: Arc<ServiceEndpoint>,
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
            service: Arc::new(service.clone()),
            querier: Mutex::default(),
        };
        client.querier();
        Ok(client)
    }

    /// The querier for servers with the hash of this client, or of any server if it knows none.
    fn querier(&self) -> Option<Arc<Querier<'static>>> {
        let mut querier = self.querier.lock();
        if querier.is_none() {
            let ServiceEndpoint { name, type_name, type_hash, .. } = &*self.service;
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
        let request = Request {
            domain: Arc::downgrade(&self.domain),
            service: Arc::clone(&self.service),
            servers: self.domain.graph.matched(self.announcement.gid),
            querier: Arc::downgrade(&querier),
            cdr: cdr.clone(),
            attachment,
            until: Instant::now() + timeout.min(LONGEST_QUERY),
            attempts: 0,
            on_reply: Some(on_reply),
        };
        self.domain.outbox.send(cdr.len(), move || request.ask())
    }
}

/// A request until its reply, or until it is too late for one.
struct Request {
    domain: Weak<Domain>,
    service: Arc<ServiceEndpoint>,
    /// Those that were there when it was sent.
    servers: Vec<Gid>,
    /// That of the client, which may be gone.
    querier: Weak<Querier<'static>>,
    cdr: Bytes,
    attachment: Attachment,
    until: Instant,
    attempts: usize,
    /// `None` after the first reply.
    on_reply: Option<Box<dyn FnOnce(Bytes) + Send + Sync>>,
}

impl Request {
    fn ask(self) {
        let (Some(domain), Some(querier)) = (self.domain.upgrade(), self.querier.upgrade()) else { return };
        let get = domain.session.get(querier.key_expr()).target(QueryTarget::AllComplete);
        let get = get.consolidation(ConsolidationMode::None).congestion_control(CongestionControl::Block);
        let timeout = self.until.saturating_duration_since(Instant::now());
        let get = get.timeout(timeout).payload(self.cdr.clone());
        let get = get.attachment(self.attachment.to_bytes().as_slice());
        let asked = Asked(Mutex::new(Some(self)));
        if let Err(error) = get.callback(move |reply| asked.take(reply)).wait() {
            tracing::debug!(%error, "a request was not sent");
        }
    }

    fn take(&mut self, reply: &Reply) {
        let received = match reply.result() {
            Ok(sample) => payload(sample.payload()),
            Err(_) => Err("the server answers with an error"),
        };
        match received {
            Ok(cdr) => {
                if let Some(on_reply) = self.on_reply.take() {
                    on_reply(cdr);
                }
            }
            Err(reason) => {
                if let Some(domain) = self.domain.upgrade() {
                    domain.skipped.count(&self.service.name, reason);
                }
            }
        }
    }

    /// Whether the servers that were to answer are still those that were there.
    fn are_its_servers_there(&self) -> bool {
        let is_known = |domain: Arc<Domain>| self.servers.iter().all(|server| domain.graph.is_known(*server));
        self.domain.upgrade().is_some_and(is_known)
    }
}

/// Takes what is answered. Dropped when nothing follows.
struct Asked(Mutex<Option<Request>>);

impl Asked {
    fn take(&self, reply: Reply) {
        if let Some(request) = &mut *self.0.lock() {
            request.take(&reply);
        }
    }
}

impl Drop for Asked {
    fn drop(&mut self) {
        let Some(request) = self.0.get_mut().take() else { return };
        let domain = request.domain.upgrade().filter(|_| request.on_reply.is_some());
        if let Some(domain) = domain {
            domain.repairs.ask(request);
        }
    }
}

/// A request that ended without a reply found no way to its server.
impl Question for Request {
    fn first_wait(&self) -> Duration {
        WAITS[self.attempts.min(WAITS.len() - 1)]
    }

    /// A server that was restarted is not asked: the one before may have done what it was asked for.
    fn go_on(mut self: Box<Self>) -> Option<(Duration, Box<dyn Question>)> {
        self.attempts += 1;
        if self.attempts <= WAITS.len() && Instant::now() < self.until && self.are_its_servers_there() {
            tracing::debug!(service = self.service.name, "a request without a reply is sent again");
            self.ask();
        }
        None
    }

    fn is_refused(self: Box<Self>) {}
}

fn refused(kind: &'static str, service: &ServiceEndpoint, error: &Error) -> MiddlewareError {
    MiddlewareError::Endpoint {
        endpoint: kind,
        topic_name: service.name.clone(),
        type_name: service.type_name.clone(),
        reason: error.to_string(),
    }
}
