//! The Darwin OP humanoid: its bus, its devices, its joints, and the module that drives it.
//!
//! - [`protocol`] and [`tables`] define data and its meaning, without input or output;
//! - [`bus`] accesses the devices: a serial port, or a recording of one;
//! - [`DarwinOp`] is the module.
//!
//! It has never been run on a real robot, only on the emulated one of
//! [`darwin_op_emulator`](crate::darwin_op_emulator).

pub mod bus;
pub mod protocol;
pub mod tables;

mod diagnostics;
mod driver;
mod module;
mod reading;
mod servo;
mod settings;

pub use module::{CYCLE, DarwinOp};

#[cfg(test)]
mod tests;
