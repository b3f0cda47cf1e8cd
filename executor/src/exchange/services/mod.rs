//! The mechanism "services": remote procedure calls by name, typed and deferred.
//!
//! A call takes effect in the sync phase: the server runs in the next cycle, and its answer reaches the
//! caller in the cycle after that. Every call gets exactly one [`Reply`].

mod any_value;
mod api;
mod call;
mod caller;
mod client;
mod registry;
mod server;
mod stand_in;

use std::any::Any;
use std::sync::Arc;

pub use any_value::AnyValue;
use call::ReplyTo;
pub use call::{CallError, CallId, Client, Reply, Responder};
pub use caller::Caller;
use caller::{AnyCall, ExternalCalls};
use client::{AnyClient, ClientPort};
use registry::ServiceRegistry;
pub use registry::{ServiceInfo, ServiceType};
use server::{AnyReply, AnyRequests, AnyServer, ServerPort};
pub use stand_in::StandIn;

use super::events::{CallOrigin, ModuleEvent, ModuleEventKind, hears_events, note_event};
use crate::cycle::CoreLife;
use crate::module::{Asked, Causes, ModuleCell, Place, SERVICES};
use crate::threads::drop_guarded;
use crate::{Mechanism, ModuleChange, ModuleId, Port, Step, SyncPhase, Time, Version};

/// The order of requests is: those from outside the cycle, in the order of arrival; those of detached
/// modules, in the order of their runs; those of the other modules, in the order of registration. Answers
/// follow in the same order.
#[derive(Default)]
pub(crate) struct Services {
    registry: ServiceRegistry,
    external: ExternalCalls,
    /// Calls of callers that have not been staged yet.
    calls: Vec<Box<dyn AnyCall>>,
    /// Calls of detached modules, by client port.
    calls_of_detached: Vec<(ModuleId, u32, Box<dyn AnyClient>)>,
    /// Answers of detached modules, of restarting modules, and of stand-ins.
    answers: Vec<Answer>,
}

/// An answer with its address and the name of its service.
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

/// A module's clients and servers, in the order of declaration.
#[derive(Default)]
pub(crate) struct ServicesPort {
    clients: Vec<Box<dyn AnyClient>>,
    servers: Vec<Box<dyn AnyServer>>,
}

/// The calls and answers of a run of a detached module.
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
            ModuleChange::Inactive { module, failure } => {
                for server in &mut self.servers {
                    drop_guarded("a request", || server.abandon(module, failure));
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
    pub(crate) fn infos(&self) -> impl Iterator<Item = &ServiceInfo> {
        self.registry.infos()
    }

    /// The name of the service with this number.
    pub(crate) fn name(&self, service: usize) -> &Arc<str> {
        self.registry.name(service)
    }

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

    /// Stages the calls; returns false if there is no server, after failing the calls.
    fn stage_calls(
        &mut self,
        phase: &mut SyncPhase<'_>,
        module: ModuleId,
        port: u32,
        calls: &mut dyn AnyClient,
    ) -> bool {
        let service = self.registry.get_mut(calls.service());
        // If the last user of the service is leaving, the service may have been removed and its index given
        // to another one.
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

    /// Publishes the requests that are now delivered to a server as events.
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

/// Visits one half of the ports of the modules that use services in this cycle. The half is taken out of the
/// cell meanwhile, since client and server may be the same module.
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

/// Passes the requests to a module.
fn accept(cell: &mut ModuleCell, port: u32, requests: &mut dyn AnyRequests) {
    let ports = cell.port::<ServicesPort>(SERVICES);
    if let Some(server) = ports.and_then(|ports| ports.servers.get_mut(port as usize)) {
        server.accept(requests);
    }
}
