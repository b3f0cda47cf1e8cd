//! The server side.

use super::mapping::{Label, ReturnAddress, request};
use super::{MAX_IN_FLIGHT, REPLY_HOLD, ServiceEndpoint, of_participant, reading};
use crate::limiter::Limiter;
use crate::middleware::{
    EventHandler, Gid, Middleware, MiddlewareError, Reader, Sample, ServiceReply, ServiceRequest,
    ServiceServer, WriteError, WriteOptions, Writer,
};
use crate::worker::{TimeLimited, Worker, WorkerLink};
use bytes::Bytes;
use parking_lot::Mutex;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock, Weak};
use std::time::{Duration, Instant};
use thiserror::Error;

/// How often a server that leaves looks whether its last replies are sent.
const LOOK_AGAIN: Duration = Duration::from_millis(5);

/// Takes the requests of one server, in the order of each client.
pub type RequestHandler = Box<dyn FnMut(IncomingRequest) + Send>;

/// Makes the response to a request that is refused for a reason: encapsulation header (little-endian) and
/// body.
pub type RefusalHandler = Box<dyn Fn(&str) -> Bytes + Send + Sync>;

/// A request that a server has accepted.
pub struct IncomingRequest {
    /// The payload: encapsulation header and body.
    pub cdr: Bytes,
    /// The writer of the request.
    pub client: Gid,
    /// The number of the request at its client.
    pub number: i64,
    /// The identity of the client in ROS 2: the reader that waits for the reply if the request names it, as
    /// that of `rmw_fastrtps` does, and the writer of the request otherwise.
    pub request_client: Gid,
    /// Sends the reply.
    pub responder: Responder,
}

/// A reply was not sent.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ReplyError {
    /// The server was dropped before its answer.
    #[error("the server was closed, its reply was not sent")]
    Closed,
    /// The sample was not written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// Accepts requests and sends replies. Dropping it removes the endpoints, once what was replied has arrived
/// or its time is up; a handler that is running ends by itself.
pub struct RequestServer {
    shared: Arc<Shared>,
    receiving: Receiving,
}

/// The endpoint that receives requests.
enum Receiving {
    Topic(Arc<dyn Reader>),
    Service(Box<dyn ServiceServer>),
}

/// The endpoints of a server whose service is two topics.
struct Topics {
    writer: Box<dyn Writer>,
    /// Empty while it is created.
    reader: OnceLock<Weak<dyn Reader>>,
}

struct Shared {
    service: String,
    /// `None` where the engine has services.
    topics: Option<Topics>,
    worker: WorkerLink,
    is_closed: AtomicBool,
    open: Arc<AtomicUsize>,
    /// Requests beyond those, which wait for their refusal.
    refusing: Arc<AtomicUsize>,
    refusal: OnceLock<RefusalHandler>,
    held: Mutex<VecDeque<Held>>,
    refused: AtomicU64,
    unreachable: AtomicU64,
    unanswered: Limiter,
    unreached: Limiter,
}

/// A reply that waits for its client.
struct Held {
    until: Instant,
    address: ReturnAddress,
    cdr: Bytes,
    _open: Open,
}

impl RequestServer {
    /// Creates the two endpoints of a server. `on_request` runs on `worker`.
    ///
    /// # Errors
    /// [`MiddlewareError`] when the engine refuses an endpoint.
    pub fn new(
        middleware: &dyn Middleware,
        worker: &Worker,
        service: &ServiceEndpoint,
        on_request: RequestHandler,
    ) -> Result<Self, MiddlewareError> {
        let on_request = Arc::new(Mutex::new(on_request));
        if let Some(services) = middleware.services() {
            let shared = Shared::new(service, worker, None);
            let receiver = Arc::downgrade(&shared);
            let incoming = move |ServiceRequest { cdr, client, number, reply }| {
                if let Some(shared) = receiver.upgrade() {
                    let way = Way::Service(reply);
                    accept(
                        &shared,
                        &on_request,
                        Accepted { cdr, client, number, request_client: client, way },
                    );
                }
            };
            let server = services.create_server(service, Box::new(incoming))?;
            return Ok(Self { shared, receiving: Receiving::Service(server) });
        }
        // The writer first: who finds the server by its request topic can be answered.
        let writer = middleware.create_writer(&service.replies())?;
        let shared = Shared::new(service, worker, Some(Topics { writer, reader: OnceLock::new() }));
        let limited: Weak<dyn TimeLimited> = Arc::<Shared>::downgrade(&shared) as _;
        shared.worker.watch(limited);
        let matched = Arc::downgrade(&shared);
        if let Some(topics) = &shared.topics {
            topics.writer.on_match(Box::new(move || {
                if let Some(shared) = matched.upgrade() {
                    shared.send_held();
                }
            }));
        }
        let incoming = {
            let shared = Arc::downgrade(&shared);
            move |sample| {
                if let Some(shared) = shared.upgrade() {
                    accept_sample(&shared, &on_request, sample);
                }
            }
        };
        let reader: Arc<dyn Reader> =
            middleware.create_reader(&reading(service.requests()), Box::new(incoming))?.into();
        if let Some(topics) = &shared.topics {
            // Nothing else sets it.
            let _ = topics.reader.set(Arc::downgrade(&reader));
        }
        Ok(Self { shared, receiving: Receiving::Topic(reader) })
    }

    /// Registers, once, what answers requests that nothing else answers: beyond [`MAX_IN_FLIGHT`], and when a
    /// [`Responder`] is dropped. Without it these clients wait until their own time is up.
    pub fn on_refusal(&self, refusal: RefusalHandler) {
        // The first stays.
        let _ = self.shared.refusal.set(refusal);
    }

    /// The identities of its two endpoints: the reader of requests, the writer of replies. They are the same
    /// where the engine has services.
    #[must_use]
    pub fn gids(&self) -> (Gid, Gid) {
        match (&self.receiving, &self.shared.topics) {
            (Receiving::Topic(reader), Some(topics)) => (reader.gid(), topics.writer.gid()),
            (Receiving::Topic(reader), None) => (reader.gid(), reader.gid()),
            (Receiving::Service(server), _) => (server.gid(), server.gid()),
        }
    }

    /// Registers the handlers for events of its two endpoints: of the reader of requests, of the writer of
    /// replies; only the first where the engine has services. They run on a thread of the middleware, so they
    /// must not block.
    pub fn on_events(&self, requests: EventHandler, replies: EventHandler) {
        match &self.receiving {
            Receiving::Topic(reader) => reader.on_event(requests),
            Receiving::Service(server) => server.on_event(requests),
        }
        if let Some(topics) = &self.shared.topics {
            topics.writer.on_event(replies);
        }
    }

    /// How many clients are matched in both directions.
    #[must_use]
    pub fn matched_clients(&self) -> usize {
        let reader = match &self.receiving {
            Receiving::Topic(reader) => reader,
            Receiving::Service(server) => return server.clients(),
        };
        let readers = self.shared.topics.iter().flat_map(|topics| topics.writer.matched_readers());
        let readers: Vec<_> = readers.collect();
        let is_reached = |writer: &Gid| of_participant(&readers, writer.participant()).is_some();
        reader.matched_writers().iter().filter(|writer| is_reached(writer)).count()
    }

    /// Requests that were refused since [`MAX_IN_FLIGHT`] others were not answered yet, or were no requests.
    #[must_use]
    pub fn refused_requests(&self) -> u64 {
        self.shared.refused.load(Ordering::Relaxed)
    }

    /// Replies that were dropped since their client was not matched within [`REPLY_HOLD`].
    #[must_use]
    pub fn unreachable_clients(&self) -> u64 {
        self.shared.unreachable.load(Ordering::Relaxed)
    }
}

impl Drop for RequestServer {
    fn drop(&mut self) {
        self.shared.is_closed.store(true, Ordering::Release);
        self.shared.deliver();
    }
}

type OnSent = Box<dyn FnOnce(&Bytes) + Send>;

/// Answers one request. A responder that is dropped refuses the request, if the server
/// [can](RequestServer::on_refusal).
#[must_use = "a request is answered with `reply`"]
pub struct Responder {
    server: Weak<Shared>,
    /// `None` once it was used.
    unanswered: Option<Unanswered>,
}

/// A request without a reply so far.
struct Unanswered {
    way: Way,
    open: Open,
    on_sent: Option<OnSent>,
}

/// The way of a reply to its client.
enum Way {
    Topic(ReturnAddress),
    Service(Box<dyn ServiceReply>),
}

/// A request before its place among the open ones is known.
struct Accepted {
    cdr: Bytes,
    client: Gid,
    number: i64,
    request_client: Gid,
    way: Way,
}

impl Responder {
    /// Registers a function that is called with the reply when it was sent or waits for its client.
    pub fn when_sent(mut self, on_sent: impl FnOnce(&Bytes) + Send + 'static) -> Self {
        if let Some(unanswered) = &mut self.unanswered {
            unanswered.on_sent = Some(Box::new(on_sent));
        }
        self
    }

    /// Runs `encode` and sends its result as the reply, on the worker: for threads that must neither
    /// serialize nor write.
    pub fn reply_later(self, encode: impl FnOnce() -> Bytes + Send + 'static) {
        let Some(server) = self.server.upgrade() else { return };
        server.worker.run(move || {
            let server = self.server.clone();
            let Err(error) = self.reply(encode()) else { return };
            if let Some(server) = server.upgrade()
                && let Some(left_out) = server.unanswered.allow()
            {
                let service = &server.service;
                tracing::warn!(service, "a request is not answered: {error}{left_out}");
            }
        });
    }

    /// Refuses the request, if the server [can](RequestServer::on_refusal).
    fn refuse(mut self, reason: &str) {
        let server = self.server.upgrade();
        let refusal = server.as_ref().and_then(|server| Some((server.refusal.get()?)(reason)));
        match refusal {
            Some(refusal) => {
                if let Err(error) = self.reply(refusal) {
                    tracing::debug!(%error, "a refusal was not sent");
                }
            }
            // So that it is not tried again when this is dropped.
            None => drop(self.unanswered.take()),
        }
    }

    /// Sends the reply: encapsulation header (little-endian) and body. Does not block: while the client is
    /// not matched the reply waits, for at most [`REPLY_HOLD`].
    ///
    /// # Errors
    /// [`ReplyError`] when it was not sent.
    pub fn reply(mut self, cdr: Bytes) -> Result<(), ReplyError> {
        let server = self.server.upgrade().filter(|server| !server.is_closed.load(Ordering::Acquire));
        let (Some(server), Some(unanswered)) = (server, self.unanswered.take()) else {
            return Err(ReplyError::Closed);
        };
        let Unanswered { way, open, on_sent } = unanswered;
        let address = match way {
            Way::Topic(address) => address,
            Way::Service(reply) => {
                if reply.has_client_left() {
                    server.unreachable.fetch_add(1, Ordering::Relaxed);
                    return Ok(());
                }
                reply.send(cdr.clone())?;
                on_sent.into_iter().for_each(|on_sent| on_sent(&cdr));
                return Ok(());
            }
        };
        {
            // Held while looking: a client that is matched after the look finds its reply among those that
            // wait.
            let mut held = server.held.lock();
            if !server.reaches(&address) {
                if server.has_left(&address) {
                    server.drop_reply(&address);
                    return Ok(());
                }
                let until = Instant::now() + REPLY_HOLD;
                held.push_back(Held { until, address, cdr: cdr.clone(), _open: open });
                drop(held);
                server.worker.look_again();
                on_sent.into_iter().for_each(|on_sent| on_sent(&cdr));
                return Ok(());
            }
        }
        server.send(&address, &cdr)?;
        on_sent.into_iter().for_each(|on_sent| on_sent(&cdr));
        Ok(())
    }
}

impl Drop for Responder {
    fn drop(&mut self) {
        if let (Some(server), Some(unanswered)) = (self.server.upgrade(), self.unanswered.take())
            && server.refusal.get().is_some()
        {
            let unanswered = Some(unanswered);
            let responder = Self { server: Weak::clone(&self.server), unanswered };
            server.worker.run(move || responder.refuse("the server has dropped the request"));
        }
    }
}

/// The place of a request among those that are not answered.
struct Open(Arc<AtomicUsize>);

impl Open {
    fn new(count: &Arc<AtomicUsize>) -> Option<Self> {
        let more = |open: usize| (open < MAX_IN_FLIGHT).then_some(open + 1);
        count.fetch_update(Ordering::AcqRel, Ordering::Acquire, more).ok()?;
        Some(Self(Arc::clone(count)))
    }
}

impl Drop for Open {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

fn accept_sample(shared: &Arc<Shared>, on_request: &Arc<Mutex<RequestHandler>>, sample: Sample) {
    let (client, number) = (sample.writer, sample.sequence_number);
    let vendor = shared.topics.as_ref().map_or(client.vendor(), |topics| topics.writer.vendor_of(client));
    let Some((address, cdr)) = request(sample, vendor) else {
        shared.refuse(client, "it is too short for its header");
        return;
    };
    let request_client = address.reader.unwrap_or(client);
    accept(shared, on_request, Accepted { cdr, client, number, request_client, way: Way::Topic(address) });
}

fn accept(shared: &Arc<Shared>, on_request: &Arc<Mutex<RequestHandler>>, accepted: Accepted) {
    let Accepted { cdr, client, number, request_client, way } = accepted;
    let responder = |way, open| Responder {
        server: Arc::downgrade(shared),
        unanswered: Some(Unanswered { way, open, on_sent: None }),
    };
    let Some(open) = Open::new(&shared.open) else {
        const REASON: &str = "1024 requests are not answered yet";
        shared.refuse(client, REASON);
        if shared.refusal.get().is_some()
            && let Some(place) = Open::new(&shared.refusing)
        {
            let responder = responder(way, place);
            shared.worker.run(move || responder.refuse(REASON));
        }
        return;
    };
    let responder = responder(way, open);
    let request = IncomingRequest { cdr, client, number, request_client, responder };
    let (server, on_request) = (Arc::downgrade(shared), Arc::clone(on_request));
    shared.worker.run(move || {
        if server.upgrade().is_some_and(|server| !server.is_closed.load(Ordering::Acquire)) {
            on_request.lock()(request);
        }
    });
}

impl Shared {
    fn new(service: &ServiceEndpoint, worker: &Worker, topics: Option<Topics>) -> Arc<Self> {
        Arc::new(Self {
            service: service.name.clone(),
            topics,
            worker: worker.link(),
            is_closed: AtomicBool::new(false),
            open: Arc::default(),
            refusing: Arc::default(),
            refusal: OnceLock::new(),
            held: Mutex::default(),
            refused: AtomicU64::new(0),
            unreachable: AtomicU64::new(0),
            unanswered: Limiter::default(),
            unreached: Limiter::default(),
        })
    }

    /// The matched readers of replies.
    fn reply_readers(&self) -> Vec<Gid> {
        self.topics.as_ref().map(|topics| topics.writer.matched_readers()).unwrap_or_default()
    }

    fn refuse(&self, client: Gid, reason: &str) {
        if self.refused.fetch_add(1, Ordering::Relaxed) == 0 {
            let service = &self.service;
            tracing::warn!(service, %client, "a request was refused: {reason}; from now on this is only counted");
        }
    }

    fn reaches(&self, address: &ReturnAddress) -> bool {
        let readers = self.reply_readers();
        match address.reader {
            Some(reader) => readers.contains(&reader),
            None => of_participant(&readers, address.client.participant()).is_some(),
        }
    }

    /// Returns whether the client that asked is no longer matched.
    fn has_left(&self, address: &ReturnAddress) -> bool {
        let reader = self.topics.as_ref().and_then(|topics| topics.reader.get()?.upgrade());
        reader.is_some_and(|reader| !reader.matched_writers().contains(&address.client))
    }

    /// Counts a reply that its client does not receive, and warns if the client is still there: one that has
    /// left does not want it any more.
    fn drop_reply(&self, address: &ReturnAddress) {
        let (service, client) = (&self.service, address.client);
        self.unreachable.fetch_add(1, Ordering::Relaxed);
        if self.has_left(address) {
            tracing::debug!(service, %client, "a reply was dropped: the client has left");
        } else if let Some(left_out) = self.unreached.allow() {
            tracing::warn!(
                service,
                %client,
                "a reply was dropped: the client that asked was not matched within {REPLY_HOLD:?}{left_out}"
            );
        }
    }

    fn send(&self, address: &ReturnAddress, cdr: &Bytes) -> Result<(), ReplyError> {
        let Some(topics) = &self.topics else { return Err(ReplyError::Closed) };
        let readers = topics.writer.matched_readers();
        let reader = address.reader.or_else(|| of_participant(&readers, address.client.participant()));
        let (payload, related) = match address.label {
            Label::Related(identity) => (cdr.clone(), Some(identity)),
            Label::Header(header) => (header.put_on(cdr), None),
        };
        topics.writer.write_with(payload, WriteOptions { related, only_to: reader })?;
        Ok(())
    }

    /// Waits until replies have reached their clients: a server that answers and leaves would take along what
    /// waits for a client, or was lost on the way and would be sent again.
    fn deliver(&self) {
        let Some(topics) = &self.topics else { return };
        let may_arrive = |held: &Held| Instant::now() < held.until && !self.has_left(&held.address);
        while self.held.lock().iter().any(may_arrive) {
            std::thread::sleep(LOOK_AGAIN);
        }
        topics.writer.flush(REPLY_HOLD);
    }

    fn send_held(&self) {
        let reached: VecDeque<Held> = {
            let mut held = self.held.lock();
            let (reached, waiting) = held.drain(..).partition(|held| self.reaches(&held.address));
            *held = waiting;
            reached
        };
        for Held { address, cdr, .. } in reached {
            if let Err(error) = self.send(&address, &cdr) {
                tracing::debug!(service = self.service, %error, "a reply that waited for its client was not sent");
            }
        }
    }
}

impl TimeLimited for Shared {
    fn due(&self) -> Option<Instant> {
        self.held.lock().front().map(|held| held.until)
    }

    fn expire(&self, now: Instant) {
        let mut held = self.held.lock();
        while held.front().is_some_and(|held| held.until <= now) {
            if let Some(Held { address, .. }) = held.pop_front() {
                self.drop_reply(&address);
            }
        }
    }
}
