//! Sensors of small robots, as modules on the public device trait.
//!
//! - [`lidar`]: laser scanners on a serial port;
//! - [`gps`]: receivers that speak NMEA 0183;
//! - [`imu`]: inertial sensors on I²C;
//! - [`serial`]: the serial port behind lidars and GPS receivers, and emulated devices on it.
//!
//! Everything that a module learns from its device is recorded as [`Device`](downbeat_modules::device::Device) exchanges, so that a
//! replay repeats a run byte for byte without the device. Each device has an emulator. No module was ever tried on hardware:
//! docs/sensors.md says what was tested instead.

mod diagnostics;
pub mod gps;
pub mod imu;
pub mod lidar;
mod memory;
pub mod serial;
