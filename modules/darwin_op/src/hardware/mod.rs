//! The Darwin OP humanoid: its bus, its devices, its joints, and the module that drives it.
//!
//! - [`tables`] defines joints, units and control tables;
//! - [`DarwinOp`] is the module: the servos are driven as those of any robot by
//!   [`servo_bus`](downbeat_servos::servo_bus), and its board measures motion and battery.
//!
//! It has never been run on a real robot, only on the emulated one of
//! [`emulator`](crate::emulator).

pub mod tables;

mod calibration;
mod module;
mod settings;

pub use downbeat_servos::servo_bus::{bus, protocol};

pub use module::DarwinOp;
pub use settings::CYCLE;
pub(crate) use settings::FEET;

#[cfg(test)]
mod tests;
