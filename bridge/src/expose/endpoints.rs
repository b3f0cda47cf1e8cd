//! The endpoints there are, shared by who changes them, who shows them, and the modules that feed them.

use super::ExposeError;
use super::module::{Outlet, Slot};
use super::status::{EndpointReport, EndpointStatus};
use crate::ros::Subscription;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// All endpoints, in the order in which they were exposed.
#[derive(Default)]
pub(super) struct Endpoints {
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    has_ended: bool,
    exposed: Vec<Exposed>,
    /// Subscriptions of the executor whose endpoint was removed, with their modules.
    unused: Vec<(String, Arc<Slot>)>,
}

/// An endpoint, and what keeps it alive.
pub(super) struct Exposed {
    status: EndpointStatus,
    held: Held,
}

pub(super) enum Held {
    /// No module subscribes for it yet.
    Outlet(Outlet),
    /// A slot holds its publisher; with the name of the slot's module.
    Slot(String, Arc<Slot>),
    Subscription(Arc<Subscription>),
    /// It is gone, since the core has stopped.
    Nothing,
}

impl Exposed {
    pub(super) fn new(status: EndpointStatus, held: Held) -> Self {
        Self { status, held }
    }

    pub(super) fn report(&self) -> EndpointReport {
        self.status.report()
    }

    /// Gives the publisher, if no module subscribes for it yet, to a slot for that module.
    pub(super) fn enter(&mut self, module: &str) -> Option<Arc<Slot>> {
        match std::mem::replace(&mut self.held, Held::Nothing) {
            Held::Outlet(outlet) => {
                let slot = Arc::new(Slot::new(&self.status.topic, self.status.message_type, outlet));
                self.held = Held::Slot(module.to_owned(), Arc::clone(&slot));
                Some(slot)
            }
            other => {
                self.held = other;
                None
            }
        }
    }

    /// Ends the endpoint.
    fn end(&mut self) {
        match std::mem::replace(&mut self.held, Held::Nothing) {
            Held::Slot(_, slot) => drop(slot.close()),
            Held::Subscription(subscription) => drop(subscription),
            Held::Outlet(_) | Held::Nothing => {}
        }
    }
}

impl Endpoints {
    pub(super) fn reports(&self) -> Vec<EndpointReport> {
        self.lock().exposed.iter().map(Exposed::report).collect()
    }

    pub(super) fn any(&self, is: impl Fn(&EndpointReport) -> bool) -> bool {
        self.lock().exposed.iter().any(|exposed| is(&exposed.report()))
    }

    pub(super) fn extend(&self, exposed: Vec<Exposed>) -> Result<(), ExposeError> {
        let mut state = self.lock();
        if state.has_ended {
            return Err(ExposeError::Stopped);
        }
        state.exposed.extend(exposed);
        Ok(())
    }

    /// Gives the publisher to a slot that has lost its own, if there is one for the topic.
    pub(super) fn use_again(&self, exposed: &mut Exposed) {
        let mut state = self.lock();
        let topic = exposed.status.topic.trim_start_matches('/');
        let is_fit = |(_, slot): &(String, Arc<Slot>)| {
            slot.topic.trim_start_matches('/') == topic && slot.message_type == exposed.status.message_type
        };
        if let (Held::Outlet(_), Some(position)) = (&exposed.held, state.unused.iter().position(is_fit)) {
            let (module, slot) = state.unused.remove(position);
            let held = std::mem::replace(&mut exposed.held, Held::Slot(module, Arc::clone(&slot)));
            if let Held::Outlet(outlet) = held {
                slot.open(outlet);
            }
        }
    }

    /// Ends the endpoints that are meant. Returns what they were, and the modules that have none any more.
    pub(super) fn remove(
        &self,
        is_meant: impl Fn(&EndpointReport) -> bool,
    ) -> (Vec<EndpointReport>, Vec<String>) {
        let mut removed = Vec::new();
        let mut idle = Vec::new();
        let mut reports = Vec::new();
        {
            let mut state = self.lock();
            let (meant, others): (Vec<_>, Vec<_>) = std::mem::take(&mut state.exposed)
                .into_iter()
                .partition(|exposed| is_meant(&exposed.report()));
            state.exposed = others;
            for exposed in meant {
                reports.push(exposed.report());
                if let Held::Slot(module, slot) = &exposed.held {
                    state.unused.push((module.clone(), Arc::clone(slot)));
                    idle.push(module.clone());
                }
                removed.push(exposed);
            }
            let is_of =
                |exposed: &Exposed, module: &str| matches!(&exposed.held, Held::Slot(of, _) if of == module);
            idle.retain(|module| !state.exposed.iter().any(|exposed| is_of(exposed, module)));
            idle.sort();
            idle.dedup();
            state.unused.retain(|(module, _)| module == super::MODULE_NAME || !idle.contains(module));
        }
        // Without the lock: it may take until a message is sent or taken.
        removed.iter_mut().for_each(Exposed::end);
        (reports, idle)
    }

    /// Ends all endpoints, since the core has stopped; they are still shown.
    pub(super) fn close(&self) {
        let held: Vec<_> = {
            let mut state = self.lock();
            state.has_ended = true;
            // Publishers end with their modules, which may have messages to send.
            let is_subscription = |exposed: &&mut Exposed| matches!(exposed.held, Held::Subscription(_));
            let subscriptions = state.exposed.iter_mut().filter(is_subscription);
            subscriptions.map(|exposed| std::mem::replace(&mut exposed.held, Held::Nothing)).collect()
        };
        drop(held);
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
