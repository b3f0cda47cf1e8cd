//! The client side.

use super::mapping::{Mapping, PayloadHeader};
use super::{MAX_IN_FLIGHT, ServiceEndpoint, of_participant, reading};
use crate::middleware::{
    EventHandler, Gid, MatchHandler, Middleware, MiddlewareError, Reader, Sample, SampleIdentity,
    ServiceClient, WriteError, WriteOptions, Writer,
};
use crate::worker::{TimeLimited, Worker, WorkerLink};
use bytes::Bytes;
use parking_lot::{Condvar, Mutex};
use std::collections::{BTreeSet, HashMap};
use std::sync::{Arc, OnceLock, Weak};
use std::time::{Duration, Instant};
use thiserror::Error;

/// Tells the calls of one client apart.
pub type CallNumber = i64;

/// A call failed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum CallError {
    /// No server is matched in both directions, and knows it.
    #[error("service {service}: no server of another process is there")]
    NoServer {
        /// The service.
        service: String,
    },
    /// No answer came in time.
    #[error("service {service}: no answer in {timeout:?}")]
    TimedOut {
        /// The service.
        service: String,
        /// How long the call waited.
        timeout: Duration,
    },
    /// Too many calls wait for an answer.
    #[error("service {service}: {MAX_IN_FLIGHT} calls wait for an answer already")]
    TooManyCalls {
        /// The service.
        service: String,
    },
    /// The request was not written.
    #[error("service {service}: the request was not sent: {error}")]
    Write {
        /// The service.
        service: String,
        /// Why not.
        error: WriteError,
    },
    /// The answer is no message of the type of the service.
    #[error("service {service}: the answer cannot be read: {reason}")]
    Answer {
        /// The service.
        service: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The client was dropped before an answer came.
    #[error("service {service}: the client was closed before an answer came")]
    Closed {
        /// The service.
        service: String,
    },
}

type ReplyHandler = Box<dyn FnOnce(Result<Answer, CallError>) + Send>;

/// The answer to a call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// The number of the call.
    pub number: CallNumber,
    /// Encapsulation header and body.
    pub cdr: Bytes,
}

/// Makes calls. Dropping it removes the endpoints and ends its calls.
pub struct RequestClient {
    shared: Arc<Shared>,
}

/// The endpoints of a client.
enum Endpoints {
    /// The writer of requests and the reader of replies, by whose identity servers name the client.
    Topics { writer: Box<dyn Writer>, reader: Box<dyn Reader> },
    /// That of an engine with services.
    Service(Box<dyn ServiceClient>),
}

/// How the next request goes out.
enum Way<'a> {
    Topic(&'a dyn Writer, WriteOptions),
    Service(&'a dyn ServiceClient),
}

struct Shared {
    service: String,
    endpoints: Endpoints,
    worker: WorkerLink,
    /// The number of the last request. Held while one is numbered and written: the number of the call must be
    /// known before its answer comes.
    last: Mutex<CallNumber>,
    calls: Mutex<Calls>,
    /// For `changed`, which is notified when matches change.
    waiting: Mutex<()>,
    changed: Condvar,
}

#[derive(Default)]
struct Calls {
    by_number: HashMap<CallNumber, Call>,
    by_deadline: BTreeSet<(Instant, CallNumber)>,
}

struct Call {
    timeout: Duration,
    deadline: Instant,
    on_reply: ReplyHandler,
}

impl Calls {
    fn take(&mut self, number: CallNumber) -> Option<Call> {
        let call = self.by_number.remove(&number)?;
        self.by_deadline.remove(&(call.deadline, number));
        Some(call)
    }
}

impl RequestClient {
    /// Creates the two endpoints of a client, whose handlers run on `worker`.
    ///
    /// # Errors
    /// [`MiddlewareError`] when the engine refuses an endpoint.
    pub fn new(
        middleware: &dyn Middleware,
        worker: &Worker,
        service: &ServiceEndpoint,
    ) -> Result<Self, MiddlewareError> {
        if let Some(services) = middleware.services() {
            let client = services.create_client(service)?;
            let shared = Shared::new(service, worker, Endpoints::Service(client));
            return Ok(Self { shared });
        }
        // The reader first: a server that knows the writer then knows where to answer, too.
        let receiver = Arc::new(OnceLock::<Weak<Shared>>::new());
        let incoming = {
            let receiver = Arc::clone(&receiver);
            move |sample| {
                if let Some(shared) = receiver.get().and_then(Weak::upgrade) {
                    shared.receive(sample);
                }
            }
        };
        let reader = middleware.create_reader(&reading(service.replies()), Box::new(incoming))?;
        let writer = middleware.create_writer(&service.requests())?;
        let shared = Shared::new(service, worker, Endpoints::Topics { writer, reader });
        receiver.get_or_init(|| Arc::downgrade(&shared));
        Ok(Self { shared })
    }

    /// The identities of its two endpoints: the reader of replies, the writer of requests. They are the same
    /// where the engine has services.
    #[must_use]
    pub fn gids(&self) -> (Gid, Gid) {
        match &self.shared.endpoints {
            Endpoints::Topics { writer, reader } => (reader.gid(), writer.gid()),
            Endpoints::Service(client) => (client.gid(), client.gid()),
        }
    }

    /// Registers the handlers for events of its two endpoints: of the writer of requests, of the reader of
    /// replies; only the first where the engine has services. They run on a thread of the middleware, so they
    /// must not block.
    pub fn on_events(&self, requests: EventHandler, replies: EventHandler) {
        match &self.shared.endpoints {
            Endpoints::Topics { writer, reader } => {
                writer.on_event(requests);
                reader.on_event(replies);
            }
            Endpoints::Service(client) => client.on_event(requests),
        }
    }

    /// How many servers are matched in both directions.
    #[must_use]
    pub fn servers(&self) -> usize {
        match &self.shared.endpoints {
            Endpoints::Topics { writer, reader } => request_readers(&**writer, &**reader).len(),
            Endpoints::Service(client) => client.servers(),
        }
    }

    /// Waits until a server is available, at most for `timeout`. Returns true if one is.
    #[must_use]
    pub fn wait_for_server(&self, timeout: Duration) -> bool {
        let deadline = Instant::now() + timeout;
        let mut waiting = self.shared.waiting.lock();
        loop {
            if self.servers() > 0 {
                return true;
            }
            let rest = deadline.saturating_duration_since(Instant::now());
            if rest.is_zero() {
                return false;
            }
            self.shared.changed.wait_for(&mut waiting, rest);
        }
    }

    /// Sends a request: encapsulation header (little-endian) and body. `on_reply` is called once, on the
    /// thread of the handlers: with the answer, or with the reason why there is none. Does not block.
    ///
    /// Returns the number of the request, nothing if it was not sent.
    pub fn call(
        &self,
        cdr: Bytes,
        timeout: Duration,
        on_reply: impl FnOnce(Result<Answer, CallError>) + Send + 'static,
    ) -> Option<CallNumber> {
        let on_reply: ReplyHandler = Box::new(on_reply);
        match self.send(cdr, timeout, on_reply) {
            Ok(number) => Some(number),
            Err((on_reply, error)) => {
                self.shared.worker.run(move || on_reply(Err(error)));
                None
            }
        }
    }

    fn send(
        &self,
        cdr: Bytes,
        timeout: Duration,
        on_reply: ReplyHandler,
    ) -> Result<CallNumber, (ReplyHandler, CallError)> {
        let shared = &self.shared;
        let service = || shared.service.clone();
        let mut last = shared.last.lock();
        let number = *last + 1;
        let Some((way, payload)) = shared.way(number, cdr) else {
            return Err((on_reply, CallError::NoServer { service: service() }));
        };
        let deadline = Instant::now() + timeout;
        let is_first = {
            let mut calls = shared.calls.lock();
            if calls.by_number.len() >= MAX_IN_FLIGHT {
                return Err((on_reply, CallError::TooManyCalls { service: service() }));
            }
            calls.by_number.insert(number, Call { timeout, deadline, on_reply });
            calls.by_deadline.insert((deadline, number));
            calls.by_deadline.first() == Some(&(deadline, number))
        };
        let written = match way {
            Way::Topic(writer, options) => writer.write_with(payload, options),
            Way::Service(client) => {
                let shared = Arc::downgrade(shared);
                let on_reply = move |cdr| {
                    if let Some(shared) = shared.upgrade() {
                        shared.answer(number, cdr);
                    }
                };
                client.send(number, payload, timeout, Box::new(on_reply)).map(|()| number)
            }
        };
        match written {
            Ok(written) => {
                *last = written;
                if is_first {
                    shared.worker.look_again();
                }
                Ok(number)
            }
            Err(error) => match shared.calls.lock().take(number) {
                Some(call) => Err((call.on_reply, CallError::Write { service: service(), error })),
                // It has timed out already.
                None => Ok(number),
            },
        }
    }
}

impl Drop for RequestClient {
    fn drop(&mut self) {
        self.shared.end_calls(|service| CallError::Closed { service });
    }
}

impl Shared {
    fn new(service: &ServiceEndpoint, worker: &Worker, endpoints: Endpoints) -> Arc<Self> {
        let shared = Arc::new(Self {
            service: service.name.clone(),
            endpoints,
            worker: worker.link(),
            last: Mutex::default(),
            calls: Mutex::default(),
            waiting: Mutex::default(),
            changed: Condvar::new(),
        });
        let weak = Arc::downgrade(&shared);
        shared.worker.watch(weak.clone() as _);
        let on_match = move || -> MatchHandler {
            let weak = weak.clone();
            Box::new(move || {
                if let Some(shared) = weak.upgrade() {
                    drop(shared.waiting.lock());
                    shared.changed.notify_all();
                }
            })
        };
        match &shared.endpoints {
            Endpoints::Topics { writer, reader } => {
                writer.on_match(on_match());
                reader.on_match(on_match());
            }
            Endpoints::Service(client) => client.on_match(on_match()),
        }
        shared
    }

    /// How the request with this number goes out, and its payload; `None` without a server.
    fn way(&self, number: CallNumber, cdr: Bytes) -> Option<(Way<'_>, Bytes)> {
        let (writer, reader) = match &self.endpoints {
            Endpoints::Topics { writer, reader } => (&**writer, &**reader),
            Endpoints::Service(client) => {
                return (client.servers() > 0).then_some((Way::Service(&**client), cdr));
            }
        };
        let servers = request_readers(writer, reader);
        let mapping = |server: Gid| Mapping::of(writer.vendor_of(server));
        let server = preferred(&servers, mapping)?;
        let is_mixed = servers.iter().any(|other| mapping(*other) != mapping(server));
        let (payload, related) = match mapping(server) {
            Mapping::RelatedIdentity => {
                let number = SampleIdentity::UNKNOWN_NUMBER;
                (cdr, Some(SampleIdentity { endpoint: reader.gid(), number }))
            }
            Mapping::PayloadHeader => (PayloadHeader::of(writer.gid(), number).put_on(&cdr), None),
        };
        let options = WriteOptions { related, only_to: is_mixed.then_some(server) };
        Some((Way::Topic(writer, options), payload))
    }

    /// Answers all calls that wait with an error.
    fn end_calls(&self, error: impl Fn(String) -> CallError) {
        let calls = std::mem::take(&mut *self.calls.lock());
        for (_, call) in calls.by_number {
            let error = error(self.service.clone());
            self.worker.run(move || (call.on_reply)(Err(error)));
        }
    }

    /// Takes a reply, if it is to a call of this client.
    fn receive(&self, sample: Sample) {
        let Endpoints::Topics { writer, reader } = &self.endpoints else { return };
        let (number, cdr) = match sample.related {
            Some(SampleIdentity { endpoint, number })
                if endpoint == reader.gid() || endpoint == writer.gid() =>
            {
                (number, sample.cdr)
            }
            // Of a server of rmw_cyclonedds.
            None => match PayloadHeader::take_off(&sample.cdr) {
                Some((header, cdr)) if header == PayloadHeader::of(writer.gid(), header.number) => {
                    (header.number, cdr)
                }
                _ => return,
            },
            Some(_) => return,
        };
        self.answer(number, cdr);
    }

    /// Answers a call, unless its time is up.
    fn answer(&self, number: CallNumber, cdr: Bytes) {
        if let Some(call) = self.calls.lock().take(number) {
            self.worker.run(move || (call.on_reply)(Ok(Answer { number, cdr })));
        }
    }
}

impl TimeLimited for Shared {
    fn due(&self) -> Option<Instant> {
        self.calls.lock().by_deadline.first().map(|&(deadline, _)| deadline)
    }

    fn expire(&self, now: Instant) {
        loop {
            let call = {
                let mut calls = self.calls.lock();
                let Some(&(_, number)) = calls.by_deadline.first().filter(|(deadline, _)| *deadline <= now)
                else {
                    return;
                };
                calls.take(number)
            };
            if let Some(Call { timeout, on_reply, .. }) = call {
                on_reply(Err(CallError::TimedOut { service: self.service.clone(), timeout }));
            }
        }
    }
}

/// The readers of requests that take what is asked now and whose participants can also answer.
fn request_readers(writer: &dyn Writer, reader: &dyn Reader) -> Vec<Gid> {
    let answering = reader.matched_writers();
    let mut readers = writer.matched_readers();
    readers.retain(|reader| of_participant(&answering, reader.participant()).is_some());
    readers
}

/// Chooses the server for the next request, since a request has one form: a server without the header in the
/// payload if there is one; among equals, the one with the smallest identity.
fn preferred(servers: &[Gid], mapping: impl Fn(Gid) -> Mapping) -> Option<Gid> {
    servers.iter().copied().min_by_key(|server| (mapping(*server) == Mapping::PayloadHeader, *server))
}
