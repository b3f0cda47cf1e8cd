//! The mechanism "services": takes requests to servers and answers to clients.

use std::any::Any;
use std::sync::Arc;

use crate::ModuleId;
use crate::asked::Asked;
use crate::core::SyncPhase;
use crate::detached::Parcel;
use crate::event::{CallOrigin, ModuleEventKind};
use crate::guard::drop_guarded;
use crate::management::Place;
use crate::mechanism::{Mechanism, Version};
use crate::service::{AnyClient, AnyReply, CallError, ExternalCalls, ReplyTo};

/// Requests from outside the cycle come first, in the order in which they came; then those of detached modules, in the
/// order in which these ran; then those of the modules, in the order of registration. Answers follow in the same order.
#[derive(Default)]
pub(crate) struct Services {
    external: ExternalCalls,
}

impl Mechanism for Services {
    type View = ();
    type Request = ();

    const NAME: &'static str = "services";
    const VERSION: Version = Version::new(1, 0);

    fn view(&self) {}

    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        self.take_external(phase);
        take_calls(phase);
        if phase.world.services.staged() {
            deliver_requests(phase);
        }
        self.deliver_answers(phase);
        self.external.give_up(phase.now);
        if phase.world.has_stopped {
            self.external.stop();
        }
        phase.world.calls_due = self.external.due();
    }
}

impl Services {
    fn take_external(&mut self, phase: &mut SyncPhase<'_>) {
        for mut call in std::mem::take(&mut phase.world.joined.calls) {
            let service = phase.world.services.get_mut(call.service());
            if !service.is_served() {
                let error = CallError::NoServer { service: Arc::clone(&service.info.name) };
                super::caller::guarded(|| call.fail(error));
                continue;
            }
            service.has_staged = true;
            self.external.add(call, &mut *service.staged, phase.now);
        }
    }

    fn deliver_answers(&mut self, phase: &mut SyncPhase<'_>) {
        for (to, service, mut reply) in std::mem::take(&mut phase.world.joined.answers) {
            self.deliver_answer(phase, to, &service, &mut *reply);
        }
        let askers = std::mem::take(&mut phase.world.askers);
        for asker in askers.iter().filter(|asker| asker.asked.has(Asked::ANSWERS)) {
            let slot = asker.module.slot;
            let Some(cell) = phase.stage.cell(slot) else { continue };
            // Taken out of the cell, since the client may be the same module.
            let mut servers = std::mem::take(&mut cell.io.servers);
            for server in &mut servers {
                let service = Arc::clone(server.name());
                server.drain_answers(&mut |to, reply| self.deliver_answer(phase, to, &service, reply));
            }
            if let Some(cell) = phase.stage.cell(slot) {
                cell.io.servers = servers;
            }
        }
        phase.world.askers = askers;
    }

    fn deliver_answer(
        &mut self,
        phase: &mut SyncPhase<'_>,
        to: ReplyTo,
        service: &Arc<str>,
        reply: &mut dyn AnyReply,
    ) {
        if phase.hears_events() {
            note_answer(phase, to, service, reply);
        }
        match to {
            ReplyTo::External { call } => self.external.finish(call, reply),
            ReplyTo::Module { module, port, .. } => answer(phase, module, port, reply),
        }
    }
}

fn origin(phase: &SyncPhase<'_>, to: ReplyTo) -> CallOrigin {
    match to {
        ReplyTo::External { call } => CallOrigin { client: None, port: 0, number: call },
        ReplyTo::Module { module, port, call } => {
            let client = phase.world.members.get(module.order).map(|member| Arc::clone(&member.name));
            CallOrigin { client, port, number: call }
        }
    }
}

#[cold]
fn note_answer(phase: &mut SyncPhase<'_>, to: ReplyTo, service: &Arc<str>, reply: &dyn AnyReply) {
    let encoder = phase.world.services.find(service).and_then(|service| service.encoder.as_ref());
    let result = match reply.look() {
        Some(Ok(answer)) => Ok(encoder.and_then(|encoder| (encoder.answer)(answer))),
        Some(Err(error)) => Err(error.clone()),
        None => return,
    };
    let (service, origin) = (Arc::clone(service), origin(phase, to));
    phase.note_event(ModuleEventKind::Answer { service, origin, result });
}

/// Has the requests told that go to a server now.
#[cold]
fn note_requests(phase: &mut SyncPhase<'_>, index: usize) {
    let mut requests = Vec::new();
    let service = phase.world.services.get_mut(index);
    let name = Arc::clone(&service.info.name);
    service.each_staged(&mut |to, request| {
        let body = service.encoder.as_ref().and_then(|encoder| (encoder.request)(request));
        requests.push((to, body));
    });
    for (to, body) in requests {
        let (service, origin) = (Arc::clone(&name), origin(phase, to));
        phase.note_event(ModuleEventKind::Request { service, origin, body });
    }
}

fn answer(phase: &mut SyncPhase<'_>, module: ModuleId, port: u32, reply: &mut dyn AnyReply) {
    if let Some(cell) = phase.attached(module) {
        if let Some(client) = cell.io.clients.get_mut(port as usize) {
            client.accept_any(reply);
        }
        phase.wake(module);
    } else if let Place::Detached(slot) = module.place
        && let Some(detached) = &phase.world.detached[slot]
        && detached.id == module
    {
        detached.send(Parcel::Reply { port, reply: reply.take_boxed() });
    }
}

fn take_calls(phase: &mut SyncPhase<'_>) {
    for (module, port, mut calls) in std::mem::take(&mut phase.world.joined.calls_of_detached) {
        if !stage_calls(phase, module, port, &mut *calls) {
            calls.drain_replies(&mut |reply| answer(phase, module, port, reply));
        }
    }
    let askers = std::mem::take(&mut phase.world.askers);
    for asker in askers.iter().filter(|asker| asker.asked.has(Asked::CALLS)) {
        let slot = asker.module.slot;
        let Some(cell) = phase.stage.cell(slot) else { continue };
        let id = cell.io.id;
        let mut clients = std::mem::take(&mut cell.io.clients);
        for (port, client) in (0..).zip(&mut clients).filter(|(_, client)| client.has_calls()) {
            if !stage_calls(phase, id, port, &mut **client) {
                phase.wake(id);
            }
        }
        if let Some(cell) = phase.stage.cell(slot) {
            cell.io.clients = clients;
        }
    }
    phase.world.askers = askers;
}

/// False if there is no server; the calls have failed then.
fn stage_calls(phase: &mut SyncPhase<'_>, module: ModuleId, port: u32, calls: &mut dyn AnyClient) -> bool {
    let service = phase.world.services.get_mut(calls.service());
    // The place of a service that was forgotten, since its last user is leaving, may be another's by now.
    let is_other = !Arc::ptr_eq(&service.info.name, calls.name());
    if is_other || !service.is_served() {
        let error = CallError::NoServer { service: Arc::clone(calls.name()) };
        if phase.hears_events() {
            let client = phase.world.members.get(module.order).map(|member| Arc::clone(&member.name));
            for number in calls.calls() {
                let (service, client) = (Arc::clone(calls.name()), client.clone());
                let (origin, result) = (CallOrigin { client, port, number }, Err(error.clone()));
                phase.note_event(ModuleEventKind::Answer { service, origin, result });
            }
        }
        calls.fail_calls(&error);
        return false;
    }
    service.has_staged = true;
    let staged: &mut dyn Any = &mut *service.staged;
    calls.stage(module, port, staged);
    true
}

fn deliver_requests(phase: &mut SyncPhase<'_>) {
    let is_heard = phase.hears_events();
    for index in 0..phase.world.services.len() {
        if !std::mem::take(&mut phase.world.services.get_mut(index).has_staged) {
            continue;
        }
        if is_heard {
            note_requests(phase, index);
        }
        let SyncPhase { stage, world, .. } = &mut *phase;
        let service = world.services.get_mut(index);
        let Some((module, port)) = service.server else {
            // A stand-in answers what it was told beforehand.
            let requests = service.take_staged();
            drop_guarded("a request", || drop(requests));
            continue;
        };
        match module.place {
            Place::Attached(slot) => {
                let server = stage.cell(slot).and_then(|cell| cell.io.servers.get_mut(port as usize));
                if let Some(server) = server {
                    server.accept(&mut *service.staged);
                    world.agenda.wake(slot);
                }
            }
            Place::Detached(slot) => {
                if let Some(detached) = &world.detached[slot] {
                    let mut count = 0;
                    service.each_staged(&mut |_, _| count += 1);
                    detached.send(Parcel::Requests { port, count, requests: service.take_staged() });
                }
            }
        }
    }
}
