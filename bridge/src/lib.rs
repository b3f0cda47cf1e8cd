//! The ROS 2 bridge of downbeat.

pub mod middleware;
pub mod ros;
