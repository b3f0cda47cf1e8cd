//! Services: remote procedure calls by name, typed and deferred.
//!
//! A call takes effect in the sync phase: the server runs in the next cycle, and its answer reaches the
//! caller in the one after that. Every call gets exactly one [`Reply`].

mod caller;
mod client;
mod registry;
mod server;
mod stand_in;
mod sync;

use std::marker::PhantomData;
use std::sync::Arc;

pub use caller::Caller;
pub(crate) use caller::{AnyCall, ExternalCalls};
pub(crate) use client::{AnyClient, ClientPort};
pub use registry::ServiceInfo;
pub(crate) use registry::ServiceRegistry;
pub(crate) use server::{AnyReply, AnyServer, Incoming, ServerPort};
pub use stand_in::StandIn;
pub(crate) use sync::Services;

use crate::ModuleId;

/// A module's key to a service it calls, from [`Setup::client`](crate::Setup::client).
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

/// Tells the calls of one client apart; they count from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CallId(pub(crate) u64);

/// The end of a call: the answer, or why there is none.
#[derive(Debug)]
pub struct Reply<R> {
    /// The call, as [`Context::call`](crate::Context::call) returned it.
    pub call: CallId,
    /// The answer.
    pub result: Result<R, CallError>,
}

/// Why a call has no answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CallError {
    /// No module serves it.
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
        /// What the server said.
        reason: String,
    },
    /// The server did not answer in time.
    #[error("service \"{service}\": no answer in {timeout:?}")]
    TimedOut {
        /// The service.
        service: Arc<str>,
        /// How long the caller waited.
        timeout: std::time::Duration,
    },
    /// The server was not active, was removed, or panicked, before it answered.
    #[error("service \"{service}\": module \"{module}\" does not run and cannot answer")]
    ServerGone {
        /// The service.
        service: Arc<str>,
        /// The module that served it.
        module: Arc<str>,
    },
    /// The core stopped before there was an answer.
    #[error("service \"{service}\": the core has stopped")]
    Stopped {
        /// The service.
        service: Arc<str>,
    },
}

/// Whom a server answers, and which call; see [`Context::reply`](crate::Context::reply).
///
/// A responder that is dropped answers nothing: the caller's time runs out.
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
