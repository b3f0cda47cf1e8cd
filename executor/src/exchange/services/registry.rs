//! The services of a core, by name.

use std::any::{Any, TypeId, type_name};
use std::collections::HashMap;
use std::fmt;
use std::marker::PhantomData;
use std::sync::Arc;

use super::any_value::AnyValue;
use super::call::ReplyTo;
use super::server::{AnyRequests, Incoming};
use crate::topics::canonical_name;
use crate::{ModuleId, SetupError};

/// A description of a service, see [`Core::services`](crate::Core::services).
#[derive(Clone, Debug)]
pub struct ServiceInfo {
    /// The name, without a leading slash.
    pub name: Arc<str>,
    /// The Rust path of the request type, or its name if the [`ServiceType`] has one.
    pub request_type: &'static str,
    /// The Rust path of the answer type, or its name if the [`ServiceType`] has one.
    pub response_type: &'static str,
    /// The module that serves the service, if any.
    pub server: Option<Arc<str>>,
}

/// The request and answer types of a service. Two values are equal if both their Rust types and their names
/// are.
pub struct ServiceType<Q, R> {
    names: (&'static str, &'static str),
    ids: (TypeId, TypeId),
    types: PhantomData<fn(Q) -> R>,
}

impl<Q: Send + 'static, R: Send + 'static> ServiceType<Q, R> {
    /// The types under their Rust names.
    #[must_use]
    pub fn of() -> Self {
        Self::named(type_name::<Q>(), type_name::<R>())
    }

    /// The types under given names, for Rust types that carry the requests and answers of many services.
    #[must_use]
    pub fn named(request: &'static str, response: &'static str) -> Self {
        let ids = (TypeId::of::<Q>(), TypeId::of::<R>());
        Self { names: (request, response), ids, types: PhantomData }
    }
}

impl ServiceType<AnyValue, AnyValue> {
    /// Types that are given by the identities of their Rust types and by their names: nothing is compiled for
    /// them. Servers and clients that use the service with the Rust types exchange values with those that use
    /// it with boxes.
    #[must_use]
    pub fn erased(request: (TypeId, &'static str), response: (TypeId, &'static str)) -> Self {
        Self { names: (request.1, response.1), ids: (request.0, response.0), types: PhantomData }
    }
}

impl<Q, R> Clone for ServiceType<Q, R> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<Q, R> Copy for ServiceType<Q, R> {}

impl<Q, R> fmt::Debug for ServiceType<Q, R> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("ServiceType").field(&self.names).finish()
    }
}

/// The services that modules offer or call, by name.
#[derive(Default)]
pub(crate) struct ServiceRegistry {
    services: Vec<Service>,
    by_name: HashMap<Arc<str>, usize>,
    /// No service with a smaller index is free.
    free_from: usize,
}

pub(crate) struct Service {
    pub(crate) info: ServiceInfo,
    types: ServiceTypes,
    pub(crate) server: Option<(ModuleId, u32)>,
    /// The number of modules and callers that hold the index.
    users: u32,
    /// Requests to be delivered to the server.
    pub(crate) staged: Box<dyn AnyRequests>,
    pub(crate) has_staged: bool,
    /// True if a [`StandIn`](crate::StandIn) answers while no module serves the service.
    pub(crate) has_stand_in: bool,
    pub(crate) encoder: Option<Encoder>,
}

/// The parts of a service that depend on its types `Q` and `R`.
#[derive(Clone, Copy)]
struct ServiceTypes {
    ids: (TypeId, TypeId),
    /// As in [`ServiceInfo`].
    request: &'static str,
    response: &'static str,
    /// True if all users so far pass requests in boxes.
    is_boxed: bool,
    /// Creates an empty `Vec<Incoming<Q>>`.
    staged: fn() -> Box<dyn AnyRequests>,
}

impl Service {
    pub(crate) fn is_served(&self) -> bool {
        self.server.is_some() || self.has_stand_in
    }

    /// Calls `visit` with each staged request.
    pub(crate) fn each_staged(&self, visit: &mut dyn FnMut(ReplyTo, &dyn Any)) {
        self.staged.each(visit);
    }

    /// Takes the staged requests, for another thread.
    pub(crate) fn take_staged(&mut self) -> Box<dyn AnyRequests> {
        self.staged.split_off()
    }

    /// Stores requests as values from now on, for a user that knows their type.
    fn become_typed(&mut self, types: ServiceTypes) {
        let mut boxed = std::mem::replace(&mut self.staged, (types.staged)());
        for Incoming { to, request } in boxed.take_any() {
            self.staged.add_any(to, request);
        }
        self.types = types;
    }
}

impl ServiceRegistry {
    /// The index of the service of this name; creates the service if there is none. The caller becomes a user
    /// of it.
    pub(crate) fn open<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        of: ServiceType<Q, R>,
        name: &str,
        module: &str,
    ) -> Result<usize, SetupError> {
        let types = ServiceTypes {
            ids: of.ids,
            request: of.names.0,
            response: of.names.1,
            is_boxed: TypeId::of::<Q>() == TypeId::of::<AnyValue>(),
            staged: || Box::new(Vec::<Incoming<Q>>::new()),
        };
        self.open_of(types, name, module)
    }

    /// As [`open`](Self::open), for types given as values; compiled once for all services.
    fn open_of(&mut self, types: ServiceTypes, name: &str, module: &str) -> Result<usize, SetupError> {
        let name = canonical_name(name)
            .ok_or_else(|| SetupError::InvalidServiceName { module: module.into(), service: name.into() })?;
        if let Some(&index) = self.by_name.get(name) {
            let service = &mut self.services[index];
            let known = &service.types;
            if known.ids != types.ids || (known.request, known.response) != (types.request, types.response) {
                return Err(SetupError::ServiceType {
                    module: module.into(),
                    service: name.into(),
                    asked: format!("{} -> {}", types.request, types.response),
                    known: format!("{} -> {}", service.types.request, service.types.response),
                });
            }
            service.users += 1;
            if service.types.is_boxed && !types.is_boxed {
                service.become_typed(types);
            }
            return Ok(index);
        }
        let name: Arc<str> = Arc::from(name);
        let service = Service {
            info: ServiceInfo {
                name: Arc::clone(&name),
                request_type: types.request,
                response_type: types.response,
                server: None,
            },
            types,
            server: None,
            users: 1,
            staged: (types.staged)(),
            has_staged: false,
            has_stand_in: false,
            encoder: None,
        };
        let candidates = self.services.get(self.free_from..).unwrap_or_default();
        let index = match candidates.iter().position(|service| service.users == 0) {
            Some(position) => {
                let free = self.free_from + position;
                self.services[free] = service;
                free
            }
            None => {
                self.services.push(service);
                self.services.len() - 1
            }
        };
        self.free_from = index;
        self.by_name.insert(name, index);
        Ok(index)
    }

    /// Makes the module the server of the service.
    pub(crate) fn serve(
        &mut self,
        index: usize,
        module: &Arc<str>,
        id: ModuleId,
        port: u32,
    ) -> Result<(), SetupError> {
        let service = &mut self.services[index];
        if let Some(known) = &service.info.server {
            return Err(SetupError::DuplicateServer {
                module: module.to_string(),
                service: service.info.name.to_string(),
                known: known.to_string(),
            });
        }
        service.server = Some((id, port));
        service.info.server = Some(Arc::clone(module));
        Ok(())
    }

    /// Ends one use of the service. An unused service is removed.
    pub(crate) fn release(&mut self, index: usize, module: ModuleId) {
        let service = &mut self.services[index];
        if service.server.is_some_and(|(server, _)| server == module) {
            service.server = None;
            service.info.server = None;
        }
        service.users -= 1;
        if service.users == 0 {
            self.free_from = self.free_from.min(index);
            self.by_name.remove(&service.info.name);
            service.staged = Box::new(Vec::<Incoming<()>>::new());
            service.has_staged = false;
        }
    }

    pub(crate) fn get_mut(&mut self, index: usize) -> &mut Service {
        &mut self.services[index]
    }

    pub(crate) fn find(&self, name: &str) -> Option<&Service> {
        self.by_name.get(name).map(|&index| &self.services[index])
    }

    pub(crate) fn name(&self, index: usize) -> &Arc<str> {
        &self.services[index].info.name
    }

    pub(crate) fn infos(&self) -> impl Iterator<Item = &ServiceInfo> {
        self.services.iter().filter(|service| service.users > 0).map(|service| &service.info)
    }

    pub(crate) fn staged(&self) -> bool {
        self.services.iter().any(|service| service.has_staged)
    }

    pub(crate) fn len(&self) -> usize {
        self.services.len()
    }
}

/// Encodes the requests and answers of a service as bytes.
pub(crate) struct Encoder {
    pub(crate) request: Encode,
    pub(crate) answer: Encode,
}

type Encode = Box<dyn Fn(&dyn Any) -> Option<Vec<u8>> + Send>;

impl Encoder {
    pub(crate) fn new<Q: 'static, R: 'static>(request: fn(&Q) -> Vec<u8>, answer: fn(&R) -> Vec<u8>) -> Self {
        Self {
            request: Box::new(move |value| value.downcast_ref().map(request)),
            answer: Box::new(move |value| value.downcast_ref().map(answer)),
        }
    }

    pub(crate) fn of_any(
        request: impl Fn(&dyn Any) -> Option<Vec<u8>> + Send + 'static,
        answer: impl Fn(&dyn Any) -> Option<Vec<u8>> + Send + 'static,
    ) -> Self {
        Self { request: Box::new(request), answer: Box::new(answer) }
    }
}
