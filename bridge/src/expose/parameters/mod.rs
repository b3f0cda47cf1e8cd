//! Parameters of nodes, with the six services that parameter clients call and the events they listen to: what
//! every node of rclcpp declares, and settings of modules as `<module>.<setting>`.
//!
//! Answers are those of rclcpp (`rclcpp/src/rclcpp/parameter_service.cpp` and
//! `node_interfaces/node_parameters.cpp`, branch jazzy), but for three things: a whole number is accepted for
//! a double, atomic changes of several modules are taken back when one is refused rather than made at once,
//! and a value that changes otherwise than through these services is published within a second.

mod own;
mod store;

pub use crate::edge::{parameter_value, setting_value};

use super::TopicPattern;
use crate::clock::SimTime;
use crate::ros::{MessageType, Node, NodeError, Publisher, Reply, Service};
use crate::worker::{Mailbox, WorkerLink};
use downbeat_executor::{Core, CoreHandle, SettingInfo};
use downbeat_msgs::Message;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rcl_interfaces::msg::ParameterEvent;
use downbeat_msgs::rcl_interfaces::srv::{
    DescribeParameters, DescribeParametersRequest, GetParameterTypes, GetParameterTypesRequest,
    GetParameters, GetParametersRequest, ListParameters, ListParametersRequest, SetParameters,
    SetParametersAtomically, SetParametersAtomicallyRequest, SetParametersRequest,
};
use std::sync::Arc;
use std::time::Duration;
use store::Parameters;

/// Which settings of modules are parameters of a node.
#[derive(Clone, Debug, Default)]
pub struct ParameterExposure {
    /// Names `<module>.<setting>`, or patterns for them in which `*` stands for any characters.
    pub settings: Vec<TopicPattern>,
    /// Of a node that stands for one module: that module, whose settings alone the node has, without its name
    /// before them.
    pub of_module: Option<String>,
}

/// Gives the nodes of a core their parameters.
///
/// The core takes until its next sync phase to say whether a value is accepted. While it does not answer, the
/// values last known are returned.
///
/// ```
/// use downbeat_bridge::expose::{ParameterExposure, ParameterServer};
/// use downbeat_bridge::middleware::in_process::Hub;
/// use downbeat_bridge::ros::{NodeName, Participant};
/// use downbeat_executor::Core;
///
/// let participant = Participant::on(std::sync::Arc::new(Hub::new().join()))?;
/// let node = participant.create_node(NodeName::new("/", "robot")?)?;
/// let server = ParameterServer::new(&Core::new(), None);
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
    /// The settings of all modules when the server was created.
    settings: Vec<(String, Vec<SettingInfo>)>,
}

/// The parameters of a node. Dropping it removes them.
pub struct ParameterServices {
    _services: [Service; 6],
    requests: Mailbox<Request>,
    /// `None` once it is dropped.
    node: Option<Arc<NodeSide>>,
    worker: WorkerLink,
}

impl Drop for ParameterServices {
    fn drop(&mut self) {
        self.requests.close();
        self.node = None;
        // The worker has none either after this, so that the node may disappear.
        self.worker.flush();
    }
}

/// What the parameters use of their node. The task that answers holds it only while it does not wait.
struct NodeSide {
    events: Publisher,
    sim_time: Option<SimTime>,
}

/// How many requests wait; more are not answered.
const QUEUE: usize = 256;

/// How often values are compared that others may have changed.
const LOOK: Duration = Duration::from_secs(1);

/// A request of a parameter client.
enum Request {
    Get(GetParametersRequest, Reply<GetParameters>),
    Types(GetParameterTypesRequest, Reply<GetParameterTypes>),
    Set(SetParametersRequest, Reply<SetParameters>),
    SetAtomically(SetParametersAtomicallyRequest, Reply<SetParametersAtomically>),
    Describe(DescribeParametersRequest, Reply<DescribeParameters>),
    List(ListParametersRequest, Reply<ListParameters>),
}

impl ParameterServer {
    /// Gives nodes the settings of this core. Without a `sim_time` the parameter `use_sim_time` stays false.
    #[must_use]
    pub fn new(core: &Core, sim_time: Option<SimTime>) -> Self {
        let modules = core.modules().into_iter().map(|module| module.name.to_string());
        let settings = modules.filter_map(|name| core.settings(&name).map(|infos| (name, infos))).collect();
        Self { shared: Arc::new(Shared { core: core.handle(), sim_time, settings }) }
    }

    /// Offers the parameters of a node: those that every node has, and settings of modules, also of modules
    /// that are added later. All nodes of a program share one time, and so the value of `use_sim_time`.
    ///
    /// # Errors
    /// [`NodeError`] when a service or the publisher of events cannot be created.
    pub fn serve(&self, node: &Node, exposure: ParameterExposure) -> Result<ParameterServices, NodeError> {
        let Shared { core, sim_time, settings } = &*self.shared;
        let event_type = MessageType::new(ParameterEvent::TYPE_NAME)?;
        let events = node.publish("/parameter_events", &event_type, QosProfile::PARAMETER_EVENTS)?;
        let side = Arc::new(NodeSide { events, sim_time: sim_time.clone() });
        let worker = node.worker();
        let name = node.name().to_string();
        let mut parameters =
            Parameters::new(core.clone(), worker.clone(), name, Arc::downgrade(&side), exposure, settings);
        let requests = Mailbox::new(QUEUE);
        let qos = QosProfile::PARAMETERS;
        let services = [
            node.serve_into("~/get_parameters", qos, &requests, Request::Get)?,
            node.serve_into("~/get_parameter_types", qos, &requests, Request::Types)?,
            node.serve_into("~/set_parameters", qos, &requests, Request::Set)?,
            node.serve_into("~/set_parameters_atomically", qos, &requests, Request::SetAtomically)?,
            node.serve_into("~/describe_parameters", qos, &requests, Request::Describe)?,
            node.serve_into("~/list_parameters", qos, &requests, Request::List)?,
        ];
        let (incoming, sleeper) = (requests.clone(), worker.clone());
        worker.spawn(async move {
            parameters.announce();
            loop {
                match sleeper.within(LOOK, incoming.next()).await {
                    Some(Some(request)) => parameters.answer(request).await,
                    Some(None) => return,
                    None => parameters.look_for_listeners().await,
                }
            }
        });
        Ok(ParameterServices { _services: services, requests, node: Some(side), worker })
    }
}
