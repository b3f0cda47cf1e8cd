//! Services of modules offered to ROS 2, and services of ROS 2 that modules call.

use super::ExposeError;
use super::endpoints::Traffic;
use crate::edge::{EncodedCallError, EncodedCaller, KnownService, RemoteCall, RemoteServices};
use crate::middleware::rpc::IncomingRequest;
use crate::ros::{Introspection, Node, NodeError, RawClient, Service, ServiceName, ServiceType};
use crate::worker::WorkerLink;
use bytes::Bytes;
use downbeat_executor::{CallError, Clock, Core, Module, ModuleOptions, Role, Setting, Setup, SetupError};
use downbeat_msgs::action_msgs::srv::{CancelGoal, CancelGoalResponse};
use downbeat_msgs::cdr;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::std_srvs::srv::{SetBool, SetBoolResponse, Trigger, TriggerResponse};
use parking_lot::Mutex;
use std::sync::{Arc, Weak};
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
    services: Arc<[ServiceStatus]>,
}

struct ServiceStatus {
    name: String,
    traffic: Arc<Traffic>,
    endpoint: WeakService,
}

enum WeakService {
    Offered(Weak<Service>),
    Called(Weak<RawClient>),
}

impl ServicesStatus {
    /// Each service of ROS 2: its name, whether a peer is matched, calls with and without an answer.
    #[must_use]
    pub fn services(&self) -> Vec<(String, bool, u64, u64)> {
        let report = |status: &ServiceStatus| {
            let is_matched = match &status.endpoint {
                WeakService::Offered(service) => service.upgrade().is_some_and(|s| s.matched_clients() > 0),
                WeakService::Called(client) => client.upgrade().is_some_and(|client| client.is_available()),
            };
            let (answered, failed) = status.traffic.totals();
            (status.name.clone(), is_matched, answered, failed)
        };
        self.services.iter().map(report).collect()
    }
}

/// Offers services of modules on `node`, and adds observers to `core`: [`CALLS_MODULE_NAME`] serves those that modules call,
/// [`SERVICES_MODULE_NAME`] has the settings of service introspection.
///
/// ROS 2 has no response for a refused request. `std_srvs/srv/SetBool` and `Trigger` are then answered with
/// `success: false` and the reason as message, those of actions with a goal that is not accepted, not known or not canceled; a
/// request of another type is not answered, and the reason is in the log.
///
/// The endpoints are removed when the core stops.
///
/// # Errors
/// [`ExposeError`] when a service cannot be exposed.
pub fn expose_services(
    core: &mut Core,
    node: &Node,
    offered: &[ServiceExposure],
    called: &[ServiceExposure],
) -> Result<ServicesStatus, ExposeError> {
    expose_services_with(core, node, offered, called, ServiceIntrospection::default())
}

/// The same, with service introspection; settings of [`SERVICES_MODULE_NAME`] change that while the core runs:
/// [`ServiceIntrospection::OF_SERVICES`] and [`ServiceIntrospection::OF_CLIENTS`], "disabled", "metadata" or "contents".
///
/// # Errors
/// [`ExposeError`] when a service cannot be exposed.
pub fn expose_services_with(
    core: &mut Core,
    node: &Node,
    offered: &[ServiceExposure],
    called: &[ServiceExposure],
    introspection: ServiceIntrospection,
) -> Result<ServicesStatus, ExposeError> {
    let mut endpoints = ServiceEndpoints {
        node: node.clone(),
        clock: core.clock(),
        offered: Vec::new(),
        clients: Vec::new(),
    };
    let (mut statuses, mut remote) = (Vec::new(), Vec::new());
    for exposure in offered {
        let traffic = Arc::<Traffic>::default();
        let caller = exposure.service_type.caller(core, &exposure.service)?;
        let service = offer(node, exposure, caller, Arc::clone(&traffic))
            .map_err(|error| failed(&exposure.service, error))?;
        let (name, service) = (service.name().to_string(), Arc::new(service));
        statuses.push(ServiceStatus {
            name,
            traffic,
            endpoint: WeakService::Offered(Arc::downgrade(&service)),
        });
        endpoints.offered.push(service);
    }
    for exposure in called {
        let traffic = Arc::<Traffic>::default();
        let client = client(node, exposure).map_err(|error| failed(&exposure.service, error))?;
        let (name, client) = (client.name().to_string(), Arc::new(client));
        let endpoint = WeakService::Called(Arc::downgrade(&client));
        endpoints.clients.push(Arc::downgrade(&client));
        let (worker, timeout) = (node.worker(), exposure.timeout);
        let call = ToRos { client, worker, timeout, traffic: Arc::clone(&traffic) };
        remote.push(exposure.service_type.remote(core, &exposure.service, call)?);
        statuses.push(ServiceStatus { name, traffic, endpoint });
    }
    RemoteServices::add_to(core, CALLS_MODULE_NAME, remote)?;
    let endpoints = Arc::new(Mutex::new(Some(endpoints)));
    let module = Services { endpoints: Arc::clone(&endpoints), worker: node.worker(), introspection };
    let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
    core.add_with(SERVICES_MODULE_NAME, module, options)?;
    core.on_stop(move || {
        if let Some(endpoints) = endpoints.lock().take() {
            endpoints.introspect_clients(Introspection::Off);
        }
    });
    Ok(ServicesStatus { services: statuses.into() })
}

/// The endpoints of the services of a core, until it stops.
struct ServiceEndpoints {
    node: Node,
    clock: Arc<dyn Clock>,
    offered: Vec<Arc<Service>>,
    clients: Vec<Weak<RawClient>>,
}

impl ServiceEndpoints {
    fn introspect_services(&self, introspection: Introspection) {
        for service in &self.offered {
            let clock = Arc::clone(&self.clock);
            log_failure(
                service.name(),
                service.configure_introspection(&self.node, introspection, QosProfile::SERVICES, clock),
            );
        }
    }

    fn introspect_clients(&self, introspection: Introspection) {
        for client in self.clients.iter().filter_map(Weak::upgrade) {
            let clock = Arc::clone(&self.clock);
            log_failure(
                client.name(),
                client.configure_introspection(&self.node, introspection, QosProfile::SERVICES, clock),
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
        if let Some(endpoints) = &*self.endpoints.lock() {
            endpoints.introspect_services(services);
            endpoints.introspect_clients(clients);
        }
        Ok(())
    }
}

impl Services {
    /// DDS does not run on the thread of the core.
    fn on_worker(&self, change: impl FnOnce(&ServiceEndpoints) + Send + 'static) {
        let endpoints = Arc::downgrade(&self.endpoints);
        self.worker.run(move || {
            if let Some(endpoints) = endpoints.upgrade()
                && let Some(endpoints) = &*endpoints.lock()
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
    let on_request = move |IncomingRequest { cdr, responder, .. }: IncomingRequest| {
        let traffic = Arc::clone(&traffic);
        caller.call(&cdr, timeout, move |result| {
            let outcome = result.as_ref().map(drop).map_err(ToString::to_string);
            if traffic.count(&outcome)
                && let Err(error) = outcome
            {
                tracing::warn!("a request of ROS 2 was refused: {error}; from now on this is only counted");
            }
            match result {
                // On the thread of the core, which neither serialises nor writes.
                Ok(answer) => responder.reply_later(|| answer.into_cdr().into()),
                Err(error) => {
                    if let Some(refusal) = refusal(service_type, &error) {
                        responder.reply_later(|| refusal);
                    }
                }
            }
        });
    };
    node.serve_raw(
        exposure.ros_service(),
        &ServiceType::new(service_type.name())?,
        QosProfile::SERVICES,
        Box::new(on_request),
    )
}

/// The negative response, if the type has one.
fn refusal(service_type: KnownService, error: &EncodedCallError) -> Option<Bytes> {
    let message = match error {
        EncodedCallError::Call(CallError::Refused { reason, .. }) => reason.clone(),
        error => error.to_string(),
    };
    use downbeat_msgs::Service as _;
    match service_type.name() {
        SetBool::TYPE_NAME => Some(cdr::to_vec(&SetBoolResponse { success: false, message }).into()),
        Trigger::TYPE_NAME => Some(cdr::to_vec(&TriggerResponse { success: false, message }).into()),
        CancelGoal::TYPE_NAME => {
            let return_code = CancelGoalResponse::ERROR_REJECTED;
            Some(cdr::to_vec(&CancelGoalResponse { return_code, ..CancelGoalResponse::default() }).into())
        }
        // Of an action: not accepted, or not known.
        name if name.contains("/action/") => Some(service_type.default_response().into()),
        _ => None,
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
