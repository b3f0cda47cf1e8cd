//! Devices on a serial port: how modules reach them, and how they are emulated.
//!
//! [`SerialDevice`] is the device behind the modules. Its exchanges hold every byte that came and went, with
//! the times of their arrival, so that a recording of them replaces it. [`EmulatedPorts`] are emulated
//! devices in this process, which modules open by names that start with `memory:`; [`Emulator`] serves one on
//! a pseudo terminal.

mod device;
mod emulated;
mod emulator;
mod line;

pub use device::{PortSettings, Request, Role, SerialDevice};
pub use emulated::{EmulatedDevice, EmulatedPorts};
pub use emulator::Emulator;
pub(crate) use emulator::Served;
pub(crate) use line::{Event, Line};
