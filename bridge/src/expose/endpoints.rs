//! The endpoints there are, shared by who changes them and who shows them.

use super::ExposeError;
use super::status::{EndpointReport, EndpointStatus};
use crate::ros::Subscription;
use downbeat_executor::Outlet;
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
}

/// An endpoint, and what keeps it alive.
pub(super) struct Exposed {
    status: EndpointStatus,
    /// `None` after the core has stopped.
    held: Option<Held>,
}

pub(super) enum Held {
    /// Its sink has the publisher.
    Outlet(#[expect(dead_code, reason = "held until it is dropped")] Outlet),
    Subscription(#[expect(dead_code, reason = "held until it is dropped")] Arc<Subscription>),
}

impl Exposed {
    pub(super) fn new(status: EndpointStatus, held: Held) -> Self {
        Self { status, held: Some(held) }
    }

    pub(super) fn report(&self) -> EndpointReport {
        self.status.report()
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

    /// Ends the endpoints that are meant. Returns what they were.
    pub(super) fn remove(&self, is_meant: impl Fn(&EndpointReport) -> bool) -> Vec<EndpointReport> {
        let (removed, reports): (Vec<_>, Vec<_>) = {
            let mut state = self.lock();
            let (meant, others) = std::mem::take(&mut state.exposed)
                .into_iter()
                .map(|exposed| (exposed.report(), exposed))
                .partition::<Vec<_>, _>(|(report, _)| is_meant(report));
            state.exposed = others.into_iter().map(|(_, exposed)| exposed).collect();
            meant.into_iter().map(|(report, exposed)| (exposed, report)).unzip()
        };
        // Without the lock: it may take until a message is sent or taken.
        drop(removed);
        reports
    }

    /// Ends all endpoints, since the core has stopped; they are still shown.
    pub(super) fn close(&self) {
        let held: Vec<_> = {
            let mut state = self.lock();
            state.has_ended = true;
            state.exposed.iter_mut().map(|exposed| exposed.held.take()).collect()
        };
        drop(held);
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
