//! The node of a running robot.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::sync::Arc;

use downbeat_bridge::clock::{self, NodeClock, SimTime};
use downbeat_bridge::controller_manager::{ControllerManager, DynamicJointStates};
use downbeat_bridge::diagnostics::ProcessDiagnostics;
use downbeat_bridge::expose::{
    Bridge, EndpointReport, ExposedServices, NetworkNodes, ParameterExposure, ParameterServer,
    ParameterServices, ServiceReport,
};
use downbeat_bridge::lifecycle::{LifecycleExposure, LifecycleNodes, expose_lifecycle};
use downbeat_bridge::middleware::{self, Direction, Middleware, MiddlewareError, ParticipantOptions};
use downbeat_bridge::network::NetworkWatch;
use downbeat_bridge::ros::{Furnishing, Node, NodeError, Participant};
use downbeat_bridge::rosout::{LoggerLevels, LoggerNames, LoggerServices, Rosout, RosoutPublisher};
use downbeat_executor::{Inbox, Outlet, OutletInbox, Received};
use downbeat_msgs::sensor_msgs::msg::JointState;

use super::{LogTail, StartError};
use crate::controllers::Controllers;
use crate::inspect::{ClaimError, NodeClaim, SocketDirectory};
use crate::{ClockChoice, NetworkEntry, Robot, RobotFile};

/// The log of a program, as the node of a robot needs it.
#[derive(Clone)]
pub struct NodeLog {
    /// The lines for `/rosout`.
    pub rosout: Rosout,
    /// The levels of loggers, which `ros2 service call` may change.
    pub levels: LoggerLevels,
    /// The names of loggers.
    pub names: LoggerNames,
    /// The last lines, for the page.
    pub tail: LogTail,
}

/// The node of a running robot with all that belongs to it. ROS 2 sees it until it is dropped.
pub struct RobotNode {
    // Fields drop in this order.
    bridge: Bridge,
    services: ExposedServices,
    _sim_time: Option<SimTime>,
    /// Dropped before the node, so that the last lines are sent.
    _rosout: Option<RosoutPublisher>,
    _logger_services: Option<LoggerServices>,
    /// Of the node in each network that has them.
    _parameters: Vec<ParameterServices>,
    _lifecycle: LifecycleNodes,
    _controllers: Option<ControllersNode>,
    _network: Option<NetworkWatch>,
    _furnishing: Furnishing,
    node: Node,
    domain: u16,
    /// Released after the node.
    _claim: Option<NodeClaim>,
}

impl RobotNode {
    /// Creates the node with all that the robot file exposes.
    pub(super) fn start(
        robot: &mut Robot,
        clock: &NodeClock,
        diagnostics: Option<&ProcessDiagnostics>,
        options: &ParticipantOptions,
        log: Option<&NodeLog>,
    ) -> Result<Self, StartError> {
        let claim = claim(&robot.file, options.domain_id)?;
        let node = Self::on(robot, clock, diagnostics, options, log, &mut middleware::join)?;
        Ok(Self { _claim: claim, ..node })
    }

    /// Creates the node in the networks that `join` joins, that of `[expose]` first.
    pub(super) fn on(
        robot: &mut Robot,
        clock: &NodeClock,
        diagnostics: Option<&ProcessDiagnostics>,
        options: &ParticipantOptions,
        log: Option<&NodeLog>,
        join: Join<'_>,
    ) -> Result<Self, StartError> {
        let exposed = robot.exposed()?;
        let features = robot.file.expose.features.clone();
        let own_options =
            ParticipantOptions { engine: features.engine.unwrap_or(options.engine), ..options.clone() };
        let participant = participant(&robot.file, &own_options, join)?;
        let node = participant.create_node(robot.file.given_node_name()?)?;
        if let Some(log) = log {
            log.names.set_node(node.name());
        }
        let networks = join_networks(&robot.file, options, own_options, join)?;
        let in_networks = |has: fn(&NetworkEntry) -> bool| -> Vec<&Node> {
            let meant = robot.file.networks.iter().filter(|network| has(network));
            meant.filter_map(|network| networks.get(&network.name)).collect()
        };
        let rosout = log.map(|log| &log.rosout).filter(|_| !robot.file.is_rosout_disabled);
        let own_rosout = rosout.filter(|_| features.rosout);
        let mut with_rosout = in_networks(|network| network.rosout);
        if own_rosout.is_some() {
            with_rosout.insert(0, &node);
        }
        let rosout_publisher = match (rosout, with_rosout.split_first()) {
            (Some(rosout), Some((first, further))) => Some(rosout.publish_between(first, further)?),
            _ => None,
        };
        if let (None, Some(log)) = (&rosout_publisher, log) {
            log.rosout.turn_off();
        }
        let levels = log.filter(|_| features.logger_service).map(|log| &log.levels);
        let logger_services = levels.map(|levels| levels.serve(&node)).transpose()?;
        if let ClockChoice::Publish(period) = features.clock {
            clock::publish(&mut robot.core, &node, period)?;
        }
        let network = features.network.then(|| NetworkWatch::start(&mut robot.core, &participant));
        let network = network.transpose()?;
        let sim_time = sim_time(robot, clock, &node)?;
        let parameters = ParameterServer::new(&robot.core, sim_time.clone());
        let with_parameters = std::iter::once(&node).chain(in_networks(|network| network.parameters));
        let exposure = robot.parameter_exposure()?;
        let of_robot = with_parameters.map(|node| parameters.serve(node, exposure.clone()));
        let of_robot = of_robot.collect::<Result<_, _>>()?;
        let furnishing = furnish(robot, &participant, parameters, own_rosout.cloned())?;
        let managed = robot.lifecycle_exposures()?;
        let lifecycle = expose_lifecycle(&robot.core, &participant, &managed)?;
        for (LifecycleExposure { module, .. }, node) in managed.iter().zip(lifecycle.nodes()) {
            if let Some(log) = log {
                log.names.set_module(module, node.name());
            }
            tracing::info!("exposed lifecycle: {}", node.name());
        }
        let controllers = features.controller_manager.then(|| ControllersNode::start(robot, &participant));
        let controllers = controllers.transpose()?;
        let nodes = NetworkNodes::new(node.clone(), networks);
        let bridge = Bridge::start(&mut robot.core, nodes.clone(), &exposed.topics)?;
        if let Some(diagnostics) = diagnostics {
            diagnostics.watch_endpoints(bridge.status());
            if let Some(security) = participant.security() {
                diagnostics.watch_security(&node.name().to_string(), security);
            }
        }
        for EndpointReport { endpoint, .. } in bridge.status().endpoints() {
            let arrow = match endpoint.direction {
                Direction::Out => "to ROS 2",
                Direction::In => "from ROS 2",
            };
            let network = on(endpoint.network);
            tracing::info!("exposed {arrow}{network}: {} [{}]", endpoint.ros_topic, endpoint.type_name);
        }
        let introspection = robot.file.expose.introspection;
        let services =
            ExposedServices::start(&mut robot.core, nodes, &exposed.services, &exposed.calls, introspection)?;
        if let Some(diagnostics) = diagnostics {
            diagnostics.watch_services(services.status());
        }
        for ServiceReport { service, network, .. } in services.status().services() {
            tracing::info!("exposed service{}: {service}", on(network));
        }
        Ok(Self {
            bridge,
            services,
            _sim_time: sim_time,
            _rosout: rosout_publisher,
            _logger_services: logger_services,
            _parameters: of_robot,
            _lifecycle: lifecycle,
            _controllers: controllers,
            _network: network,
            _furnishing: furnishing,
            node,
            domain: options.domain_id,
            _claim: None,
        })
    }

    /// The node.
    #[must_use]
    pub fn node(&self) -> &Node {
        &self.node
    }

    /// The bridge, which can change what is exposed while the robot runs.
    #[must_use]
    pub fn bridge(&self) -> &Bridge {
        &self.bridge
    }

    pub(super) fn services(&self) -> &ExposedServices {
        &self.services
    }

    /// The ROS domain.
    #[must_use]
    pub fn domain(&self) -> u16 {
        self.domain
    }
}

/// How many states of joints wait for the network.
const WAITING_STATES: NonZeroUsize = NonZeroUsize::MIN.saturating_add(15);

/// The node `controller_manager`.
struct ControllersNode {
    // Fields drop in this order.
    _manager: ControllerManager,
    _outlets: Vec<Outlet>,
    _node: Node,
}

impl ControllersNode {
    fn start(robot: &mut Robot, participant: &Participant) -> Result<Self, StartError> {
        let node = participant.create_node(robot.file.node_beside("controller_manager", 0)?)?;
        let Controllers { controllers, hardware, mut outlets, measured } = robot.controllers()?;
        let inbox = OutletInbox::new("dynamic_joint_states", Inbox::KeepLast(WAITING_STATES));
        for topic in measured {
            let dynamic = DynamicJointStates::beside(&node, &topic)?;
            let publish = move |state: Received<'_, JointState>| dynamic.publish(&state);
            outlets.push(robot.core.outlet(&topic, &inbox, publish)?);
        }
        let manager = ControllerManager::serve(&robot.core, &node, controllers, hardware)?;
        tracing::info!("exposed controllers: {}", node.name());
        Ok(Self { _manager: manager, _outlets: outlets, _node: node })
    }
}

/// The network of an endpoint in a line of the log.
fn on(network: Option<String>) -> String {
    network.map(|name| format!(" on {name}")).unwrap_or_default()
}

/// Joins a network.
pub(super) type Join<'a> =
    &'a mut dyn FnMut(&ParticipantOptions) -> Result<Arc<dyn Middleware>, MiddlewareError>;

fn participant(
    file: &RobotFile,
    options: &ParticipantOptions,
    join: Join<'_>,
) -> Result<Participant, StartError> {
    Ok(Participant::on_with(join(options)?, file.remaps.clone(), file.catalog.interfaces.clone())?)
}

/// Joins the further networks of the file. Returns the robot's node in each, by the name of the network.
fn join_networks(
    file: &RobotFile,
    environment: &ParticipantOptions,
    own: ParticipantOptions,
    join: Join<'_>,
) -> Result<BTreeMap<String, Node>, StartError> {
    let mut joined = vec![own];
    let mut nodes = BTreeMap::new();
    for network in &file.networks {
        let options = network.options(environment);
        if joined.contains(&options) {
            return Err(file.same_network(network).into());
        }
        let participant = participant(file, &options, join)?;
        nodes.insert(network.name.clone(), participant.create_node(file.given_node_name()?)?);
        tracing::info!("joined network {}: {}, domain {}", network.name, options.engine, options.domain_id);
        joined.push(options);
    }
    Ok(nodes)
}

/// Gives the other nodes of the robot file what every node has, parameters and `/rosout`, and those of a
/// module its settings and its log.
fn furnish(
    robot: &Robot,
    participant: &Participant,
    parameters: ParameterServer,
    rosout: Option<Rosout>,
) -> Result<Furnishing, StartError> {
    let settings = robot.parameter_exposure()?.settings;
    let module = |exposure: LifecycleExposure| -> Result<_, StartError> {
        let node = robot.file.remaps.node(&exposure.node).map_err(NodeError::from)?;
        Ok((node, exposure.module))
    };
    let modules = robot.lifecycle_exposures()?.into_iter().map(module);
    let modules: BTreeMap<_, _> = modules.collect::<Result<_, StartError>>()?;
    Ok(participant.furnish(move |node| {
        let module = modules.get(node.name());
        if let Some(rosout) = &rosout {
            node.attach(rosout.publish_also(node, module.map(String::as_str))?);
        }
        let exposure = module.map_or_else(ParameterExposure::default, |module| ParameterExposure {
            settings: settings.clone(),
            of_module: Some(module.clone()),
        });
        node.attach(parameters.serve(node, exposure)?);
        Ok(())
    }))
}

/// Refuses a second robot of the same name, if the directory of robots is readable.
fn claim(file: &RobotFile, domain: u16) -> Result<Option<NodeClaim>, StartError> {
    let node = file.node_name()?.to_string();
    let directory = SocketDirectory::open().map_err(ClaimError::from);
    match directory.and_then(|directory| directory.claim(&file.name, &node, domain)) {
        Ok(claim) => Ok(Some(claim)),
        Err(taken @ ClaimError::Taken { .. }) => Err(taken.into()),
        Err(ClaimError::Directory(error)) => {
            tracing::debug!("whether another robot has the name {node} is not known: {error}");
            Ok(None)
        }
    }
}

/// The switch behind `use_sim_time`; `None` if others follow the time of this robot.
fn sim_time(robot: &Robot, clock: &NodeClock, node: &Node) -> Result<Option<SimTime>, StartError> {
    let choice = robot.file.expose.features.clock;
    if matches!(choice, ClockChoice::Publish(_)) {
        return Ok(None);
    }
    let sim_time = clock.sim_time(node, &robot.core.handle());
    sim_time.set(choice == ClockChoice::Follow)?;
    Ok(Some(sim_time))
}
