//! An RTPS engine for ROS 2: a sans-IO protocol core and a small driver for UDP.

pub mod protocol;
pub mod qos;
pub mod wire;
