//! Inertial sensors on I²C.
//!
//! - [`bus`]: the bus as a device, and emulated ones;
//! - [`mpu`]: InvenSense MPU-6050, MPU-6500 and MPU-9250;
//! - [`bno055`]: Bosch BNO055;
//! - [`axes`]: how a chip is mounted;
//! - [`Imu`] is the module, [`ImuEmulator`] emulates the chips.
//!
//! The chips are described without I/O: steps to do, and readings from the bytes that were read.

pub mod axes;
pub mod bno055;
pub mod bus;
mod emulator;
mod module;
pub mod mpu;

pub use emulator::{ImuEmulator, Model, emulated};
pub use module::Imu;

use std::time::Duration;

/// Something to do before a chip measures.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    /// Write a register.
    Write {
        /// The chip, seven bits.
        address: u8,
        /// Which register.
        register: u8,
        /// Values for it and those after it.
        values: Vec<u8>,
    },
    /// Read registers, and take what follows from them.
    Read(Registers),
    /// Wait.
    Pause(Duration),
}

/// Registers in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Registers {
    /// The chip, seven bits.
    pub address: u8,
    /// The first one.
    pub first: u8,
    /// How many.
    pub length: u8,
}

/// What a chip measures, in its own axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reading {
    /// In rad/s.
    pub angular_velocity: Option<[f64; 3]>,
    /// In m/s², upward at rest.
    pub acceleration: Option<[f64; 3]>,
    /// In T.
    pub magnetic_field: Option<[f64; 3]>,
    /// Of the chip in a level world: x, y, z, w.
    pub orientation: Option<[f64; 4]>,
    /// In °C.
    pub temperature: Option<f64>,
}

/// A chip, without I/O.
pub(crate) trait Chip: Send {
    /// The name for people.
    fn title(&self) -> &'static str;

    /// What is done first, each time the bus was opened.
    fn begin(&mut self) -> Vec<Step>;

    /// What follows from registers that a step has read.
    ///
    /// # Errors
    /// In words, if it is another chip.
    fn learn(&mut self, registers: Registers, bytes: &[u8]) -> Result<Vec<Step>, String>;

    /// The registers of a measurement.
    fn registers(&self) -> Vec<Registers>;

    /// Adds what was read to a reading.
    ///
    /// # Errors
    /// In words, if the chip has lost its settings and has to be set up again.
    fn read(&mut self, registers: Registers, bytes: &[u8], reading: &mut Reading) -> Result<(), String>;

    /// What the chip says about itself, for diagnostics.
    fn state(&self) -> Option<String> {
        None
    }
}

fn write(address: u8, register: u8, value: u8) -> Step {
    Step::Write { address, register, values: vec![value] }
}
