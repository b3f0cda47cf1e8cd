//! `/rosout`: what a program logs through `tracing`, for `rqt_console` and `ros2 topic echo /rosout`.
//!
//! [`Rosout`] collects lines from any thread without blocking it, and publishes them on the worker of the
//! participant once there is a node. Loggers are named as rclcpp names them: the node `robot.downbeat`, and
//! for what a module logs `robot.downbeat.module`. [`LoggerLevels`] holds the levels that tools give to
//! loggers while the program runs, and offers the services by which they do.
//!
//! ```
//! use downbeat_bridge::middleware::in_process::Hub;
//! use downbeat_bridge::ros::{NodeName, Participant};
//! use downbeat_bridge::rosout::Rosout;
//! use tracing_subscriber::prelude::*;
//!
//! let rosout = Rosout::new();
//! let _guard = tracing_subscriber::registry().with(rosout.layer()).set_default();
//! tracing::info!(joint = "head_pan", "calibrated"); // Waits for the node, and is published first.
//!
//! let participant = Participant::on(std::sync::Arc::new(Hub::new().join()))?;
//! let node = participant.create_node(NodeName::new("/robot", "downbeat")?)?;
//! let publishing = rosout.publish(&node)?;
//! drop(publishing); // Sends what was logged until now.
//! assert_eq!(rosout.status().published, 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod collector;
mod levels;
mod line;
mod names;
mod of_modules;
mod of_node;
mod publisher;
mod services;
mod severity;

pub use collector::{Rosout, RosoutLayer, RosoutStatus};
pub use levels::{LoggerLevels, TooManyLoggers};
pub use line::{LogLine, logger_name};
pub use names::LoggerNames;
pub use of_node::RosoutOfNode;
pub use publisher::{RosoutError, RosoutPublisher, TOPIC};
pub use services::LoggerServices;
pub use severity::Severity;
