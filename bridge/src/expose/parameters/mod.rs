//! Parameters of nodes, with the six services that parameter clients call and the events they listen to: what every node of
//! rclcpp declares, and settings of modules as `<module>.<setting>`.
//!
//! Answers are those of rclcpp (`rclcpp/src/rclcpp/parameter_service.cpp` and `node_interfaces/node_parameters.cpp`, branch
//! jazzy), but for three things: a whole number is accepted for a double, atomic changes of several modules are taken back
//! when one is refused rather than made at once, and a value that changes otherwise than through these services is told within a second.

mod own;
mod store;
mod thread;
mod value;

pub use value::{parameter_value, setting_value};

use super::TopicPattern;
use crate::clock::SimTime;
use crate::limiter::Limiter;
use crate::ros::{Node, NodeError, Service};
use downbeat_executor::{Core, CoreHandle, SettingInfo};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rcl_interfaces::srv::{
    DescribeParameters, GetParameterTypes, GetParameters, ListParameters, SetParameters,
    SetParametersAtomically,
};
use std::io;
use std::sync::{Arc, Mutex};
use store::Parameters;
use thread::{Jobs, ParameterThread, lock};

/// Which settings of modules are parameters of a node.
#[derive(Clone, Debug, Default)]
pub struct ParameterExposure {
    /// Names `<module>.<setting>`, or patterns for them in which `*` stands for any characters.
    pub settings: Vec<TopicPattern>,
    /// Of a node that stands for one module: that module, whose settings alone the node has, without its name before them.
    pub of_module: Option<String>,
}

/// Gives the nodes of a core their parameters. Clones share the thread that answers, which ends with the last of them and
/// of their services.
///
/// Requests are answered on a thread of their own, since the core takes until its next sync phase to say whether a value
/// is accepted. While it does not answer, the values last known are given.
///
/// ```
/// use downbeat_bridge::expose::{ParameterExposure, ParameterServer};
/// use downbeat_bridge::middleware::in_process::Hub;
/// use downbeat_bridge::ros::{NodeName, Participant};
/// use downbeat_executor::Core;
///
/// let participant = Participant::on(std::sync::Arc::new(Hub::new().join()))?;
/// let node = participant.create_node(NodeName::new("/", "robot")?)?;
/// let server = ParameterServer::start(&Core::new(), None)?;
/// let _services = server.serve(&node, ParameterExposure::default())?; // use_sim_time and what else every node has.
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct ParameterServer {
    shared: Arc<Shared>,
}

struct Shared {
    core: CoreHandle,
    sim_time: Option<SimTime>,
    /// The settings of all modules when the server was started.
    settings: Vec<(String, Vec<SettingInfo>)>,
    thread: ParameterThread,
}

/// The parameters of a node. Dropping it removes them.
pub struct ParameterServices {
    // Fields drop in this order: nothing is asked any more when the thread ends.
    _services: [Service; 6],
    _parameters: Arc<Mutex<Parameters>>,
    _server: ParameterServer,
}

impl ParameterServer {
    /// Starts the thread that answers. Without a `sim_time` the parameter `use_sim_time` stays false.
    ///
    /// # Errors
    /// When the thread cannot be started.
    pub fn start(core: &Core, sim_time: Option<SimTime>) -> io::Result<Self> {
        let modules = core.modules().into_iter().map(|module| module.name.to_string());
        let settings = modules.filter_map(|name| core.settings(&name).map(|infos| (name, infos))).collect();
        let (core, thread) = (core.handle(), ParameterThread::start()?);
        Ok(Self { shared: Arc::new(Shared { core, sim_time, settings, thread }) })
    }

    /// Offers the parameters of a node: those that every node has, and settings of modules, also of modules that are added
    /// later. All nodes of a program share one time, and so the value of `use_sim_time`.
    ///
    /// # Errors
    /// [`NodeError`] when a service or the publisher of events cannot be created.
    pub fn serve(&self, node: &Node, exposure: ParameterExposure) -> Result<ParameterServices, NodeError> {
        let Shared { core, sim_time, settings, thread } = &*self.shared;
        let parameters = Parameters::new(core.clone(), sim_time.clone(), node, exposure, settings)?;
        let parameters = Arc::new(Mutex::new(parameters));
        let server = Server { node, parameters: &parameters, jobs: thread.jobs() };
        let services = [
            server.serve::<GetParameters>("~/get_parameters", Parameters::get)?,
            server.serve::<GetParameterTypes>("~/get_parameter_types", Parameters::types)?,
            server.serve::<SetParameters>("~/set_parameters", Parameters::set)?,
            server.serve::<SetParametersAtomically>(
                "~/set_parameters_atomically",
                Parameters::set_atomically,
            )?,
            server.serve::<DescribeParameters>("~/describe_parameters", Parameters::describe)?,
            server.serve::<ListParameters>("~/list_parameters", Parameters::list)?,
        ];
        thread.watch(&parameters);
        Ok(ParameterServices { _services: services, _parameters: parameters, _server: self.clone() })
    }
}

struct Server<'a> {
    node: &'a Node,
    parameters: &'a Arc<Mutex<Parameters>>,
    jobs: Jobs,
}

impl Server<'_> {
    fn serve<S: downbeat_msgs::Service>(
        &self,
        service: &'static str,
        answer: fn(&mut Parameters, S::Request) -> S::Response,
    ) -> Result<Service, NodeError> {
        let (parameters, jobs) = (Arc::downgrade(self.parameters), self.jobs.clone());
        let unanswered = Arc::new(Limiter::default());
        self.node.serve_later::<S>(service, QosProfile::PARAMETERS, move |request, reply| {
            let (parameters, limiter) = (parameters.clone(), Arc::clone(&unanswered));
            let job = move || {
                let Some(parameters) = parameters.upgrade() else { return };
                let answer = answer(&mut lock(&parameters), request);
                if let Err(error) = reply.send(&answer)
                    && let Some(left_out) = limiter.allow()
                {
                    tracing::warn!(service, "a request is not answered: {error}{left_out}");
                }
            };
            if !jobs.push(Box::new(job))
                && let Some(left_out) = unanswered.allow()
            {
                tracing::warn!(service, "a request is not answered: too many others wait{left_out}");
            }
        })
    }
}
