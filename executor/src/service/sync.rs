//! The mechanism "services": takes requests to servers and answers to clients.

use std::any::Any;
use std::sync::Arc;

use crate::ModuleId;
use crate::asked::Asked;
use crate::core::SyncPhase;
use crate::detached::Parcel;
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
            if service.server.is_none() {
                let error = CallError::NoServer { service: Arc::clone(&service.info.name) };
                super::caller::guarded(|| call.fail(error));
                continue;
            }
            service.has_staged = true;
            self.external.add(call, &mut *service.staged, phase.now);
        }
    }

    fn deliver_answers(&mut self, phase: &mut SyncPhase<'_>) {
        for (to, mut reply) in std::mem::take(&mut phase.world.joined.answers) {
            self.deliver_answer(phase, to, &mut *reply);
        }
        let askers = std::mem::take(&mut phase.world.askers);
        for asker in askers.iter().filter(|asker| asker.asked.has(Asked::ANSWERS)) {
            let slot = asker.module.slot;
            let Some(cell) = phase.stage.cell(slot) else { continue };
            // Taken out of the cell, since the client may be the same module.
            let mut servers = std::mem::take(&mut cell.io.servers);
            for server in &mut servers {
                server.drain_answers(&mut |to, reply| self.deliver_answer(phase, to, reply));
            }
            if let Some(cell) = phase.stage.cell(slot) {
                cell.io.servers = servers;
            }
        }
        phase.world.askers = askers;
    }

    fn deliver_answer(&mut self, phase: &mut SyncPhase<'_>, to: ReplyTo, reply: &mut dyn AnyReply) {
        match to {
            ReplyTo::External { call } => self.external.finish(call, reply),
            ReplyTo::Module { module, port, .. } => answer(phase, module, port, reply),
        }
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
    if is_other || service.server.is_none() {
        let error = CallError::NoServer { service: Arc::clone(calls.name()) };
        calls.fail_calls(&error);
        return false;
    }
    service.has_staged = true;
    let staged: &mut dyn Any = &mut *service.staged;
    calls.stage(module, port, staged);
    true
}

fn deliver_requests(phase: &mut SyncPhase<'_>) {
    let SyncPhase { stage, world, .. } = phase;
    for index in 0..world.services.len() {
        let service = world.services.get_mut(index);
        let Some((module, port)) = service.server.filter(|_| service.has_staged) else { continue };
        service.has_staged = false;
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
                    detached.send(Parcel::Requests { port, requests: service.take_staged() });
                }
            }
        }
    }
}
