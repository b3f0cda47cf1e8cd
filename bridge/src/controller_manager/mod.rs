//! The controllers and the hardware of a robot as ros2_control shows them: the services of
//! `controller_manager_msgs`, for `ros2 control`, spawners and MoveIt.
//!
//! Controllers and hardware are modules; their states are those of their lifecycle. All controllers of a
//! robot are compiled in and loaded at the start. An unloaded controller is unconfigured, and no list names
//! it until it is loaded again.
//!
//! # References
//! ros2_control, branch jazzy: `controller_manager_msgs`, `controller_manager/src/controller_manager.cpp`,
//! `controller_manager/doc/userdoc.rst`.

mod joint_states;
mod manager;
mod switch;

pub use joint_states::DynamicJointStates;

use crate::ros::{MessageType, Node, NodeError, Publisher, Reply, Service};
use crate::worker::Mailbox;
use downbeat_executor::{Core, Listening};
use downbeat_msgs::Message;
use downbeat_msgs::controller_manager_msgs::msg::ControllerManagerActivity;
use downbeat_msgs::controller_manager_msgs::srv::{
    CleanupController, CleanupControllerRequest, ConfigureController, ConfigureControllerRequest,
    ListControllerTypes, ListControllerTypesResponse, ListControllers, ListControllersRequest,
    ListHardwareComponents, ListHardwareComponentsRequest, ListHardwareInterfaces,
    ListHardwareInterfacesRequest, LoadController, LoadControllerRequest, ReloadControllerLibraries,
    ReloadControllerLibrariesRequest, SetHardwareComponentState, SetHardwareComponentStateRequest,
    SwitchController, SwitchControllerRequest, UnloadController, UnloadControllerRequest,
};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::sensor_msgs::msg::JointState;
use manager::Manager;
use parking_lot::Mutex;
use std::sync::Arc;

/// A controller.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Controller {
    /// Its name.
    pub name: String,
    /// The module whose state it has: that of the same name, except for what a hardware module does itself.
    pub module: String,
    /// Its class as in ros2_control, such as `joint_trajectory_controller/JointTrajectoryController`.
    pub type_name: String,
    /// In Hz; 0 if it runs when it has something to do.
    pub update_rate_hz: u16,
    /// The interfaces that it commands, `<joint>/position`; those of a controller below it with its name in
    /// front.
    pub commands: Vec<String>,
    /// The interfaces that it reads.
    pub states: Vec<String>,
    /// The references that other controllers may command, `<controller>/<joint>/position`.
    pub references: Vec<String>,
}

/// A module that drives a device with joints.
#[derive(Clone, Debug)]
pub struct Hardware {
    /// The module.
    pub module: String,
    /// What drives it.
    pub plugin: String,
    /// In Hz; 0 if it is not known.
    pub rate_hz: u16,
    /// Its joints, once they are known.
    pub joints: Joints,
}

/// The joints of a hardware module, which its first message names. Clones share them.
#[derive(Clone, Debug, Default)]
pub struct Joints(Arc<Mutex<Vec<Joint>>>);

/// A joint of a hardware module.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Joint {
    /// Its name.
    pub name: String,
    /// What the hardware measures of it: `position`, `velocity`, `effort`.
    pub states: Vec<&'static str>,
}

/// What a message measures, with the names of the interfaces.
fn measured_of(state: &JointState) -> [(&'static str, &[f64]); 3] {
    [("position", &state.position), ("velocity", &state.velocity), ("effort", &state.effort)]
}

impl Joints {
    /// Takes the joints of a message, with what it measures of them.
    pub fn learn(&self, state: &JointState) {
        let joint = |(index, name): (usize, &String)| Joint {
            name: name.clone(),
            states: measured_of(state)
                .iter()
                .filter(|(_, values)| index < values.len())
                .map(|(name, _)| *name)
                .collect(),
        };
        *self.0.lock() = state.name.iter().enumerate().map(joint).collect();
    }

    fn get(&self) -> Vec<Joint> {
        self.0.lock().clone()
    }
}

/// The services, until they are dropped.
pub struct ControllerManager {
    _services: Vec<Service>,
    /// Publishes the activity after each transition of a module.
    _listening: Listening,
    requests: Mailbox<Request>,
}

/// How many requests wait; more are refused.
const QUEUE: usize = 64;

/// What is asked of the manager, which answers one after the other, as ros2_control does.
enum Request {
    ListControllers(ListControllersRequest, Reply<ListControllers>),
    ListHardware(ListHardwareComponentsRequest, Reply<ListHardwareComponents>),
    ListInterfaces(ListHardwareInterfacesRequest, Reply<ListHardwareInterfaces>),
    Load(LoadControllerRequest, Reply<LoadController>),
    Unload(UnloadControllerRequest, Reply<UnloadController>),
    Configure(ConfigureControllerRequest, Reply<ConfigureController>),
    Cleanup(CleanupControllerRequest, Reply<CleanupController>),
    Switch(SwitchControllerRequest, Reply<SwitchController>),
    SetHardware(SetHardwareComponentStateRequest, Reply<SetHardwareComponentState>),
    Reload(ReloadControllerLibrariesRequest, Reply<ReloadControllerLibraries>),
    /// A module has made a transition.
    Publish,
}

impl ControllerManager {
    /// Serves them from a node, which usually has the name `controller_manager`.
    ///
    /// # Errors
    /// [`NodeError`] if an endpoint cannot be created.
    pub fn serve(
        core: &Core,
        node: &Node,
        controllers: Vec<Controller>,
        hardware: Vec<Hardware>,
    ) -> Result<Self, NodeError> {
        let requests = Mailbox::new(QUEUE);
        let activity: Publisher = node.publish(
            "~/activity",
            &MessageType::new(ControllerManagerActivity::TYPE_NAME)?,
            QosProfile::LATCHED,
        )?;
        let mut types: Vec<String> =
            controllers.iter().map(|controller| controller.type_name.clone()).collect();
        types.sort();
        types.dedup();
        let services = serve(node, &requests, types)?;
        let (worker, mailbox) = (node.worker(), requests.clone());
        let mut manager = Manager::new(core.handle(), worker.clone(), controllers, hardware, activity);
        worker.spawn(async move {
            manager.publish().await;
            while let Some(request) = mailbox.next().await {
                manager.answer(request).await;
            }
        });
        let told = requests.clone();
        let listening = core.handle().on_transition(move |_| {
            // The queue is full of requests, each of which publishes as well.
            let _ = told.push(Request::Publish);
        });
        Ok(Self { _services: services, _listening: listening, requests })
    }
}

impl Drop for ControllerManager {
    fn drop(&mut self) {
        self.requests.close();
    }
}

fn serve(node: &Node, requests: &Mailbox<Request>, types: Vec<String>) -> Result<Vec<Service>, NodeError> {
    let list_types = move |_| {
        let base = |name: &String| match name.starts_with("forward_command_controller/") {
            true => "controller_interface::ChainableControllerInterface".to_owned(),
            false => "controller_interface::ControllerInterface".to_owned(),
        };
        let base_classes = types.iter().map(base).collect();
        ListControllerTypesResponse { types: types.clone(), base_classes }
    };
    let qos = QosProfile::SERVICES;
    Ok(vec![
        node.serve::<ListControllerTypes>("~/list_controller_types", qos, list_types)?,
        node.serve_into("~/list_controllers", qos, requests, Request::ListControllers)?,
        node.serve_into("~/list_hardware_components", qos, requests, Request::ListHardware)?,
        node.serve_into("~/list_hardware_interfaces", qos, requests, Request::ListInterfaces)?,
        node.serve_into("~/load_controller", qos, requests, Request::Load)?,
        node.serve_into("~/unload_controller", qos, requests, Request::Unload)?,
        node.serve_into("~/configure_controller", qos, requests, Request::Configure)?,
        node.serve_into("~/cleanup_controller", qos, requests, Request::Cleanup)?,
        node.serve_into("~/switch_controller", qos, requests, Request::Switch)?,
        node.serve_into("~/set_hardware_component_state", qos, requests, Request::SetHardware)?,
        node.serve_into("~/reload_controller_libraries", qos, requests, Request::Reload)?,
    ])
}
