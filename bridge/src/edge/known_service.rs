//! The registry of service types.

use super::call::{self, Answers, CallEncoded, EncodedCaller, Outlet, RemoteCall};
use super::event::{self, EncodeEvent};
use super::nearest::nearest;
use downbeat_executor::{Core, Module, ServiceInfo, Setup, SetupError};
use downbeat_msgs::{Service, cdr};
use std::any::type_name;
use std::fmt;
use thiserror::Error;

/// A service type of ROS 2 that this program was compiled with.
#[derive(Clone, Copy)]
pub struct KnownService {
    entry: &'static Entry,
}

/// A type name that no service has.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("unknown service type {name:?}, did you mean {nearest:?}?")]
pub struct UnknownService {
    /// The name that was looked for.
    pub name: String,
    /// The name most like it.
    pub nearest: &'static str,
}

impl KnownService {
    /// The type of that name, such as `std_srvs/srv/SetBool`.
    ///
    /// # Errors
    /// [`UnknownService`] with the nearest name where there is none.
    pub fn named(name: &str) -> Result<Self, UnknownService> {
        Self::all().find(|known| known.name() == name).ok_or_else(|| UnknownService {
            name: name.to_owned(),
            nearest: nearest(name, Self::all().map(Self::name)),
        })
    }

    /// The type of a service of a core, if its request and response are those of a ROS 2 service.
    #[must_use]
    pub fn of(service: &ServiceInfo) -> Option<Self> {
        Self::all().find(|known| (known.entry.rust_types)() == (service.request_type, service.response_type))
    }

    /// Every type, by name.
    pub fn all() -> impl Iterator<Item = Self> {
        ENTRIES.iter().map(|entry| Self { entry })
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
    /// A module completes it in its setup, with [`KnownService::serve`].
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

    /// In a module's setup: serves what an outlet leads to. The module must run when it is answered, so it is best
    /// detached.
    ///
    /// # Errors
    /// [`SetupError`] when the service has other types, or a server already.
    pub fn serve<M: Module>(setup: &mut Setup<'_, M>, outlet: Outlet) -> Result<(), SetupError> {
        let known = outlet.service_type;
        macro_rules! serve_as_the_one {
            ($($service:ty),* $(,)?) => {
                $(if known.name() == <$service as Service>::TYPE_NAME {
                    return call::serve::<$service, M>(setup, outlet);
                })*
            };
        }
        downbeat_msgs::for_each_service!(serve_as_the_one);
        // Not reached: a KnownService is made from the same list.
        Err(setup.refuse(format!("type {known} of service {:?} is in no list", outlet.service)))
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
    default_response: fn() -> Vec<u8>,
    encode_event: EncodeEvent,
}

const fn entry<S: Service>() -> Entry {
    Entry {
        name: S::TYPE_NAME,
        hash: S::TYPE_HASH,
        rust_types: || (type_name::<S::Request>(), type_name::<S::Response>()),
        open_caller: call::open_caller::<S>,
        open_answers: call::open_answers::<S>,
        default_response: || cdr::to_vec(&S::Response::default()),
        encode_event: event::encode_event::<S>,
    }
}

macro_rules! entries {
    ($($service:ty),* $(,)?) => {
        static ENTRIES: &[Entry] = &[$(entry::<$service>()),*];
    };
}
downbeat_msgs::for_each_service!(entries);

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_name_that_is_not_known_is_answered_with_the_nearest() {
        assert_eq!(KnownService::named("std_srvs/srv/SetBool").unwrap().name(), "std_srvs/srv/SetBool");
        let error = KnownService::named("std_srvs/SetBool").unwrap_err();
        assert_eq!(
            error.to_string(),
            "unknown service type \"std_srvs/SetBool\", did you mean \"std_srvs/srv/SetBool\"?"
        );
    }
}
