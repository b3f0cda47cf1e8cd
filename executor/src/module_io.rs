//! What a module and the sync phase hand each other.

use std::any::Any;
use std::sync::Arc;

use crate::asked::Asked;
use crate::job::{AnyJob, JobPort, Work};
use crate::join::JoinQueue;
use crate::management::Command;
use crate::mechanism::Offers;
use crate::messaging::{Outboxes, Topics};
use crate::schedule::{Tasks, Timer};
use crate::service::{AnyClient, AnyServer, ClientPort, ServerPort};
use crate::setting::Settings;
use crate::{Job, JobError, ModuleId};

/// What a module owns beside its state.
pub(crate) struct ModuleIo {
    pub(crate) name: Arc<str>,
    pub(crate) id: ModuleId,
    pub(crate) queue: Arc<JoinQueue>,
    pub(crate) outboxes: Outboxes,
    pub(crate) settings: Settings,
    pub(crate) timers: Vec<Timer>,
    pub(crate) tasks: Tasks,
    pub(crate) clients: Vec<Box<dyn AnyClient>>,
    pub(crate) servers: Vec<Box<dyn AnyServer>>,
    pub(crate) jobs: Vec<Box<dyn AnyJob>>,
    pub(crate) work: Vec<Work>,
    pub(crate) commands: Vec<Command>,
    /// By mechanism: what was asked of it, a `Vec` of its requests.
    pub(crate) asks: Vec<Option<Box<dyn Any + Send>>>,
    pub(crate) asked: Asked,
}

impl ModuleIo {
    pub(crate) fn new(name: Arc<str>, id: ModuleId, queue: Arc<JoinQueue>) -> Self {
        Self {
            name,
            id,
            queue,
            outboxes: Outboxes::default(),
            settings: Settings::default(),
            timers: Vec::new(),
            tasks: Tasks::default(),
            clients: Vec::new(),
            servers: Vec::new(),
            jobs: Vec::new(),
            work: Vec::new(),
            commands: Vec::new(),
            asks: Vec::new(),
            asked: Asked::default(),
        }
    }

    /// Forgets what a run asked for that panicked. May panic itself, where dropping a message does.
    pub(crate) fn discard(&mut self) {
        self.outboxes.discard();
        self.clients.iter_mut().for_each(|client| client.reset());
        self.servers.iter_mut().for_each(|server| server.discard_answers());
        self.work.clear();
        self.commands.clear();
        self.asks.clear();
    }

    pub(crate) fn client<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        port: u32,
    ) -> Option<&mut ClientPort<Q, R>> {
        let port: &mut dyn Any = &mut **self.clients.get_mut(port as usize)?;
        port.downcast_mut()
    }

    pub(crate) fn server<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        port: u32,
    ) -> Option<&mut ServerPort<Q, R>> {
        let port: &mut dyn Any = &mut **self.servers.get_mut(port as usize)?;
        port.downcast_mut()
    }

    pub(crate) fn take_results<T: Send + 'static>(&mut self, job: Job<T>) -> Vec<Result<T, JobError>> {
        let port = self.jobs.get_mut(job.port as usize).map(|port| &mut **port as &mut dyn Any);
        port.and_then(|port| port.downcast_mut::<JobPort<T>>()).map(JobPort::take).unwrap_or_default()
    }
}

/// What modules read in the process phase and nobody writes.
#[derive(Default)]
pub(crate) struct Shared {
    pub(crate) topics: Topics,
    pub(crate) offers: Offers,
}
