//! The controllers and the hardware of a robot file, as `/controller_manager` lists them.

use std::any::TypeId;
use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroUsize;

use downbeat_bridge::controller_manager::{Controller, Hardware, Joints};
use downbeat_executor::{Core, GraphEdge, Inbox, Outlet, OutletInbox, Received, SettingValue, SetupError};
use downbeat_msgs::sensor_msgs::msg::JointState;

use super::Robot;
use super::file::ModuleEntry;

/// What `/controller_manager` shows of a robot.
pub(crate) struct Controllers {
    pub(crate) controllers: Vec<Controller>,
    pub(crate) hardware: Vec<Hardware>,
    /// Messages from which the hardware's joints are learned.
    pub(crate) outlets: Vec<Outlet>,
    /// The topics of what the hardware measures.
    pub(crate) measured: Vec<String>,
}

/// The kind whose joints other controllers may command.
const CHAINABLE: &str = "forward_command";

/// The classes of ros2_control that do what our kinds do.
fn class_of(kind: &str) -> String {
    match kind {
        "diff_drive" => "diff_drive_controller/DiffDriveController".to_owned(),
        CHAINABLE => "forward_command_controller/ForwardCommandController".to_owned(),
        "joint_trajectory" => "joint_trajectory_controller/JointTrajectoryController".to_owned(),
        own => format!("downbeat/{own}"),
    }
}

impl Robot {
    /// The controllers are the modules that claim joints, and one for the measurements of the hardware, as
    /// the `joint_state_broadcaster` of ros2_control; the hardware are those that drive devices with joints.
    pub(crate) fn controllers(&mut self) -> Result<Controllers, SetupError> {
        let published = topics_of(&self.core, |edge| match edge {
            GraphEdge::Publishes { module, topic } => Some((*module, *topic)),
            _ => None,
        });
        let received = topics_of(&self.core, |edge| match edge {
            GraphEdge::Subscribes { module, topic } => Some((*module, *topic)),
            _ => None,
        });
        let entries = || self.file.modules.iter().filter(|entry| entry.kind.claims_joints());
        // A reference is received on the topic on which others publish their commands.
        let chainable = entries().filter(|entry| entry.kind.name() == CHAINABLE);
        let references: BTreeMap<&String, &ModuleEntry> = chainable
            .flat_map(|entry| {
                received.get(&entry.name).into_iter().flatten().map(move |topic| (topic, entry))
            })
            .collect();
        let mut controllers = Vec::new();
        for entry in entries() {
            let interfaces = self.commands_of(entry);
            let below =
                published.get(&entry.name).into_iter().flatten().find_map(|topic| references.get(topic));
            let commands = interfaces.iter().map(|interface| match below {
                Some(below) => format!("{}/{interface}", below.name),
                None => interface.clone(),
            });
            controllers.push(Controller {
                name: entry.name.clone(),
                module: entry.name.clone(),
                type_name: class_of(entry.kind.name()),
                update_rate_hz: self.rate_of(&entry.name),
                commands: commands.collect(),
                states: states_of(entry, &interfaces),
                references: match entry.kind.name() {
                    CHAINABLE => {
                        interfaces.iter().map(|interface| format!("{}/{interface}", entry.name)).collect()
                    }
                    _ => Vec::new(),
                },
            });
        }
        let drives = |entry: &&ModuleEntry| entry.kind.uses_device() && !entry.kind.is_emulated();
        let hardware_of = |entry: &ModuleEntry| {
            let measured = published.get(&entry.name)?.iter().next()?;
            Some((entry.name.clone(), format!("downbeat/{}", entry.kind.name()), measured.clone()))
        };
        let found: Vec<_> = self.file.modules.iter().filter(drives).filter_map(hardware_of).collect();
        let (mut hardware, mut outlets, mut topics) = (Vec::new(), Vec::new(), Vec::new());
        let inbox = OutletInbox::new("controller_manager", Inbox::KeepLast(NonZeroUsize::MIN));
        for (module, plugin, measured) in found {
            let joints = Joints::default();
            let (learned, mut is_known) = (joints.clone(), false);
            outlets.push(self.core.outlet(&measured, &inbox, move |message: Received<'_, JointState>| {
                if !std::mem::replace(&mut is_known, true) {
                    learned.learn(&message);
                }
            })?);
            // The name under which spawners and MoveIt look for whoever publishes `joint_states`.
            let broadcaster = match hardware.is_empty() {
                true => "joint_state_broadcaster".to_owned(),
                false => format!("{module}_joint_state_broadcaster"),
            };
            controllers.push(Controller {
                name: broadcaster,
                module: module.clone(),
                type_name: "joint_state_broadcaster/JointStateBroadcaster".to_owned(),
                ..Controller::default()
            });
            let rate_hz = self.rate_of(&module);
            hardware.push(Hardware { module, plugin, rate_hz, joints });
            topics.push(measured);
        }
        Ok(Controllers { controllers, hardware, outlets, measured: topics })
    }

    /// The interfaces that a controller commands, `<joint>/position`.
    fn commands_of(&self, entry: &ModuleEntry) -> Vec<String> {
        let settings = self.core.settings(&entry.name).unwrap_or_default();
        let value =
            |name: &str| settings.iter().find(|setting| setting.name == name).map(|setting| &setting.value);
        let names = |name: &str| match value(name) {
            Some(SettingValue::Texts(names)) => names.clone(),
            _ => Vec::new(),
        };
        let interface = match value("interface_name") {
            Some(SettingValue::Text(name)) => name.as_str(),
            _ if entry.kind.name() == "diff_drive" => "velocity",
            _ => "position",
        };
        let joints = ["joints", "left_wheel_names", "right_wheel_names"].into_iter().flat_map(names);
        joints.map(|joint| format!("{joint}/{interface}")).collect()
    }

    /// Its setting `rate_hz`, or 0.
    fn rate_of(&self, module: &str) -> u16 {
        let settings = self.core.settings(module).unwrap_or_default();
        let rate =
            settings.into_iter().find(|setting| setting.name == "rate_hz").map(|setting| setting.value);
        match rate {
            Some(SettingValue::Double(rate)) if (1.0..=f64::from(u16::MAX)).contains(&rate) => {
                rate.round() as u16
            }
            _ => 0,
        }
    }
}

/// By module, its topics with joints.
fn topics_of(
    core: &Core,
    is_one: impl Fn(&GraphEdge) -> Option<(usize, usize)>,
) -> BTreeMap<String, BTreeSet<String>> {
    let graph = core.graph();
    let of_joints: BTreeSet<String> = core
        .topics()
        .filter(|topic| topic.message_type_id == TypeId::of::<JointState>())
        .map(|topic| topic.name.to_string())
        .collect();
    let mut topics = BTreeMap::<String, BTreeSet<String>>::new();
    for (module, topic) in graph.edges.iter().filter_map(is_one) {
        if let (Some(module), Some(topic)) = (graph.modules.get(module), graph.topics.get(topic))
            && of_joints.contains(&topic.name)
        {
            topics.entry(module.name.clone()).or_default().insert(topic.name.clone());
        }
    }
    topics
}

/// What a controller reads: position and velocity to follow a trajectory, what its wheels do for odometry.
fn states_of(entry: &ModuleEntry, commands: &[String]) -> Vec<String> {
    let joints = commands.iter().filter_map(|command| Some(command.rsplit_once('/')?.0));
    match entry.kind.name() {
        "joint_trajectory" => joints
            .flat_map(|joint| ["position", "velocity"].map(|state| format!("{joint}/{state}")))
            .collect(),
        "diff_drive" => joints.map(|joint| format!("{joint}/position")).collect(),
        _ => Vec::new(),
    }
}
