//! Types of services.

use super::call::{
    self, AnswerEncoded, Answers, CallEncoded, Callees, EncodedCaller, EncodedStandIn, Outlet, RemoteCall,
};
use super::event::{self, EncodeEvent};
use downbeat_executor::{Core, Setup, SetupError};
use downbeat_msgs::{Service, cdr};
use std::any::type_name;
use std::fmt;
use std::marker::PhantomData;
use thiserror::Error;

/// A service type of ROS 2, found through [`Interfaces`](super::Interfaces) or named ([`KnownService::of`]).
#[derive(Clone, Copy)]
pub struct KnownService {
    entry: &'static Entry,
}

/// A type name that no service has.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("unknown service type {name:?}{}", nearest.map(|name| format!(", did you mean {name:?}?")).unwrap_or_default())]
pub struct UnknownService {
    /// The name that was looked for.
    pub name: String,
    /// The name most like it, if one is like it.
    pub nearest: Option<&'static str>,
}

impl KnownService {
    /// The type of a service that is known here. Whether it is registered anywhere makes no difference.
    #[must_use]
    pub fn of<S: Service>() -> Self {
        Self { entry: Of::<S>::ENTRY }
    }

    /// As in `std_srvs/srv/SetBool`.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.entry.name
    }

    /// `RIHS01_` and 64 hexadecimal digits.
    #[must_use]
    pub fn hash(self) -> &'static str {
        self.entry.hash
    }

    /// The response that says nothing, serialized: all its fields have their defaults.
    #[must_use]
    pub fn default_response(self) -> Vec<u8> {
        (self.entry.default_response)()
    }

    /// Serializes events of the service.
    #[must_use]
    pub fn encode_event(self) -> EncodeEvent {
        self.entry.encode_event
    }

    /// Calls a service of modules with serialized requests, from any thread.
    ///
    /// # Errors
    /// [`SetupError`] when the name is not valid or the service has other types.
    pub fn caller(self, core: &mut Core, service: &str) -> Result<EncodedCaller, SetupError> {
        Ok(EncodedCaller::new(service, (self.entry.open_caller)(core, service)?))
    }

    /// Prepares a service that modules call and that something outside the core serves: `call` is given each request.
    /// [`Callees`] complete it.
    ///
    /// # Errors
    /// [`SetupError`] when the name is not valid.
    pub fn outlet(self, core: &mut Core, service: &str, call: impl RemoteCall) -> Result<Outlet, SetupError> {
        let answers_topic = format!("bridge/answers/{}", service.trim_start_matches('/'));
        let answers = (self.entry.open_answers)(core, &answers_topic)?;
        Ok(Outlet {
            service: service.to_owned(),
            service_type: self,
            answers_topic,
            answers,
            call: Box::new(call),
        })
    }

    /// Has requests and answers of a service of modules told as CDR in each
    /// [`ModuleEvent`](downbeat_executor::ModuleEvent).
    ///
    /// # Errors
    /// [`SetupError`] when the name is not valid or the service has other types.
    pub fn encode(self, core: &mut Core, service: &str) -> Result<(), SetupError> {
        (self.entry.encode)(core, service)
    }

    /// Answers calls of modules with serialized answers in place of a server.
    ///
    /// # Errors
    /// [`SetupError`] when the name is not valid or the service has other types.
    pub fn stand_in(self, core: &mut Core, service: &str) -> Result<EncodedStandIn, SetupError> {
        Ok(EncodedStandIn((self.entry.stand_in)(core, service)?))
    }

    pub(super) fn rust_types(self) -> (&'static str, &'static str) {
        (self.entry.rust_types)()
    }

    pub(super) fn serve(self, setup: &mut Setup<'_, Callees>, outlet: Outlet) -> Result<(), SetupError> {
        (self.entry.serve)(setup, outlet)
    }
}

impl fmt::Debug for KnownService {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("KnownService").field(&self.name()).finish()
    }
}

impl fmt::Display for KnownService {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl PartialEq for KnownService {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

impl Eq for KnownService {}

struct Entry {
    name: &'static str,
    hash: &'static str,
    rust_types: fn() -> (&'static str, &'static str),
    open_caller: fn(&mut Core, &str) -> Result<Box<CallEncoded>, SetupError>,
    open_answers: fn(&mut Core, &str) -> Result<Answers, SetupError>,
    serve: fn(&mut Setup<'_, Callees>, Outlet) -> Result<(), SetupError>,
    encode: fn(&mut Core, &str) -> Result<(), SetupError>,
    stand_in: fn(&mut Core, &str) -> Result<Box<AnswerEncoded>, SetupError>,
    default_response: fn() -> Vec<u8>,
    encode_event: EncodeEvent,
}

/// Where the entry of a type is: a constant, so that a handle is a reference to it.
struct Of<S>(PhantomData<S>);

impl<S: Service> Of<S> {
    const ENTRY: &'static Entry = &Entry {
        name: S::TYPE_NAME,
        hash: S::TYPE_HASH,
        rust_types: || (type_name::<S::Request>(), type_name::<S::Response>()),
        open_caller: call::open_caller::<S>,
        open_answers: call::open_answers::<S>,
        serve: call::serve::<S>,
        encode: |core, service| {
            core.encode_service::<S::Request, S::Response>(service, cdr::to_vec, cdr::to_vec)
        },
        stand_in: call::open_stand_in::<S>,
        default_response: || cdr::to_vec(&S::Response::default()),
        encode_event: event::encode_event::<S>,
    };
}
