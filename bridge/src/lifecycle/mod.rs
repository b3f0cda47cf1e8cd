//! Modules with a lifecycle as managed nodes of ROS 2, for `ros2 lifecycle` and lifecycle managers.
//!
//! A module has the states of a managed node (<https://design.ros2.org/articles/node_lifecycle.html>). Here
//! it is shown as its own node, with the five services of rclcpp_lifecycle, which change the state of the
//! module, `~/transition_event`, and `bond` for managers that watch their nodes.
//!
//! ```
//! use downbeat_bridge::lifecycle::{LifecycleExposure, expose_lifecycle};
//! use downbeat_bridge::middleware::in_process::Hub;
//! use downbeat_bridge::ros::{NodeName, Participant};
//! use downbeat_executor::{Core, Module, Setup, SetupError};
//!
//! struct Camera;
//!
//! impl Module for Camera {
//!     type Ports = ();
//!
//!     fn setup(&mut self, _: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         Ok(())
//!     }
//! }
//!
//! let participant = Participant::on(std::sync::Arc::new(Hub::new().join()))?;
//! let mut core = Core::new();
//! core.add("camera", Camera)?;
//! let exposure = LifecycleExposure { module: "camera".into(), node: NodeName::new("/robot", "camera")? };
//! let nodes = expose_lifecycle(&core, &participant, &[exposure])?; // Until it is dropped.
//! assert_eq!(nodes.nodes()[0].name().to_string(), "/robot/camera");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod bond;
mod machine;
mod node;

use crate::ros::{Node, NodeError, NodeName, Participant};
use crate::worker::WorkerLink;
use downbeat_executor::{Core, Listening};
use downbeat_msgs::builtin_interfaces::msg::Time;
use node::LifecycleNode;
use std::collections::BTreeMap;
use std::sync::Weak;
use std::time::{SystemTime, UNIX_EPOCH};
use thiserror::Error;

/// A module to show as a managed node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LifecycleExposure {
    /// The module.
    pub module: String,
    /// Its node, before remapping rules apply.
    pub node: NodeName,
}

/// A module could not be shown as a managed node.
#[derive(Debug, Error)]
pub enum LifecycleError {
    /// There is no such module.
    #[error("there is no module \"{0}\" to show with its lifecycle")]
    UnknownModule(String),
    /// Its node, or an endpoint of it, could not be created.
    #[error("showing the lifecycle of module \"{module}\": {error}")]
    Node {
        /// The module.
        module: String,
        /// Why not.
        error: NodeError,
    },
}

/// Managed nodes, until they are dropped.
pub struct LifecycleNodes {
    /// `None` once they are dropped.
    listening: Option<Listening>,
    nodes: Vec<LifecycleNode>,
    worker: WorkerLink,
}

/// Shows modules of a core as managed nodes: a node each.
///
/// # Errors
/// [`LifecycleError`] when there is no such module, or its node cannot be created.
pub fn expose_lifecycle(
    core: &Core,
    participant: &Participant,
    exposures: &[LifecycleExposure],
) -> Result<LifecycleNodes, LifecycleError> {
    let modules = core.modules();
    let worker = participant.worker();
    let mut nodes = Vec::with_capacity(exposures.len());
    for LifecycleExposure { module, node } in exposures {
        let Some(info) = modules.iter().find(|info| *info.name == **module) else {
            return Err(LifecycleError::UnknownModule(module.clone()));
        };
        let failed = |error| LifecycleError::Node { module: module.clone(), error };
        let node = participant.create_node(node.clone()).map_err(failed)?;
        nodes.push(LifecycleNode::new(node, module, info.state, core.handle()).map_err(failed)?);
    }
    let followed: BTreeMap<_, _> =
        nodes.iter().map(|node| (node.module().to_owned(), node.followed())).collect();
    let publishing = worker.clone();
    // Called on the threads of modules, which must not write to DDS.
    let listening = core.handle().on_transition(move |event| {
        if let Some(followed) = followed.get(&*event.module) {
            let (followed, step) = (Weak::clone(followed), event.step);
            publishing.run(move || {
                if let Some(followed) = followed.upgrade() {
                    followed.follow(step);
                }
            });
        }
    });
    Ok(LifecycleNodes { listening: Some(listening), nodes, worker })
}

/// The time of the machine, for the stamps of messages that no module publishes.
pub(crate) fn wall_time() -> Time {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Time::from_nanos(i64::try_from(since_1970.as_nanos()).unwrap_or(i64::MAX))
}

impl LifecycleNodes {
    /// The nodes, in the order of the exposures.
    #[must_use]
    pub fn nodes(&self) -> Vec<&Node> {
        self.nodes.iter().map(LifecycleNode::node).collect()
    }
}

impl Drop for LifecycleNodes {
    fn drop(&mut self) {
        self.listening = None;
        // The last events are published before the nodes are removed.
        self.worker.flush();
    }
}
