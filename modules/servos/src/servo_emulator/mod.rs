//! Emulated servos behind a pseudo terminal, or in memory.
//!
//! An [`Emulator`] answers as the devices that a [`Description`](crate::servo_bus::Description) describes, in
//! all protocols of [`servo_bus`](crate::servo_bus::protocol), with the timing of their bus. All of its data
//! is *emulated*: no value was measured on a robot. The emulated Darwin OP of `downbeat-darwin-op` is such an
//! emulator with a board and a body of its own.
//!
//! ```
//! use downbeat_servos::servo_bus::Description;
//! use downbeat_servos::servo_bus::bus::{Bus, ExpectedStatus, Outcome};
//! use downbeat_servos::servo_bus::protocol::{Id, Instruction, Protocol};
//! use downbeat_servos::servo_emulator::{Emulator, EmulatorOptions};
//!
//! let arm = Description::load("name = 'arm'
//!     [[bus]]
//!     name = 'arm'
//!     port = '/dev/ttyACM0'
//!     baud = 1_000_000
//!     protocol = 'feetech_sts'
//!     cycle_ms = 10
//!     [[joint]]
//!     name = 'elbow'
//!     id = 3
//!     model = 'STS3215'
//!     limits = [-1.7, 1.7]")?;
//! let emulator = Emulator::servos_in_memory(arm.bus("")?, &EmulatorOptions::default());
//! let (mut bus, elbow) = (emulator.bus(), Id::new(3).unwrap());
//! bus.open("");
//! let ping = Instruction::Ping { id: elbow }.to_bytes(Protocol::FeetechSts)?;
//! assert_eq!(bus.exchange(&ping, &[ExpectedStatus { id: elbow, parameters: 0 }]).outcome, Outcome::Ok);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`Devices`] of another kind, such as a robot with a board, are served by [`Emulator::serve`] and
//! [`Emulator::of`].
//!
//! # What is emulated
//! - **Protocols**: all instructions of [`Instruction`](crate::servo_bus::protocol::Instruction) except a
//!   factory reset; status return level, return delay, registered writes; a silent device blocks those after
//!   it in a read of several.
//! - **Tables**: all registers of the models, with ranges, read-only registers, and EEPROM that is locked.
//! - **Ports**: a device is silent at another speed than that of its register `baud_rate`.
//! - **Servos**: position control with P gain and torque limit, velocity and current control, without load;
//!   temperature; the watchdog of the bus. A servo without power loses its RAM. A wrong supply is measured
//!   and reported, and two servos of one id talk at the same time. Homing offsets; those of Dynamixel count
//!   on over the end of a turn, and forget whole turns when they are switched on or get their torque.
//!
//! # What is not emulated
//! Further operating modes; speed and acceleration limits, I and D gains; shutdown on overload, overheating
//! or a wrong voltage; the values of sensors on devices beside servos, except an IMU that stands still.

mod body;
mod devices;
mod emulator;
mod error;
mod fault;
mod memory;
mod module;
mod options;
mod ports;
#[cfg_attr(not(unix), path = "pseudo_terminal_elsewhere.rs")]
mod pseudo_terminal;
mod random;
mod servos;
mod shared;
mod wire;

pub use body::{Body, FootForces, ImuMotion, JointMotion, ServoCommand};
pub use devices::{Device, Devices, answer};
pub use emulator::Emulator;
pub use error::EmulatorError;
pub use fault::{Disturbance, Fault, FaultKind, FaultParseError, FaultSchedule, Rate};
pub use memory::MemoryBus;
pub use module::{Served, ServoEmulator};
pub use options::EmulatorOptions;
pub use ports::{MemoryPorts, NameInUse, PortBus};
pub use pseudo_terminal::{PseudoTerminal, remove_links};
pub use random::Random;
pub use servos::Unit;
pub use wire::{Answer, Timing};

use crate::servo_bus::BusPlan;
use servos::Servos;

impl Emulator {
    /// Opens the port of the devices of a bus and starts to serve it.
    ///
    /// # Errors
    /// Returns an error if there is no pseudo terminal, or the link cannot be created.
    pub fn start_servos(plan: &BusPlan, options: EmulatorOptions) -> Result<Self, EmulatorError> {
        Self::serve(Box::new(Servos::new(plan, options.seed, None)), options)
    }

    /// As [`Emulator::start_servos`], with a body as of [`Emulator::servos_with`].
    ///
    /// # Errors
    /// As [`Emulator::start_servos`].
    pub fn start_servos_with(
        plan: &BusPlan,
        options: EmulatorOptions,
        body: Box<dyn Body>,
    ) -> Result<Self, EmulatorError> {
        Self::serve(Box::new(Servos::new(plan, options.seed, Some(body))), options)
    }

    /// The devices of a bus without a port, for its [`MemoryBus`]. The link is ignored.
    #[must_use]
    pub fn servos_in_memory(plan: &BusPlan, options: &EmulatorOptions) -> Self {
        Self::of(Box::new(Servos::new(plan, options.seed, None)), options)
    }

    /// As [`Emulator::servos_in_memory`], with this body in place of joints without load. The commands and
    /// motions of the body are those of the joints of the plan, in its order.
    #[must_use]
    pub fn servos_with(plan: &BusPlan, options: &EmulatorOptions, body: Box<dyn Body>) -> Self {
        Self::of(Box::new(Servos::new(plan, options.seed, Some(body))), options)
    }
}
