//! An RTPS engine for ROS 2: a sans-IO protocol core and a small driver for UDP.

#[allow(dead_code, unused_imports)] // until the handles are there
mod driver;
pub mod protocol;
pub mod qos;
pub mod wire;
