//! ROS 2 interfaces as Rust types.

pub mod qos;
