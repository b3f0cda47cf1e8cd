//! The ways in which a user installs the program, each tried from nothing to joint states on rclpy.

mod arrival;
mod colcon;
mod crates;
pub(crate) mod deb;
mod registry;

pub(crate) use arrival::{Arrival, Figures, Home, first_look};
pub(crate) use colcon::{ros_workspace, ros_workspace_for_release};
pub(crate) use crates::{cargo_install, cargo_install_for_release, compile_packages};
pub(crate) use deb::debian_package;
