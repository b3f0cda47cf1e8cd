//! Sensors of small robots, as modules on the public device trait.
//!
//! - [`lidar`]: laser scanners on a serial port;
//! - [`gps`]: receivers that speak NMEA 0183;
//! - [`imu`]: inertial sensors on I²C;
//! - [`camera`]: cameras that Linux has as video devices;
//! - [`joystick`]: joysticks and gamepads, and driving with them;
//! - [`can`]: CAN buses;
//! - [`gpio`]: lines of GPIO chips;
//! - [`serial`]: the serial port behind lidars and GPS receivers, and emulated devices on it.
//!
//! Everything that a module learns from its device is recorded as [`Device`](downbeat_device::Device)
//! exchanges, so that a replay repeats a run byte for byte without the device. Each device has an emulator.
//! No module was ever tried on hardware: docs/sensors.md says what was tested instead.

#[macro_use]
mod lifecycle;

pub mod camera;
pub mod can;
mod diagnostics;
mod exchange;
pub mod gpio;
pub mod gps;
pub mod imu;
pub mod joystick;
mod kernel;
mod kinds;
pub mod lidar;
mod memory;
pub mod serial;

pub use kinds::kinds;

downbeat_msgs::interfaces! {
    /// The messages of this package, and those that it shares with nodes of ROS 2.
    pub INTERFACES: can::Frame, gpio::Edge
}
