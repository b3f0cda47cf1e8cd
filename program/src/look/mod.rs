//! Commands that inspect the ROS 2 network: `topic`, `node`, `service`, `param`, `action` and `lifecycle`,
//! with the options and output of `ros2`, on a machine without ROS.
//!
//! # References
//! The packages `ros2topic`, `ros2node`, `ros2service`, `ros2param`, `ros2action` and `ros2lifecycle` of
//! ros2/ros2cli, branch jazzy.

mod action;
mod clock;
mod definitions;
mod echo;
mod lifecycle;
mod network;
mod node;
mod param;
mod publish;
mod qos;
mod rate;
mod service;
mod topic;
mod topic_type;
mod values;

pub(crate) use action::{ActionCommand, action};
pub(crate) use lifecycle::{LifecycleCommand, lifecycle};
pub(super) use network::{Environment, Look, Patience};
pub(crate) use node::{NodeCommand, node};
pub(crate) use param::{ParamCommand, param};
pub(crate) use service::{ServiceCommand, service};
pub(crate) use topic::{TopicCommand, topic};
