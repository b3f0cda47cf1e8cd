//! The mechanism "services": remote procedure calls by name, typed and deferred.
//!
//! A call takes effect in the sync phase: the server runs in the next cycle, and its answer reaches the
//! caller in the one after that. Every call gets exactly one [`Reply`].

mod call;
mod caller;
mod client;
mod registry;
mod server;
mod stand_in;

use std::any::Any;
use std::marker::PhantomData;
use std::sync::Arc;
use std::time::Duration;

use call::ReplyTo;
pub use call::{CallError, CallId, Client, Reply, Responder};
pub use caller::Caller;
use caller::{AnyCall, ExternalCalls};
use client::{AnyClient, ClientPort};
use registry::{Encoder, ServiceRegistry};
pub use registry::{ServiceInfo, ServiceType};
use server::{AnyReply, AnyServer, Incoming, ServerPort};
pub use stand_in::StandIn;

use super::events::{CallOrigin, ModuleEvent, ModuleEventKind, hears_events, note_event};
use crate::cycle::CoreLife;
use crate::module::{Asked, Causes, Direction, Host, ModuleCell, Place, SERVICES, TIMERS, Use, UseEnds};
use crate::threads::drop_guarded;
use crate::{
    Context, Core, Mechanism, Module, ModuleChange, ModuleId, Port, Setup, SetupError, Step, SyncPhase, Time,
    Version,
};

/// Requests from outside the cycle come first, in the order in which they came; then those of detached modules, in the
/// order in which these ran; then those of the modules, in the order of registration. Answers follow in the same order.
#[derive(Default)]
pub(crate) struct Services {
    registry: ServiceRegistry,
    external: ExternalCalls,
    /// Calls of callers that have not been made yet.
    calls: Vec<Box<dyn AnyCall>>,
    /// Calls of detached modules, by client port.
    calls_of_detached: Vec<(ModuleId, u32, Box<dyn AnyClient>)>,
    /// Answers of detached modules, of modules that start again, and of stand-ins.
    answers: Vec<Answer>,
}

/// An answer on its way to its client, with the name of its service.
type Answer = (ReplyTo, Arc<str>, Box<dyn AnyReply>);

impl Mechanism for Services {
    type View = ();
    type Port = ServicesPort;

    const NAME: &'static str = "services";
    const VERSION: Version = Version::new(1, 0);

    fn view(&self) {}

    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        if !self.calls.is_empty() {
            self.take_external(phase.now());
        }
        if !self.calls_of_detached.is_empty() {
            self.take_calls_of_detached(phase);
        }
        self.take_calls(phase);
        if self.registry.staged() {
            self.deliver_requests(phase);
        }
        if !self.answers.is_empty() {
            self.deliver_waiting(phase);
        }
        self.deliver_answers(phase);
        self.external.give_up(phase.now());
        if phase.state.life == CoreLife::Stopped {
            self.external.stop();
        }
        phase.mechanisms.set_due(SERVICES, self.external.due());
    }

    fn join(&mut self, step: Step, part: Box<dyn Any + Send>) {
        if let Ok(part) = part.downcast::<Part>() {
            let Part { calls, answers } = *part;
            self.calls_of_detached.extend(calls.into_iter().map(|(port, calls)| (step.module, port, calls)));
            self.answers.extend(answers);
        }
    }

    fn started(&mut self, phase: &mut SyncPhase<'_>) {
        phase.topics().open_report::<ModuleEvent>();
    }
}

/// A module's part of the mechanism, by the order of declaration.
#[derive(Default)]
pub(crate) struct ServicesPort {
    clients: Vec<Box<dyn AnyClient>>,
    servers: Vec<Box<dyn AnyServer>>,
}

/// What a run of a module on another thread asks for.
struct Part {
    /// By client port.
    calls: Vec<(u32, Box<dyn AnyClient>)>,
    answers: Vec<Answer>,
}

impl Port for ServicesPort {
    fn changed(&mut self, change: ModuleChange<'_>) -> bool {
        match change {
            ModuleChange::Panicked => {
                self.clients.iter_mut().for_each(|client| client.reset());
                self.servers.iter_mut().for_each(|server| server.discard_answers());
                false
            }
            ModuleChange::Inactive { module } => {
                for server in &mut self.servers {
                    drop_guarded("a request", || server.abandon(module));
                }
                self.servers.iter().any(|server| server.has_answers())
            }
            ModuleChange::Activated(_) | ModuleChange::Deactivated | ModuleChange::ClockWentBack(_) => false,
        }
    }

    fn due(&self) -> Time {
        self.clients.iter().fold(Time::MAX, |due, client| due.min(client.due()))
    }

    fn split_off(&mut self) -> Option<Box<dyn Any + Send>> {
        let calling = (0..).zip(&mut self.clients).filter(|(_, client)| client.has_calls());
        let calls = calling.map(|(port, client)| (port, client.split_off())).collect();
        let mut answers = Vec::new();
        for server in &mut self.servers {
            let service = Arc::clone(server.name());
            server
                .drain_answers(&mut |to, reply| answers.push((to, Arc::clone(&service), reply.take_boxed())));
        }
        Some(Box::new(Part { calls, answers }))
    }
}

impl ServicesPort {
    fn client<Q: Send + 'static, R: Send + 'static>(&mut self, port: u32) -> Option<&mut ClientPort<Q, R>> {
        let client: &mut dyn Any = &mut **self.clients.get_mut(port as usize)?;
        client.downcast_mut()
    }

    fn server<Q: Send + 'static, R: Send + 'static>(&mut self, port: u32) -> Option<&mut ServerPort<Q, R>> {
        let server: &mut dyn Any = &mut **self.servers.get_mut(port as usize)?;
        server.downcast_mut()
    }
}

impl Services {
    fn take_external(&mut self, now: Time) {
        for mut call in std::mem::take(&mut self.calls) {
            let service = self.registry.get_mut(call.service());
            if !service.is_served() {
                let error = CallError::NoServer { service: Arc::clone(&service.info.name) };
                caller::guarded(|| call.fail(error));
                continue;
            }
            service.has_staged = true;
            self.external.add(call, &mut *service.staged, now);
        }
    }

    fn take_calls_of_detached(&mut self, phase: &mut SyncPhase<'_>) {
        for (module, port, mut calls) in std::mem::take(&mut self.calls_of_detached) {
            if !self.stage_calls(phase, module, port, &mut *calls) {
                calls.drain_replies(&mut |reply| answer(phase, module, port, reply));
            }
        }
    }

    fn take_calls(&mut self, phase: &mut SyncPhase<'_>) {
        each_half(
            phase,
            |port| &mut port.clients,
            |phase, module, clients| {
                for (port, client) in (0..).zip(clients).filter(|(_, client)| client.has_calls()) {
                    if !self.stage_calls(phase, module, port, &mut **client) {
                        phase.wake_for(module, Causes::REPLIES);
                    }
                }
            },
        );
    }

    /// False if there is no server; the calls have failed then.
    fn stage_calls(
        &mut self,
        phase: &mut SyncPhase<'_>,
        module: ModuleId,
        port: u32,
        calls: &mut dyn AnyClient,
    ) -> bool {
        let service = self.registry.get_mut(calls.service());
        // The place of a service that was forgotten, since its last user is leaving, may be another's by now.
        let is_other = !Arc::ptr_eq(&service.info.name, calls.name());
        if is_other || !service.is_served() {
            let error = CallError::NoServer { service: Arc::clone(calls.name()) };
            if hears_events(phase) {
                let client = phase.state.members.get(module.order).map(|member| Arc::clone(&member.name));
                for number in calls.calls() {
                    let (service, client) = (Arc::clone(calls.name()), client.clone());
                    let (origin, result) = (CallOrigin { client, port, number }, Err(error.clone()));
                    note_event(phase, ModuleEventKind::Answer { service, origin, result });
                }
            }
            calls.fail_calls(&error);
            return false;
        }
        service.has_staged = true;
        calls.stage(module, port, &mut *service.staged);
        true
    }

    fn deliver_requests(&mut self, phase: &mut SyncPhase<'_>) {
        let is_heard = hears_events(phase);
        for index in 0..self.registry.len() {
            if !std::mem::take(&mut self.registry.get_mut(index).has_staged) {
                continue;
            }
            if is_heard {
                self.note_requests(phase, index);
            }
            let service = self.registry.get_mut(index);
            let Some((module, port)) = service.server else {
                // A stand-in has its answers already.
                let requests = service.take_staged();
                drop_guarded("a request", || drop(requests));
                continue;
            };
            let mut count = 0;
            if let Place::Detached(_) = module.place {
                service.each_staged(&mut |_, _| count += 1);
            }
            phase.change_with(
                module,
                Causes::REQUESTS,
                count,
                service,
                |cell, service| accept(cell, port, &mut *service.staged),
                |service| {
                    let mut requests = service.take_staged();
                    Box::new(move |cell| accept(cell, port, &mut *requests))
                },
            );
        }
    }

    fn deliver_waiting(&mut self, phase: &mut SyncPhase<'_>) {
        for (to, service, mut reply) in std::mem::take(&mut self.answers) {
            self.deliver_answer(phase, to, &service, &mut *reply);
        }
    }

    fn deliver_answers(&mut self, phase: &mut SyncPhase<'_>) {
        each_half(
            phase,
            |port| &mut port.servers,
            |phase, _, servers| {
                for server in servers.iter_mut().filter(|server| server.has_answers()) {
                    let service = Arc::clone(server.name());
                    server.drain_answers(&mut |to, reply| self.deliver_answer(phase, to, &service, reply));
                }
            },
        );
    }

    fn deliver_answer(
        &mut self,
        phase: &mut SyncPhase<'_>,
        to: ReplyTo,
        service: &Arc<str>,
        reply: &mut dyn AnyReply,
    ) {
        if hears_events(phase) {
            self.note_answer(phase, to, service, reply);
        }
        match to {
            ReplyTo::External { call } => self.external.finish(call, reply),
            ReplyTo::Module { module, port, .. } => answer(phase, module, port, reply),
        }
    }

    #[cold]
    fn note_answer(&self, phase: &mut SyncPhase<'_>, to: ReplyTo, service: &Arc<str>, reply: &dyn AnyReply) {
        let encoder = self.registry.find(service).and_then(|service| service.encoder.as_ref());
        let result = match reply.look() {
            Some(Ok(answer)) => Ok(encoder.and_then(|encoder| (encoder.answer)(answer))),
            Some(Err(error)) => Err(error.clone()),
            None => return,
        };
        let (service, origin) = (Arc::clone(service), origin(phase, to));
        note_event(phase, ModuleEventKind::Answer { service, origin, result });
    }

    /// Publishes the requests that go to a server now as events.
    #[cold]
    fn note_requests(&mut self, phase: &mut SyncPhase<'_>, index: usize) {
        let service = self.registry.get_mut(index);
        let name = Arc::clone(&service.info.name);
        service.each_staged(&mut |to, request| {
            let body = service.encoder.as_ref().and_then(|encoder| (encoder.request)(request));
            let (service, origin) = (Arc::clone(&name), origin(phase, to));
            note_event(phase, ModuleEventKind::Request { service, origin, body });
        });
    }
}

/// Visits one half of the ports of the modules that asked something of services. It is taken out of the cell meanwhile,
/// since client and server may be the same module.
fn each_half<T>(
    phase: &mut SyncPhase<'_>,
    half: fn(&mut ServicesPort) -> &mut Vec<T>,
    mut visit: impl FnMut(&mut SyncPhase<'_>, ModuleId, &mut [T]),
) {
    let askers = std::mem::take(&mut phase.state.askers);
    for asker in askers.list.iter().filter(|asker| asker.asked.has(Asked::of(SERVICES))) {
        let Some(cell) = phase.stage.cells.get(asker.slot) else { continue };
        let id = cell.io.id;
        let Some(port) = cell.port(SERVICES) else { continue };
        let half_of = half(port);
        if half_of.is_empty() {
            continue;
        }
        let mut taken = std::mem::take(half_of);
        visit(phase, id, &mut taken);
        if let Some(port) = phase.stage.cells.get(asker.slot).and_then(|cell| cell.port(SERVICES)) {
            *half(port) = taken;
        }
    }
    phase.state.askers = askers;
}

fn origin(phase: &SyncPhase<'_>, to: ReplyTo) -> CallOrigin {
    match to {
        ReplyTo::External { call } => CallOrigin { client: None, port: 0, number: call },
        ReplyTo::Module { module, port, call } => {
            let client = phase.state.members.get(module.order).map(|member| Arc::clone(&member.name));
            CallOrigin { client, port, number: call }
        }
    }
}

fn answer(phase: &mut SyncPhase<'_>, module: ModuleId, port: u32, reply: &mut dyn AnyReply) {
    phase.change_with(
        module,
        Causes::REPLIES,
        1,
        reply,
        |cell, reply| take_reply(cell, port, reply),
        |reply| {
            let mut reply = reply.take_boxed();
            Box::new(move |cell| take_reply(cell, port, &mut *reply))
        },
    );
}

fn take_reply(cell: &mut ModuleCell, port: u32, reply: &mut dyn AnyReply) {
    let ports = cell.port::<ServicesPort>(SERVICES);
    if let Some(client) = ports.and_then(|ports| ports.clients.get_mut(port as usize)) {
        client.accept_any(reply);
    }
}

/// Gives a module the requests in a `Vec<Incoming<Q>>`.
fn accept(cell: &mut ModuleCell, port: u32, requests: &mut dyn Any) {
    let ports = cell.port::<ServicesPort>(SERVICES);
    if let Some(server) = ports.and_then(|ports| ports.servers.get_mut(port as usize)) {
        server.accept(requests);
    }
}

fn services_of(host: &mut dyn Host) -> &mut Services {
    match host.mechanism(SERVICES).and_then(|any| any.downcast_mut()) {
        Some(services) => services,
        None => unreachable!("every core has services, and modules are set up while they do not run"),
    }
}

impl<M: Module> Setup<'_, M> {
    /// Offers a service whose requests are answered at once, with a value or with an error in words. A service has
    /// one server.
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

    /// Offers a service whose requests are answered when the answer is there, with [`Context::reply`].
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
    /// Those of [`serve_later`](Self::serve_later).
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

    /// Declares that the module calls a service; the key is for [`Context::call`]. Each call ends with one call of
    /// `on_reply`: with the answer, or after `timeout` with the error that there is none.
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
    /// Those of [`client`](Self::client).
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
    /// Calls a service. The answer, or the reason why there is none, comes to the callback that was given to
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

    /// Answers a request that was taken by [`Setup::serve_later`](crate::Setup::serve_later): with a value, or with
    /// an error in words.
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
    /// A way to call a service from threads outside the executor.
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
    /// Those of [`caller`](Self::caller).
    pub fn caller_of<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        of: ServiceType<Q, R>,
        service: &str,
    ) -> Result<Caller<Q, R>, SetupError> {
        let link = Arc::clone(&self.state.link);
        let registry = &mut self.service_mechanism().registry;
        let index = registry.open(of, service, "caller")?;
        Ok(Caller::new(index, Arc::clone(registry.name(index)), link))
    }

    /// Stands in for the server of a service that is not in this core: until a module serves it, calls of modules wait for what the
    /// value returned answers.
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
    /// Those of [`stand_in`](Self::stand_in).
    pub fn stand_in_of<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        of: ServiceType<Q, R>,
        service: &str,
    ) -> Result<StandIn<R>, SetupError> {
        let registry = &mut self.service_mechanism().registry;
        let index = registry.open(of, service, "stand-in")?;
        registry.get_mut(index).has_stand_in = true;
        Ok(StandIn::new(self.handle()))
    }

    /// Encodes the requests and answers of a service as bytes in each [`ModuleEvent`](crate::ModuleEvent). Both run on the thread
    /// of the core.
    ///
    /// # Errors
    /// Returns an error if the name is invalid, or the service has other types.
    pub fn encode_service<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        service: &str,
        request: fn(&Q) -> Vec<u8>,
        answer: fn(&R) -> Vec<u8>,
    ) -> Result<(), SetupError> {
        self.encode_service_of(ServiceType::of(), service, request, answer)
    }

    /// As [`encode_service`](Self::encode_service), for types with names.
    ///
    /// # Errors
    /// Those of [`encode_service`](Self::encode_service).
    pub fn encode_service_of<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        of: ServiceType<Q, R>,
        service: &str,
        request: fn(&Q) -> Vec<u8>,
        answer: fn(&R) -> Vec<u8>,
    ) -> Result<(), SetupError> {
        let registry = &mut self.service_mechanism().registry;
        let index = registry.open(of, service, "encoder")?;
        registry.get_mut(index).encoder = Some(Encoder::new(request, answer));
        Ok(())
    }

    /// The services, in the order in which they were first declared.
    pub fn services(&self) -> impl Iterator<Item = &ServiceInfo> {
        let services = self.mechanisms.get::<Services>(SERVICES);
        services.into_iter().flat_map(|services| services.registry.infos())
    }

    /// The service of that name.
    pub fn service(&self, name: &str) -> Option<&ServiceInfo> {
        let services = self.mechanisms.get::<Services>(SERVICES)?;
        services.registry.find(name).map(|service| &service.info)
    }

    fn service_mechanism(&mut self) -> &mut Services {
        match self.mechanisms.get_mut(SERVICES) {
            Some(services) => services,
            None => unreachable!("every core has services, which do not run between cycles"),
        }
    }
}

impl Services {
    pub(crate) fn infos(&self) -> impl Iterator<Item = &ServiceInfo> {
        self.registry.infos()
    }

    /// The name of the service with that number.
    pub(crate) fn name(&self, service: usize) -> &Arc<str> {
        self.registry.name(service)
    }
}
