//! Topics of the executor shown to ROS 2, and topics of ROS 2 taken in.
//!
//! ```
//! use downbeat_bridge::edge::Interfaces;
//! use downbeat_bridge::expose::{Exposure, expose};
//! use downbeat_bridge::middleware::{Direction, in_process::Hub};
//! use downbeat_bridge::ros::{NodeName, Participant};
//! use downbeat_executor::Core;
//! use downbeat_msgs::qos::QosProfile;
//!
//! let participant = Participant::on(std::sync::Arc::new(Hub::new().join()))?;
//! let node = participant.create_node(NodeName::new("/", "downbeat")?)?;
//! let mut core = Core::new();
//! let joint_state = Interfaces::carried().message("sensor_msgs/msg/JointState")?;
//! let states = Exposure {
//!     qos: QosProfile::SENSOR_DATA.into(),
//!     ..Exposure::new("joint_states", joint_state, Direction::Out)
//! };
//! let status = expose(&mut core, &node, &[states])?;
//! assert_eq!(status.endpoints()[0].endpoint.ros_topic, "/joint_states");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod actions;
mod bridge;
mod conflict;
mod endpoint;
mod endpoints;
mod exposure;
mod network_nodes;
mod open_requests;
mod parameters;
mod pattern;
mod qos_events;
mod services;

pub use actions::ActionExposure;
pub use bridge::{Bridge, expose};
pub use endpoint::ExposedEndpoint;
pub use endpoints::{BridgeStatus, EndpointReport, EndpointTraffic};
pub use exposure::{ExposeError, Exposure, Limits, OfACycle};
pub use network_nodes::NetworkNodes;
pub use parameters::{ParameterExposure, ParameterServer, ParameterServices, parameter_value, setting_value};
pub use pattern::{PatternError, TopicPattern};
pub use qos_events::{QOS_EVENTS_TOPIC, QosCounts};
pub use services::{
    CALLS_MODULE_NAME, ExposedServices, OfferedService, SERVICES_MODULE_NAME, ServiceExposure,
    ServiceIntrospection, ServiceReport, ServicesStatus, expose_services, expose_services_with,
};
