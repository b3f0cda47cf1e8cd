//! Topics of the executor shown to ROS 2, and topics of ROS 2 taken in.
//!
//! ```
//! use downbeat_bridge::edge::KnownType;
//! use downbeat_bridge::expose::{Exposure, expose};
//! use downbeat_bridge::middleware::{Direction, in_process::Hub};
//! use downbeat_bridge::ros::{NodeName, Participant};
//! use downbeat_executor::Core;
//! use downbeat_msgs::qos::QosProfile;
//!
//! let participant = Participant::on(std::sync::Arc::new(Hub::new().join()))?;
//! let node = participant.create_node(NodeName::new("/", "downbeat")?)?;
//! let mut core = Core::new();
//! let states = Exposure {
//!     topic: "joint_states".into(),
//!     ros_topic: None,
//!     message_type: KnownType::named("sensor_msgs/msg/JointState")?,
//!     direction: Direction::Out,
//!     qos: QosProfile::DEFAULT,
//! };
//! let status = expose(&mut core, &node, &[states])?;
//! assert_eq!(status.endpoints()[0].ros_topic, "/joint_states");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod module;
mod services;
mod status;

pub use module::{ExposeError, Exposure, MODULE_NAME, expose};
pub use services::{CallExposure, SERVICES_MODULE_NAME, ServiceExposure, ServicesStatus, expose_services};
pub use status::{BridgeStatus, EndpointReport};
