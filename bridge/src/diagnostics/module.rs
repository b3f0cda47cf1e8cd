//! The module that publishes diagnostics.

use super::status;
use crate::expose::{BridgeStatus, EndpointReport, OfferedService, ServicesStatus};
use crate::middleware::SecurityWatch;
use downbeat_executor::{
    Context, Core, CoreHandle, Inbox, Module, ModuleOptions, Publication, Receipt, Role, Setup, SetupError,
    Snapshot, Synchrony, Task,
};
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use downbeat_msgs::std_msgs::msg::Header;
use parking_lot::Mutex;
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::time::Duration;

/// The name under which it joins a core.
pub const MODULE_NAME: &str = "process_diagnostics";

/// The topic of a core on which it publishes.
pub const TOPIC: &str = "diagnostics";

const PERIOD: Duration = Duration::from_secs(1);
/// How long a running core may take to answer.
const PATIENCE: Duration = Duration::from_millis(50);
/// It has no inputs.
const INBOX: NonZeroUsize = NonZeroUsize::MIN;

/// Reports the state of the process once a second. Clones share one report.
#[derive(Clone)]
pub struct ProcessDiagnostics {
    sources: Arc<Mutex<Sources>>,
}

type Source = dyn FnMut() -> Vec<DiagnosticStatus> + Send;

#[derive(Default)]
struct Sources {
    endpoints: Option<BridgeStatus>,
    services: Option<ServicesStatus>,
    others: Vec<Box<Source>>,
}

impl ProcessDiagnostics {
    /// Adds the detached observer [`MODULE_NAME`], which publishes on [`TOPIC`]. Names of components begin
    /// with `name`, that of the node.
    ///
    /// # Errors
    /// If the core has such a module, or the topic carries another type.
    pub fn add(core: &mut Core, name: &str) -> Result<Self, SetupError> {
        let sources = Arc::<Mutex<Sources>>::default();
        let module = Reporter {
            name: name.to_owned(),
            core: core.handle(),
            sources: Arc::clone(&sources),
            asked: None,
            last: None,
            endpoints: Vec::new(),
            services: Vec::new(),
        };
        let options = ModuleOptions {
            synchrony: Synchrony::Detached(Inbox::KeepLast(INBOX)),
            role: Role::Observer,
            ..ModuleOptions::default()
        };
        core.add_with(MODULE_NAME, module, options)?;
        Ok(Self { sources })
    }

    /// Reports the endpoints of a bridge too.
    pub fn watch_endpoints(&self, status: BridgeStatus) {
        self.sources.lock().endpoints = Some(status);
    }

    /// Reports the services that are offered to ROS 2 too.
    pub fn watch_services(&self, status: ServicesStatus) {
        self.sources.lock().services = Some(status);
    }

    /// Reports the state of security: who was refused, and what expires.
    pub fn watch_security(&self, node: &str, look: SecurityWatch) {
        let (node, mut last) = (node.to_owned(), None);
        self.watch(move || {
            let now = look();
            let report = status::security(&node, &now, last.as_ref());
            last = Some(now);
            vec![report]
        });
    }

    /// Reports what `look` returns too. It is called once a second on the thread of the module, and must not
    /// block.
    pub fn watch(&self, look: impl FnMut() -> Vec<DiagnosticStatus> + Send + 'static) {
        self.sources.lock().others.push(Box::new(look));
    }
}

struct Reporter {
    name: String,
    core: CoreHandle,
    sources: Arc<Mutex<Sources>>,
    asked: Option<Receipt<Snapshot>>,
    /// The snapshot of the last report: the difference to it decides on levels.
    last: Option<Snapshot>,
    endpoints: Vec<EndpointReport>,
    services: Vec<OfferedService>,
}

struct Ports {
    diagnostics: Publication<DiagnosticArray>,
    take: Task,
}

impl Module for Reporter {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.every(PERIOD, Self::ask)?;
        Ok(Ports { diagnostics: setup.publish(TOPIC)?, take: setup.task(Self::take) })
    }
}

impl Reporter {
    fn ask(&mut self, ctx: &mut Context<'_, Ports>) {
        if self.asked.is_some() {
            self.publish_report(ctx, None);
        }
        self.asked = Some(self.core.snapshot());
        ctx.schedule_after(ctx.ports.take, PATIENCE);
    }

    fn take(&mut self, ctx: &mut Context<'_, Ports>) {
        let Some(asked) = &self.asked else { return };
        // If the core does not answer now, the next report is stale.
        if let Some(snapshot) = asked.try_take() {
            self.asked = None;
            self.publish_report(ctx, Some(snapshot));
        }
    }

    fn publish_report(&mut self, ctx: &mut Context<'_, Ports>, snapshot: Option<Snapshot>) {
        let mut statuses = Vec::new();
        match &snapshot {
            None => statuses.push(status::silent_core(&self.name)),
            Some(snapshot) => statuses.extend(status::core(&self.name, snapshot, self.last.as_ref())),
        }
        {
            let mut sources = self.sources.lock();
            let now: Vec<_> = sources.endpoints.iter().flat_map(BridgeStatus::endpoints).collect();
            for report in &now {
                let last = self.endpoints.iter().find(|last| last.endpoint == report.endpoint);
                statuses.push(status::endpoint(&self.name, report, last));
            }
            self.endpoints = now;
            if let Some(services) = &sources.services {
                let now = services.offered();
                for service in &now {
                    let is_same = |last: &&OfferedService| {
                        (&last.service, &last.network) == (&service.service, &service.network)
                    };
                    let last = self.services.iter().find(is_same);
                    statuses.push(status::service(&self.name, service, last));
                }
                self.services = now;
            }
            statuses.extend(sources.others.iter_mut().flat_map(|look| look()));
        }
        self.last = snapshot.or(self.last.take());
        let header = Header { stamp: Time::from_nanos(ctx.now().as_nanos()), frame_id: String::new() };
        ctx.publish(ctx.ports.diagnostics, DiagnosticArray { header, status: statuses });
    }
}
