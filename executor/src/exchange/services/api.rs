//! The use of services by modules and programs: functions of [`Setup`], [`Context`], [`Core`] and
//! [`CoreHandle`].

use std::any::Any;
use std::marker::PhantomData;
use std::sync::Arc;
use std::time::Duration;

use super::client::ClientPort;
use super::registry::Encoder;
use super::server::{Incoming, ServerPort};
use super::{
    AnyValue, CallId, Caller, Client, Reply, Responder, ServiceInfo, ServiceType, Services, ServicesPort,
    StandIn,
};
use crate::cycle::Mechanisms;
use crate::module::{Causes, Direction, Host, Link, SERVICES, TIMERS, Use, UseEnds};
use crate::{Context, Core, CoreHandle, Module, Receipt, Setup, SetupError};

fn services_of(host: &mut dyn Host) -> &mut Services {
    match host.mechanism(SERVICES).and_then(|any| any.downcast_mut()) {
        Some(services) => services,
        None => unreachable!("every core has services, and modules are set up while they do not run"),
    }
}

impl<M: Module> Setup<'_, M> {
    /// Offers a service whose requests are answered at once, with a value or an error text. A service has one
    /// server.
    ///
    /// # Errors
    /// Returns an error if the name is invalid, the service has other types, or it is already served.
    pub fn serve<Q, R, F>(&mut self, service: &str, mut answer: F) -> Result<(), SetupError>
    where
        Q: Send + 'static,
        R: Send + 'static,
        F: FnMut(&mut M, &Q, &mut Context<'_, M::Ports>) -> Result<R, String> + Send + 'static,
    {
        self.serve_with::<Q, R>(ServiceType::of(), service, move |module, request, responder, ctx| {
            let result = answer(module, &request, ctx);
            ctx.reply(responder, result);
        })
    }

    /// Offers a service whose requests are answered later, with [`Context::reply`].
    ///
    /// # Errors
    /// Returns an error if the name is invalid, the service has other types, or it is already served.
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Module, Responder, Setup, SetupError, Time};
    /// # use std::time::Duration;
    /// /// Answers when it has arrived, not when it is asked to go.
    /// #[derive(Default)]
    /// struct Arm {
    ///     asked: Vec<Responder<f64, ()>>,
    /// }
    ///
    /// impl Module for Arm {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.serve_later::<f64, (), _>("reach", |arm, _angle, responder, _| arm.asked.push(responder))?;
    ///         setup.subscribe::<(), _>("arrived", |arm, _, ctx| {
    ///             arm.asked.drain(..).for_each(|responder| ctx.reply(responder, Ok(())));
    ///         })
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("arm", Arm::default())?;
    /// let (sender, answer) = std::sync::mpsc::channel();
    /// core.caller::<f64, ()>("reach")?.call(0.5, Duration::from_secs(9), move |result| drop(sender.send(result)))?;
    /// (0..5).try_for_each(|_| core.cycle())?;
    /// assert!(answer.try_recv().is_err());
    /// core.inlet("arrived")?.publish(())?;
    /// (0..2).try_for_each(|_| core.cycle())?;
    /// assert_eq!(answer.try_recv()?, Ok(()));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn serve_later<Q, R, F>(&mut self, service: &str, take: F) -> Result<(), SetupError>
    where
        Q: Send + 'static,
        R: Send + 'static,
        F: FnMut(&mut M, Q, Responder<Q, R>, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        self.serve_with(ServiceType::of(), service, take)
    }

    /// As [`serve_later`](Self::serve_later), for types with names.
    ///
    /// # Errors
    /// As for [`serve_later`](Self::serve_later).
    pub fn serve_later_of<Q, R, F>(
        &mut self,
        of: ServiceType<Q, R>,
        service: &str,
        take: F,
    ) -> Result<(), SetupError>
    where
        Q: Send + 'static,
        R: Send + 'static,
        F: FnMut(&mut M, Q, Responder<Q, R>, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        self.serve_with(of, service, take)
    }

    /// Declares that the module calls a service; the key is for [`Context::call`]. Each call leads to exactly
    /// one call of `on_reply`, with the answer or, after `timeout`, with an error.
    ///
    /// # Errors
    /// Returns an error if the name is invalid, or the service has other types.
    pub fn client<Q, R, F>(
        &mut self,
        service: &str,
        timeout: Duration,
        on_reply: F,
    ) -> Result<Client<Q, R>, SetupError>
    where
        Q: Send + 'static,
        R: Send + 'static,
        F: FnMut(&mut M, Reply<R>, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        self.client_of(ServiceType::of(), service, timeout, on_reply)
    }

    /// As [`client`](Self::client), for types with names.
    ///
    /// # Errors
    /// As for [`client`](Self::client).
    pub fn client_of<Q, R, F>(
        &mut self,
        of: ServiceType<Q, R>,
        service: &str,
        timeout: Duration,
        mut on_reply: F,
    ) -> Result<Client<Q, R>, SetupError>
    where
        Q: Send + 'static,
        R: Send + 'static,
        F: FnMut(&mut M, Reply<R>, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        let index = self.open_service(of, service, Direction::Out)?;
        let name = Arc::clone(services_of(self.host).registry.name(index));
        let clients = &mut self.io.open_own::<ServicesPort>(SERVICES).clients;
        let port = u32::try_from(clients.len()).unwrap_or(u32::MAX);
        clients.push(Box::new(ClientPort::<Q, R>::new(index, name, timeout)));
        let mut spare = Vec::new();
        self.steps.add(Causes::REPLIES, move |module, ctx| {
            let now = ctx.now();
            let ports = ctx.io().port::<ServicesPort>(SERVICES);
            let Some(client) = ports.and_then(|ports| ports.client::<Q, R>(port)) else { return };
            if !client.has_replies(now) {
                return;
            }
            let mut replies = client.take_replies(now, std::mem::take(&mut spare));
            ctx.io().ask(TIMERS);
            for reply in replies.drain(..) {
                on_reply(module, reply, ctx);
            }
            spare = replies;
        });
        Ok(Client::new(port))
    }

    fn serve_with<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        of: ServiceType<Q, R>,
        service: &str,
        mut take: impl FnMut(&mut M, Q, Responder<Q, R>, &mut Context<'_, M::Ports>) + Send + 'static,
    ) -> Result<(), SetupError> {
        let index = self.open_service(of, service, Direction::In)?;
        let (module, id) = (Arc::clone(&self.io.name), self.io.id);
        let port =
            u32::try_from(self.io.open_own::<ServicesPort>(SERVICES).servers.len()).unwrap_or(u32::MAX);
        let registry = &mut services_of(self.host).registry;
        registry.serve(index, &module, id, port)?;
        let name = Arc::clone(registry.name(index));
        self.io.open_own::<ServicesPort>(SERVICES).servers.push(Box::new(ServerPort::<Q, R>::new(name)));
        self.steps.add(Causes::REQUESTS, move |module, ctx| {
            let ports = ctx.io().port::<ServicesPort>(SERVICES);
            let Some(server) = ports.and_then(|ports| ports.server::<Q, R>(port)) else { return };
            let mut requests = server.take_requests();
            for Incoming { to, request } in requests.drain(..) {
                take(module, request, Responder { port, to, types: PhantomData }, ctx);
            }
            let ports = ctx.io().port::<ServicesPort>(SERVICES);
            if let Some(server) = ports.and_then(|ports| ports.server::<Q, R>(port)) {
                server.give_back(requests);
            }
        });
        Ok(())
    }

    fn open_service<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        of: ServiceType<Q, R>,
        name: &str,
        direction: Direction,
    ) -> Result<usize, SetupError> {
        let name = self.remapped(name);
        let index = services_of(self.host).registry.open(of, &name, &self.io.name)?;
        self.uses.push(Use {
            of: SERVICES,
            direction,
            index,
            ends: UseEnds::AtRemoval,
            give_back: |host, module, used| services_of(host).registry.release(used.index, module),
        });
        Ok(index)
    }
}

impl<P> Context<'_, P> {
    /// Calls a service. The answer or an error is passed to the callback given to
    /// [`Setup::client`](crate::Setup::client).
    pub fn call<Q: Send + 'static, R: Send + 'static>(&mut self, client: Client<Q, R>, request: Q) -> CallId {
        let now = self.now();
        self.io().ask(SERVICES);
        self.io().ask(TIMERS);
        let ports = self.io().port::<ServicesPort>(SERVICES);
        match ports.and_then(|ports| ports.client::<Q, R>(client.port)) {
            Some(client) => client.call(request, now),
            None => self.foreign("called a service with"),
        }
    }

    /// Answers a request taken by [`Setup::serve_later`](crate::Setup::serve_later), with a value or an error
    /// text.
    ///
    /// `Q` is the type of the service's requests.
    pub fn reply<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        responder: Responder<Q, R>,
        result: Result<R, String>,
    ) {
        self.io().ask(SERVICES);
        let ports = self.io().port::<ServicesPort>(SERVICES);
        match ports.and_then(|ports| ports.server::<Q, R>(responder.port)) {
            Some(server) => server.answer(responder.to, result),
            None => self.foreign("answered with"),
        }
    }
}

impl Core {
    /// Opens a service for calls from threads outside the executor.
    ///
    /// # Errors
    /// Returns an error if the name is invalid, or the service has other types.
    pub fn caller<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        service: &str,
    ) -> Result<Caller<Q, R>, SetupError> {
        self.caller_of(ServiceType::of(), service)
    }

    /// As [`caller`](Self::caller), for types with names.
    ///
    /// # Errors
    /// As for [`caller`](Self::caller).
    pub fn caller_of<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        of: ServiceType<Q, R>,
        service: &str,
    ) -> Result<Caller<Q, R>, SetupError> {
        let link = Arc::clone(&self.state.link);
        open_caller(services_among(&mut self.mechanisms), of, service, link)
    }

    /// Replaces the server of a service that is not in this core. Until a module serves the service, calls of
    /// modules wait for answers given through the returned value.
    ///
    /// # Errors
    /// Returns an error if the name is invalid, or the service has other types.
    pub fn stand_in<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        service: &str,
    ) -> Result<StandIn<R>, SetupError> {
        self.stand_in_of::<Q, R>(ServiceType::of(), service)
    }

    /// As [`stand_in`](Self::stand_in), for types with names.
    ///
    /// # Errors
    /// As for [`stand_in`](Self::stand_in).
    pub fn stand_in_of<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        of: ServiceType<Q, R>,
        service: &str,
    ) -> Result<StandIn<R>, SetupError> {
        let registry = &mut services_among(&mut self.mechanisms).registry;
        let index = registry.open(of, service, "stand-in")?;
        registry.get_mut(index).has_stand_in = true;
        Ok(StandIn::new(self.handle()))
    }

    /// Sets the functions that encode the requests and answers of a service as bytes in each
    /// [`ModuleEvent`](crate::ModuleEvent). Both run on the thread of the core.
    ///
    /// # Errors
    /// Returns an error if the name is invalid, or the service has other types.
    pub fn encode_service<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        service: &str,
        request: fn(&Q) -> Vec<u8>,
        answer: fn(&R) -> Vec<u8>,
    ) -> Result<(), SetupError> {
        let encoder = Encoder::new(request, answer);
        set_encoder(services_among(&mut self.mechanisms), ServiceType::<Q, R>::of(), service, encoder)
    }

    /// As [`encode_service`](Self::encode_service), for types given as values. The functions return `None`
    /// for values of other types.
    ///
    /// # Errors
    /// As for [`encode_service`](Self::encode_service).
    pub fn encode_service_of(
        &mut self,
        of: ServiceType<AnyValue, AnyValue>,
        service: &str,
        request: impl Fn(&dyn Any) -> Option<Vec<u8>> + Send + 'static,
        answer: impl Fn(&dyn Any) -> Option<Vec<u8>> + Send + 'static,
    ) -> Result<(), SetupError> {
        set_encoder(services_among(&mut self.mechanisms), of, service, Encoder::of_any(request, answer))
    }

    /// The services, in the order in which they were first declared.
    pub fn services(&self) -> impl Iterator<Item = &ServiceInfo> {
        let services = self.mechanisms.get::<Services>(SERVICES);
        services.into_iter().flat_map(|services| services.registry.infos())
    }

    /// The service with this name.
    pub fn service(&self, name: &str) -> Option<&ServiceInfo> {
        let services = self.mechanisms.get::<Services>(SERVICES)?;
        services.registry.find(name).map(|service| &service.info)
    }
}

impl CoreHandle {
    /// The services, in the order in which they were first declared.
    #[must_use = "the answer is in the receipt"]
    pub fn services(&self) -> Receipt<Vec<ServiceInfo>> {
        self.ask(|phase| {
            let services = phase.mechanisms.get::<Services>(SERVICES);
            services.into_iter().flat_map(|services| services.registry.infos()).cloned().collect()
        })
    }

    /// A way to call a service from threads outside the executor, made while the core runs; see
    /// [`Core::caller`](crate::Core::caller).
    ///
    /// ```
    /// # use downbeat_executor::{CallError, Core, ManualClock, ServiceType, Time};
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.cycle()?;
    /// let receipt = core.handle().caller_of::<f64, ()>(ServiceType::of(), "reach");
    /// core.cycle()?; // Makes it in its sync phase.
    /// let reach = receipt.try_take().unwrap()?;
    /// # let (sender, answer) = std::sync::mpsc::channel();
    /// reach.call(0.5, std::time::Duration::from_secs(9), move |result| drop(sender.send(result)))?;
    /// (0..2).try_for_each(|_| core.cycle())?;
    /// assert!(matches!(answer.try_recv()?, Err(CallError::NoServer { .. })));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use = "the answer is in the receipt"]
    pub fn caller_of<Q: Send + 'static, R: Send + 'static>(
        &self,
        of: ServiceType<Q, R>,
        service: &str,
    ) -> Receipt<Result<Caller<Q, R>, SetupError>> {
        let (service, link) = (service.to_owned(), Arc::clone(&self.link));
        self.ask(move |phase| open_caller(services_among(phase.mechanisms), of, &service, link))
    }

    /// As [`Core::encode_service_of`](crate::Core::encode_service_of), while the core runs.
    #[must_use = "the answer is in the receipt"]
    pub fn encode_service_of(
        &self,
        of: ServiceType<AnyValue, AnyValue>,
        service: &str,
        request: impl Fn(&dyn Any) -> Option<Vec<u8>> + Send + 'static,
        answer: impl Fn(&dyn Any) -> Option<Vec<u8>> + Send + 'static,
    ) -> Receipt<Result<(), SetupError>> {
        let (service, encoder) = (service.to_owned(), Encoder::of_any(request, answer));
        self.ask(move |phase| set_encoder(services_among(phase.mechanisms), of, &service, encoder))
    }
}

fn services_among(mechanisms: &mut Mechanisms) -> &mut Services {
    match mechanisms.get_mut(SERVICES) {
        Some(services) => services,
        None => unreachable!("every core has services, which do not run between cycles"),
    }
}

fn open_caller<Q: Send + 'static, R: Send + 'static>(
    services: &mut Services,
    of: ServiceType<Q, R>,
    service: &str,
    link: Arc<Link>,
) -> Result<Caller<Q, R>, SetupError> {
    let index = services.registry.open(of, service, "caller")?;
    Ok(Caller::new(index, Arc::clone(services.registry.name(index)), link))
}

fn set_encoder<Q: Send + 'static, R: Send + 'static>(
    services: &mut Services,
    of: ServiceType<Q, R>,
    service: &str,
    encoder: Encoder,
) -> Result<(), SetupError> {
    let index = services.registry.open(of, service, "encoder")?;
    services.registry.get_mut(index).encoder = Some(encoder);
    Ok(())
}
