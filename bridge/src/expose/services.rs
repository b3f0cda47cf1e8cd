//! Services of modules offered to ROS 2, and services of ROS 2 that modules call.

use super::ExposeError;
use super::endpoints::Traffic;
use super::network_nodes::NetworkNodes;
use super::open_requests::OpenRequests;
use crate::edge::{
    CoreAccess, EncodedAnswer, EncodedCallError, EncodedCaller, KnownService, Refusals, RemoteCall,
    RemoteServices,
};
use crate::middleware::rpc::{IncomingRequest, Responder};
use crate::ros::{Introspection, Node, NodeError, RawClient, Service, ServiceName, ServiceType};
use crate::worker::WorkerLink;
use bytes::Bytes;
use downbeat_executor::{
    CallError, Clock, Core, CoreHandle, Module, ModuleOptions, Role, Setting, Setup, SetupError,
};
use downbeat_msgs::qos::QosProfile;
use parking_lot::{Mutex, RwLock};
use std::borrow::Cow;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock, Weak};
use std::time::Duration;

/// The name under which what publishes events of services joins a core.
pub const SERVICES_MODULE_NAME: &str = "bridge_services";

/// The name of the module that serves the services of ROS 2 that modules call.
pub const CALLS_MODULE_NAME: &str = "bridge_calls";

/// A service of modules to offer to ROS 2, or a service of ROS 2 that modules call.
#[derive(Clone, Debug)]
pub struct ServiceExposure {
    /// The service in the executor.
    pub service: String,
    /// The service in ROS 2 where it differs: absolute, relative to the node's namespace, or private (`~/…`).
    pub ros_service: Option<String>,
    /// The type of the service.
    pub service_type: KnownService,
    /// How long the server may take.
    pub timeout: Duration,
    /// The network that has it; `None` for that of the own node.
    pub network: Option<String>,
}

impl ServiceExposure {
    /// The service in ROS 2, before it is expanded.
    #[must_use]
    pub fn ros_service(&self) -> &str {
        self.ros_service.as_deref().unwrap_or(&self.service)
    }
}

/// How much of services and calls is published on `<service>/_service_event`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ServiceIntrospection {
    /// Of services of modules.
    pub services: Introspection,
    /// Of services that modules call.
    pub clients: Introspection,
}

impl ServiceIntrospection {
    /// The setting of [`SERVICES_MODULE_NAME`] for services; named as the parameter of `demo_nodes_cpp`.
    pub const OF_SERVICES: &str = "service_configure_introspection";
    /// The setting of [`SERVICES_MODULE_NAME`] for calls; named as the parameter of `demo_nodes_cpp`.
    pub const OF_CLIENTS: &str = "client_configure_introspection";
}

/// Reports the services, for a status display on another thread. It keeps no endpoint alive.
#[derive(Clone, Default)]
pub struct ServicesStatus {
    services: Arc<RwLock<Vec<ServiceStatus>>>,
}

/// A service of modules as ROS 2 has used it so far.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OfferedService {
    /// Its name in ROS 2, absolute.
    pub service: String,
    /// The network that has it; `None` for that of the own node.
    pub network: Option<String>,
    /// As in `std_srvs/srv/SetBool`.
    pub type_name: &'static str,
    /// Requests that a module answered.
    pub answered: u64,
    /// Requests that were answered with a refusal.
    pub refused: u64,
    /// Why the last one was.
    pub last_refusal: Option<String>,
}

/// A service of modules or of ROS 2, and what was called so far.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServiceReport {
    /// Its name in ROS 2, absolute.
    pub service: String,
    /// The network that has it; `None` for that of the own node.
    pub network: Option<String>,
    /// Whether a peer is matched.
    pub is_matched: bool,
    /// Calls with an answer.
    pub answered: u64,
    /// Calls without one.
    pub failed: u64,
}

struct ServiceStatus {
    name: String,
    network: Option<String>,
    type_name: &'static str,
    traffic: Arc<Traffic>,
    endpoint: WeakService,
}

enum WeakService {
    Offered(Weak<Service>),
    Called(Weak<RawClient>),
}

impl ServicesStatus {
    /// The services that are offered to ROS 2.
    #[must_use]
    pub fn offered(&self) -> Vec<OfferedService> {
        let services = self.services.read();
        let offered = services.iter().filter(|status| matches!(status.endpoint, WeakService::Offered(_)));
        offered
            .map(|status| {
                let (answered, refused) = status.traffic.totals();
                let (service, network) = (status.name.clone(), status.network.clone());
                let (type_name, last_refusal) = (status.type_name, status.traffic.last_error());
                OfferedService { service, network, type_name, answered, refused, last_refusal }
            })
            .collect()
    }

    /// All services, in the order in which they were exposed.
    #[must_use]
    pub fn services(&self) -> Vec<ServiceReport> {
        let report = |status: &ServiceStatus| {
            let is_matched = match &status.endpoint {
                WeakService::Offered(service) => service.upgrade().is_some_and(|s| s.matched_clients() > 0),
                WeakService::Called(client) => client.upgrade().is_some_and(|client| client.is_available()),
            };
            let (answered, failed) = status.traffic.totals();
            let (service, network) = (status.name.clone(), status.network.clone());
            ServiceReport { service, network, is_matched, answered, failed }
        };
        self.services.read().iter().map(report).collect()
    }
}

/// Offers services of modules on a node or on one in each network, and adds observers to `core`:
/// [`CALLS_MODULE_NAME`] serves those that modules call, [`SERVICES_MODULE_NAME`] has the settings of service
/// introspection.
///
/// ROS 2 has no response for a refused request, and its clients wait until one comes. So each request is
/// answered: where a module refuses it, panics, is removed or takes too long, with the response that
/// [`Refusals`] makes for its type.
///
/// The endpoints are removed when the core stops.
///
/// # Errors
/// [`ExposeError`] when a service cannot be exposed.
pub fn expose_services(
    core: &mut Core,
    nodes: impl Into<NetworkNodes>,
    offered: &[ServiceExposure],
    called: &[ServiceExposure],
) -> Result<ServicesStatus, ExposeError> {
    expose_services_with(core, nodes, offered, called, ServiceIntrospection::default())
}

/// The same, with service introspection; settings of [`SERVICES_MODULE_NAME`] change that while the core
/// runs: [`ServiceIntrospection::OF_SERVICES`] and [`ServiceIntrospection::OF_CLIENTS`], "disabled",
/// "metadata" or "contents".
///
/// # Errors
/// [`ExposeError`] when a service cannot be exposed.
pub fn expose_services_with(
    core: &mut Core,
    nodes: impl Into<NetworkNodes>,
    offered: &[ServiceExposure],
    called: &[ServiceExposure],
    introspection: ServiceIntrospection,
) -> Result<ServicesStatus, ExposeError> {
    Ok(ExposedServices::start(core, nodes, offered, called, introspection)?.status())
}

/// The services of a core in ROS 2, which may become more while the core runs.
#[derive(Clone)]
pub struct ExposedServices {
    nodes: NetworkNodes,
    endpoints: Arc<Mutex<Option<ServiceEndpoints>>>,
    status: ServicesStatus,
    /// How many modules serve services of ROS 2.
    calls_modules: Arc<AtomicUsize>,
}

impl ExposedServices {
    /// See [`expose_services_with`].
    ///
    /// # Errors
    /// [`ExposeError`] when a service cannot be exposed.
    pub fn start(
        core: &mut Core,
        nodes: impl Into<NetworkNodes>,
        offered: &[ServiceExposure],
        called: &[ServiceExposure],
        introspection: ServiceIntrospection,
    ) -> Result<Self, ExposeError> {
        let endpoints =
            ServiceEndpoints { clock: core.clock(), introspection, offered: Vec::new(), clients: Vec::new() };
        let endpoints = Arc::new(Mutex::new(Some(endpoints)));
        let (status, calls_modules) = Default::default();
        let services = Self { nodes: nodes.into(), endpoints, status, calls_modules };
        services.open(&mut CoreAccess::Idle(core), offered, called)?;
        let (endpoints, worker) = (Arc::clone(&services.endpoints), services.nodes.own().worker());
        let module = Services { endpoints, worker, introspection };
        let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
        core.add_with(SERVICES_MODULE_NAME, module, options)?;
        let endpoints = Arc::clone(&services.endpoints);
        core.on_stop(move || {
            if let Some(mut endpoints) = endpoints.lock().take() {
                endpoints.introspect_clients(Introspection::Off);
            }
        });
        Ok(services)
    }

    /// Exposes more while the core runs. Waits for the end of a cycle, so it must not be called on the core's
    /// own thread.
    ///
    /// # Errors
    /// [`ExposeError`] when a service cannot be exposed, or the core does not run.
    pub fn add(
        &self,
        core: &CoreHandle,
        offered: &[ServiceExposure],
        called: &[ServiceExposure],
    ) -> Result<(), ExposeError> {
        self.open(&mut CoreAccess::Running(core), offered, called)
    }

    /// Reports the services.
    #[must_use]
    pub fn status(&self) -> ServicesStatus {
        self.status.clone()
    }

    fn open(
        &self,
        core: &mut CoreAccess<'_>,
        offered: &[ServiceExposure],
        called: &[ServiceExposure],
    ) -> Result<(), ExposeError> {
        let (mut statuses, mut remote) = (Vec::new(), Vec::new());
        let (mut services, mut clients) = (Vec::new(), Vec::new());
        for exposure in offered {
            let node = self.nodes.find(&exposure.service, exposure.network.as_deref())?;
            let traffic = Arc::<Traffic>::default();
            let caller = exposure.service_type.caller_in(core, &exposure.service)?;
            let service = offer(node, exposure, caller, Arc::clone(&traffic))
                .map_err(|error| failed(&exposure.service, error))?;
            let (name, service) = (service.name().to_string(), Arc::new(service));
            statuses.push(ServiceStatus {
                name,
                network: exposure.network.clone(),
                type_name: exposure.service_type.name(),
                traffic,
                endpoint: WeakService::Offered(Arc::downgrade(&service)),
            });
            services.push((node.clone(), service));
        }
        for exposure in called {
            let node = self.nodes.find(&exposure.service, exposure.network.as_deref())?;
            let traffic = Arc::<Traffic>::default();
            let client = client(node, exposure).map_err(|error| failed(&exposure.service, error))?;
            let (name, client) = (client.name().to_string(), Arc::new(client));
            let endpoint = WeakService::Called(Arc::downgrade(&client));
            clients.push((node.clone(), Arc::downgrade(&client)));
            let (worker, timeout) = (node.worker(), exposure.timeout);
            let call = ToRos { client, worker, timeout, traffic: Arc::clone(&traffic) };
            remote.push(exposure.service_type.remote_in(core, &exposure.service, call)?);
            let (network, type_name) = (exposure.network.clone(), exposure.service_type.name());
            statuses.push(ServiceStatus { name, network, type_name, traffic, endpoint });
        }
        if !remote.is_empty() {
            let name = match self.calls_modules.fetch_add(1, Ordering::Relaxed) {
                0 => CALLS_MODULE_NAME.to_owned(),
                before => format!("{CALLS_MODULE_NAME}_{}", before + 1),
            };
            RemoteServices::add_in(core, &name, remote)?;
        }
        // `None` once the core has stopped.
        if let Some(endpoints) = &mut *self.endpoints.lock() {
            endpoints.add(services, clients);
            self.status.services.write().extend(statuses);
        }
        Ok(())
    }
}

/// The endpoints of the services of a core, until it stops.
struct ServiceEndpoints {
    clock: Arc<dyn Clock>,
    /// As it is now.
    introspection: ServiceIntrospection,
    /// Each with its node.
    offered: Vec<(Node, Arc<Service>)>,
    clients: Vec<(Node, Weak<RawClient>)>,
}

impl ServiceEndpoints {
    fn add(&mut self, offered: Vec<(Node, Arc<Service>)>, clients: Vec<(Node, Weak<RawClient>)>) {
        let ServiceIntrospection { services: of_services, clients: of_clients } = self.introspection;
        self.introspect(&offered, of_services);
        self.introspect_calls(&clients, of_clients);
        self.offered.extend(offered);
        self.clients.extend(clients);
    }

    fn introspect_services(&mut self, introspection: Introspection) {
        self.introspection.services = introspection;
        self.introspect(&self.offered, introspection);
    }

    fn introspect_clients(&mut self, introspection: Introspection) {
        self.introspection.clients = introspection;
        self.introspect_calls(&self.clients, introspection);
    }

    fn introspect(&self, services: &[(Node, Arc<Service>)], introspection: Introspection) {
        for (node, service) in services {
            let clock = Arc::clone(&self.clock);
            log_failure(
                service.name(),
                service.configure_introspection(node, introspection, QosProfile::SERVICES, clock),
            );
        }
    }

    fn introspect_calls(&self, clients: &[(Node, Weak<RawClient>)], introspection: Introspection) {
        for (node, client) in clients {
            let Some(client) = client.upgrade() else { continue };
            let clock = Arc::clone(&self.clock);
            log_failure(
                client.name(),
                client.configure_introspection(node, introspection, QosProfile::SERVICES, clock),
            );
        }
    }
}

/// The module with the settings of introspection.
struct Services {
    endpoints: Arc<Mutex<Option<ServiceEndpoints>>>,
    worker: WorkerLink,
    introspection: ServiceIntrospection,
}

impl Module for Services {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let ServiceIntrospection { services, clients } = self.introspection;
        let of_services = introspection_setting(setup, ServiceIntrospection::OF_SERVICES, services)?;
        let of_clients = introspection_setting(setup, ServiceIntrospection::OF_CLIENTS, clients)?;
        setup.on_change(of_services, move |module: &mut Self, ctx| {
            let introspection = chosen(ctx.get(of_services).as_str());
            module.on_worker(move |endpoints| endpoints.introspect_services(introspection));
        });
        setup.on_change(of_clients, move |module: &mut Self, ctx| {
            let introspection = chosen(ctx.get(of_clients).as_str());
            module.on_worker(move |endpoints| endpoints.introspect_clients(introspection));
        });
        Ok(())
    }
}

impl Services {
    /// DDS does not run on the thread of the core.
    fn on_worker(&self, change: impl FnOnce(&mut ServiceEndpoints) + Send + 'static) {
        let endpoints = Arc::downgrade(&self.endpoints);
        self.worker.run(move || {
            if let Some(endpoints) = endpoints.upgrade()
                && let Some(endpoints) = &mut *endpoints.lock()
            {
                change(endpoints);
            }
        });
    }
}

fn introspection_setting(
    setup: &mut Setup<'_, Services>,
    name: &str,
    default: Introspection,
) -> Result<Setting<String>, SetupError> {
    let about = "what is published on <service>/_service_event: disabled, metadata or contents";
    let setting = setup.setting(name, default.to_string(), about)?;
    setup.accept_if(setting, |_, text: &String| {
        text.parse::<Introspection>().map(drop).map_err(|error| error.to_string())
    });
    Ok(setting)
}

/// The value was accepted, so it is one of the words.
fn chosen(setting: &str) -> Introspection {
    setting.parse().unwrap_or_default()
}

fn log_failure(service: &ServiceName, configured: Result<(), NodeError>) {
    if let Err(error) = configured {
        tracing::warn!("events of service {service} are not published: {error}");
    }
}

fn offer(
    node: &Node,
    exposure: &ServiceExposure,
    caller: EncodedCaller,
    traffic: Arc<Traffic>,
) -> Result<Service, NodeError> {
    let (service_type, timeout) = (exposure.service_type, exposure.timeout);
    let refusals = Arc::new(ServiceRefusals { service_type, refusals: OnceLock::new(), traffic });
    let of_server = Arc::clone(&refusals);
    let (of_due, service) = (Arc::clone(&refusals), Arc::<str>::from(&*exposure.service));
    let open = OpenRequests::watched(node.worker(), timeout, move |responder| {
        let error = CallError::TimedOut { service: Arc::clone(&service), timeout };
        of_due.answer(responder, Err(error.into()));
    });
    let on_request = move |IncomingRequest { cdr, responder, .. }: IncomingRequest| {
        let refusals = Arc::clone(&refusals);
        let request = open.keep(responder);
        caller.call(&cdr, timeout, move |result| {
            if let Some(responder) = request.take() {
                refusals.answer(responder, result);
            }
        });
    };
    let service = node.serve_raw(
        exposure.ros_service(),
        &ServiceType::new(service_type.name())?,
        QosProfile::SERVICES,
        Box::new(on_request),
    )?;
    service.on_refusal(Box::new(move |reason| of_server.get().response(reason).into()));
    Ok(service)
}

/// What clients of a service receive for requests that have no answer.
struct ServiceRefusals {
    service_type: KnownService,
    /// Set once the definition of the type is known.
    refusals: OnceLock<Refusals>,
    traffic: Arc<Traffic>,
}

impl ServiceRefusals {
    /// Answers a request, from any thread: neither serialises nor writes on it.
    fn answer(self: &Arc<Self>, responder: Responder, result: Result<EncodedAnswer, EncodedCallError>) {
        let is_first = self.traffic.count(&result.as_ref().map(drop).map_err(ToString::to_string));
        let refusals = Arc::clone(self);
        match result {
            Ok(answer) => responder.reply_later(|| answer.into_cdr().into()),
            Err(error) => responder.reply_later(move || {
                if is_first {
                    refusals.warn(&error);
                }
                refusals.response(&error)
            }),
        }
    }

    fn get(&self) -> Cow<'_, Refusals> {
        if let Some(refusals) = self.refusals.get() {
            return Cow::Borrowed(refusals);
        }
        if self.service_type.response_type().is_none() {
            return Cow::Owned(self.service_type.refusals());
        }
        Cow::Borrowed(self.refusals.get_or_init(|| self.service_type.refusals()))
    }

    fn response(&self, error: &EncodedCallError) -> Bytes {
        let reason = match error {
            EncodedCallError::Call(CallError::Refused { reason, .. }) => reason.clone(),
            error => error.to_string(),
        };
        self.get().response(&reason).into()
    }

    /// `error` names the service.
    fn warn(&self, error: &EncodedCallError) {
        let service_type = self.service_type;
        if self.get().are_visible() {
            tracing::warn!("a request of ROS 2 was refused: {error}; from now on this is only counted");
        } else {
            tracing::warn!(
                "a request of ROS 2 was refused: {error}; its client cannot tell, since a response of {service_type} has \
                 no field for it: it receives default values; from now on this is only counted"
            );
        }
    }
}

fn client(node: &Node, exposure: &ServiceExposure) -> Result<RawClient, NodeError> {
    node.client_raw(
        exposure.ros_service(),
        &ServiceType::new(exposure.service_type.name())?,
        QosProfile::SERVICES,
    )
}

/// Sends the calls of modules to ROS 2.
struct ToRos {
    client: Arc<RawClient>,
    worker: WorkerLink,
    timeout: Duration,
    traffic: Arc<Traffic>,
}

impl RemoteCall for ToRos {
    fn call(
        &mut self,
        request: Box<dyn FnOnce() -> Bytes + Send>,
        on_answer: Box<dyn FnOnce(Result<Bytes, String>) + Send>,
    ) {
        let (client, traffic, timeout) = (Arc::clone(&self.client), Arc::clone(&self.traffic), self.timeout);
        // The thread of the core neither serializes nor writes.
        self.worker.run(move || {
            client.call(request(), timeout, move |result| {
                let result = result.map_err(|error| error.to_string());
                // The module that called receives the error, and decides whether to log it.
                traffic.count(&result.as_ref().map(drop));
                on_answer(result);
            });
        });
    }
}

fn failed(service: &str, error: NodeError) -> ExposeError {
    ExposeError::Service { service: service.to_owned(), error }
}
