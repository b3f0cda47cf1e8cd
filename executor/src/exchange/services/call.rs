//! Types of calls: keys of services, replies and errors.

use std::marker::PhantomData;
use std::sync::Arc;
use std::time::Duration;

use crate::ModuleId;

/// A module's key to a service that it calls, from [`Setup::client`](crate::Setup::client).
pub struct Client<Q, R> {
    pub(crate) port: u32,
    types: PhantomData<fn(Q) -> R>,
}

impl<Q, R> Client<Q, R> {
    pub(crate) fn new(port: u32) -> Self {
        Self { port, types: PhantomData }
    }
}

impl<Q, R> Clone for Client<Q, R> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<Q, R> Copy for Client<Q, R> {}

/// Identifies a call of one client. Numbers count from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CallId(pub(crate) u64);

impl CallId {
    /// The number of calls that the client has made before this one.
    #[must_use]
    pub fn number(self) -> u64 {
        self.0
    }
}

/// The end of a call: the answer, or an error.
#[derive(Debug)]
pub struct Reply<R> {
    /// The call, as [`Context::call`](crate::Context::call) returned it.
    pub call: CallId,
    /// The answer.
    pub result: Result<R, CallError>,
}

/// The reason why a call has no answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CallError {
    /// No module serves the service.
    #[error("service \"{service}\": no module serves it")]
    NoServer {
        /// The service.
        service: Arc<str>,
    },
    /// The server answered with an error.
    #[error("service \"{service}\": {reason}")]
    Refused {
        /// The service.
        service: Arc<str>,
        /// The server's error text.
        reason: String,
    },
    /// The server did not answer in time.
    #[error("service \"{service}\": no answer in {timeout:?}")]
    TimedOut {
        /// The service.
        service: Arc<str>,
        /// The time-out of the call.
        timeout: Duration,
    },
    /// The server was not active, or was removed, before it answered.
    #[error("service \"{service}\": module \"{module}\" does not run and cannot answer")]
    ServerGone {
        /// The service.
        service: Arc<str>,
        /// The module that served the service.
        module: Arc<str>,
    },
    /// The server panicked before it answered, or has not run since a panic.
    #[error("service \"{service}\": module \"{module}\" has failed: {reason}")]
    ServerFailed {
        /// The service.
        service: Arc<str>,
        /// The module that serves it.
        module: Arc<str>,
        /// The message of the panic.
        reason: Arc<str>,
    },
    /// The core stopped before there was an answer.
    #[error("service \"{service}\": the core has stopped")]
    Stopped {
        /// The service.
        service: Arc<str>,
    },
}

/// The address of the answer to one request; see [`Context::reply`](crate::Context::reply).
///
/// A dropped responder sends no answer, and the call ends by its time-out.
#[must_use = "a call is answered with `Context::reply`"]
#[derive(Debug)]
pub struct Responder<Q, R> {
    pub(crate) port: u32,
    pub(crate) to: ReplyTo,
    pub(crate) types: PhantomData<fn(Q) -> R>,
}

/// The address of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ReplyTo {
    Module { module: ModuleId, port: u32, call: u64 },
    External { call: u64 },
}
