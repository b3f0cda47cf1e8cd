//! The server's side of services.

use std::any::Any;
use std::sync::Arc;

use super::any_value::{AnyValue, from_any, into_any, look};
use super::call::{CallError, CallId, Reply, ReplyTo};

/// A request with the address for its answer.
pub(crate) struct Incoming<Q> {
    pub(crate) to: ReplyTo,
    pub(crate) request: Q,
}

/// A `Vec<Incoming<Q>>` with its type erased: requests to be delivered to the server.
pub(crate) trait AnyRequests: Any + Send {
    /// Calls `visit` with each request.
    fn each(&self, visit: &mut dyn FnMut(ReplyTo, &dyn Any));
    /// Moves the requests to the heap, for another thread.
    fn split_off(&mut self) -> Box<dyn AnyRequests>;
    /// Appends a request. Returns false, and drops it, if it has another type.
    fn add_any(&mut self, to: ReplyTo, request: AnyValue) -> bool;
    /// Takes all requests, in boxes.
    fn take_any(&mut self) -> Vec<Incoming<AnyValue>>;
}

impl<Q: Send + 'static> AnyRequests for Vec<Incoming<Q>> {
    fn each(&self, visit: &mut dyn FnMut(ReplyTo, &dyn Any)) {
        for incoming in self {
            visit(incoming.to, look(&incoming.request));
        }
    }

    fn split_off(&mut self) -> Box<dyn AnyRequests> {
        Box::new(std::mem::take(self))
    }

    fn add_any(&mut self, to: ReplyTo, request: AnyValue) -> bool {
        let request = from_any(request);
        let is_of_type = request.is_some();
        self.extend(request.map(|request| Incoming { to, request }));
        is_of_type
    }

    fn take_any(&mut self) -> Vec<Incoming<AnyValue>> {
        self.drain(..).map(|Incoming { to, request }| Incoming { to, request: into_any(request) }).collect()
    }
}

/// The requests to one service that its module has not received yet, and its answers.
pub(crate) struct ServerPort<Q, R> {
    name: Arc<str>,
    requests: Vec<Incoming<Q>>,
    /// Requests that the module has received and not answered.
    open: Vec<ReplyTo>,
    answers: Vec<(ReplyTo, Reply<R>)>,
}

impl<Q, R> ServerPort<Q, R> {
    pub(crate) fn new(name: Arc<str>) -> Self {
        Self { name, requests: Vec::new(), open: Vec::new(), answers: Vec::new() }
    }

    /// Takes the new requests, which become open, and leaves an empty buffer.
    pub(crate) fn take_requests(&mut self) -> Vec<Incoming<Q>> {
        let requests = std::mem::take(&mut self.requests);
        self.open.extend(requests.iter().map(|request| request.to));
        requests
    }

    pub(crate) fn give_back(&mut self, buffer: Vec<Incoming<Q>>) {
        if self.requests.is_empty() {
            self.requests = buffer;
        }
    }

    pub(crate) fn answer(&mut self, to: ReplyTo, result: Result<R, String>) {
        let Some(position) = self.open.iter().position(|open| *open == to) else { return };
        self.open.swap_remove(position);
        let refused = |reason| CallError::Refused { service: Arc::clone(&self.name), reason };
        self.answers.push((to, reply(to, result.map_err(refused))));
    }
}

fn reply<R>(to: ReplyTo, result: Result<R, CallError>) -> Reply<R> {
    let (ReplyTo::Module { call, .. } | ReplyTo::External { call }) = to;
    Reply { call: CallId(call), result }
}

/// An `Option<Reply<R>>` with its type erased; the receiver takes it.
pub(crate) trait AnyReply: Any + Send {
    /// The answer or the error.
    fn look(&self) -> Option<Result<&dyn Any, &CallError>>;
    /// Moves the reply to the heap, for another thread.
    fn take_boxed(&mut self) -> Box<dyn AnyReply>;
    /// Takes the reply, with its answer in a box.
    fn take_any(&mut self) -> Option<Reply<AnyValue>>;
}

impl<R: Send + 'static> AnyReply for Option<Reply<R>> {
    fn look(&self) -> Option<Result<&dyn Any, &CallError>> {
        self.as_ref().map(|reply| reply.result.as_ref().map(look))
    }

    fn take_boxed(&mut self) -> Box<dyn AnyReply> {
        Box::new(self.take())
    }

    fn take_any(&mut self) -> Option<Reply<AnyValue>> {
        let Reply { call, result } = self.take()?;
        Some(Reply { call, result: result.map(into_any) })
    }
}

/// Takes a reply with an answer of type `R`, or of boxes on one of the two sides.
pub(super) fn take_reply<R: Send + 'static>(reply: &mut dyn AnyReply) -> Option<Reply<R>> {
    if let Some(reply) = (&mut *reply as &mut dyn Any).downcast_mut::<Option<Reply<R>>>() {
        return reply.take();
    }
    let Reply { call, result } = reply.take_any()?;
    let result = match result {
        Ok(answer) => {
            let answer = from_any(answer);
            debug_assert!(answer.is_some(), "an answer reached a call of another type");
            Ok(answer?)
        }
        Err(error) => Err(error),
    };
    Some(Reply { call, result })
}

/// A [`ServerPort`] with its types erased.
pub(crate) trait AnyServer: Any + Send {
    /// The name of the service.
    fn name(&self) -> &Arc<str>;
    fn has_answers(&self) -> bool;
    /// Takes the requests.
    fn accept(&mut self, staged: &mut dyn AnyRequests);
    /// Passes each answer to `deliver`.
    fn drain_answers(&mut self, deliver: &mut dyn FnMut(ReplyTo, &mut dyn AnyReply));
    /// Answers all open requests with an error.
    fn abandon(&mut self, module: &Arc<str>, failure: Option<&Arc<str>>);
    /// Discards the answers of a run that panicked.
    fn discard_answers(&mut self);
}

impl<Q: Send + 'static, R: Send + 'static> AnyServer for ServerPort<Q, R> {
    fn name(&self) -> &Arc<str> {
        &self.name
    }

    fn has_answers(&self) -> bool {
        !self.answers.is_empty()
    }

    fn accept(&mut self, staged: &mut dyn AnyRequests) {
        let Some(staged) = (&mut *staged as &mut dyn Any).downcast_mut::<Vec<Incoming<Q>>>() else {
            // A server of boxes.
            for Incoming { to, request } in staged.take_any() {
                let is_of_type = self.requests.add_any(to, request);
                debug_assert!(is_of_type, "a request reached a server of another type");
            }
            return;
        };
        if self.requests.is_empty() {
            std::mem::swap(&mut self.requests, staged);
        } else {
            self.requests.append(staged);
        }
    }

    fn drain_answers(&mut self, deliver: &mut dyn FnMut(ReplyTo, &mut dyn AnyReply)) {
        for (to, reply) in self.answers.drain(..) {
            deliver(to, &mut Some(reply));
        }
    }

    fn abandon(&mut self, module: &Arc<str>, failure: Option<&Arc<str>>) {
        let Self { name, requests, open, answers, .. } = self;
        open.extend(requests.drain(..).map(|request| request.to));
        for to in open.drain(..) {
            let (service, module) = (Arc::clone(name), Arc::clone(module));
            let error = match failure {
                Some(reason) => CallError::ServerFailed { service, module, reason: Arc::clone(reason) },
                None => CallError::ServerGone { service, module },
            };
            answers.push((to, reply(to, Err(error))));
        }
    }

    fn discard_answers(&mut self) {
        // The requests of discarded answers are open again.
        let Self { open, answers, .. } = self;
        open.extend(answers.drain(..).map(|(to, _)| to));
    }
}
