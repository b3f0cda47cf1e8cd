//! An emulated Darwin OP: a CM-730 and twenty MX-28 behind a pseudo terminal.
//!
//! Its port carries the bytes that a robot would send, with the timing of its bus. All of its data is
//! *emulated*: no value was measured on a robot, though the constants are close to published ones.
//!
//! ```
//! use downbeat_darwin_op::hardware::bus::{Bus, ExpectedStatus, Outcome, SerialBus};
//! use downbeat_darwin_op::hardware::protocol::{Id, Instruction, Protocol};
//! use downbeat_darwin_op::emulator::{EmulatorOptions, start};
//!
//! let emulator = start(EmulatorOptions::default())?;
//! let mut bus = SerialBus::new();
//! bus.open(&emulator.port_path().to_string_lossy());
//! let ping = Instruction::Ping { id: Id::CM730 }.to_bytes(Protocol::Dynamixel1)?;
//! let answered = bus.exchange(&ping, &[ExpectedStatus { id: Id::CM730, parameters: 0 }]);
//! assert_eq!(answered.reply, [0xFF, 0xFF, 0xC8, 0x02, 0x00, 0x35]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # What is emulated
//! - **Protocol**: the instructions of protocol 1.0; status return level, return delay, registered writes; no
//!   device answers a broadcast except a bulk read, in which a silent device blocks all after it.
//! - **Power**: servos are silent until `DXL_POWER` is 1, and lose their RAM without power.
//! - **Servos**: position control with speed limit, P gain and torque limit; positions in whole ticks; load,
//!   temperature, supply voltage; errors of voltage, temperature and overload, with shutdown.
//! - **Board**: battery voltage that sags with the load, buttons, a 10-bit IMU with noise.
//! - **Feet**: the force sensors with the ids 111 and 112, if the body has feet.
//! - **Mechanics**: a [`Body`]. That of this module, [`Standing`], has joints with friction and a little
//!   gravity, and feet that are assumed to stand flat on the floor, so that the angles of hips, knees and
//!   ankles determine the lean of the trunk, which follows with a short lag, and every corner of the soles
//!   carries the same load. It cannot walk or fall; `downbeat-physics` has a body that can.
//!
//! # What is not emulated
//! Factory reset (answered as an unknown instruction); I and D gains, punch, goal acceleration, multi-turn;
//! the answer to an instruction with a wrong checksum (it is ignored); microphones and analogue inputs. A
//! SYNC_WRITE longer than the servo's buffer of 143 bytes works, as on robots, where each servo needs only
//! its own part.

mod board;
mod control_table;
mod foot;
mod module;
mod robot;
mod servo;
mod standing;

pub use board::Button;
pub use downbeat_servos::servo_emulator::{
    Body, Emulator, EmulatorError, EmulatorOptions, Fault, FaultKind, FaultParseError, FootForces, ImuMotion,
    JointMotion, MemoryBus, MemoryPorts, NameInUse, PortBus, Rate, ServoCommand, Timing,
};
pub use module::DarwinOpEmulator;
pub use standing::Standing;

use crate::hardware::FEET;
use crate::hardware::protocol::Id;
use crate::hardware::tables::joints::JOINTS;
use robot::Robot;
use std::time::Duration;

/// Returns whether a Darwin OP has a servo or a foot with this id.
fn has_unit(id: Id) -> bool {
    JOINTS.iter().any(|joint| joint.id == id) || FEET.iter().any(|(_, foot)| *foot == id)
}

/// Checks that a fault is one of the emulated Darwin OP.
///
/// # Errors
/// Returns an error if the robot has no such servo, or the fault is not emulated for it.
pub fn check_fault(fault: Fault) -> Result<Fault, FaultParseError> {
    match fault.kind {
        FaultKind::Twin(_) | FaultKind::Supply(_) => {
            Err(FaultParseError::Elsewhere { found: fault.to_string() })
        }
        _ => fault.check(has_unit),
    }
}

/// Opens the port of a Darwin OP and starts to serve it.
///
/// # Errors
/// Returns an error if there is no pseudo terminal, or the link cannot be created.
pub fn start(options: EmulatorOptions) -> Result<Emulator, EmulatorError> {
    Emulator::serve(Box::new(Robot::of(&options, None)), options)
}

/// As [`start`], with this body in place of [`Standing`].
///
/// # Errors
/// As [`start`].
pub fn start_with(options: EmulatorOptions, body: Box<dyn Body>) -> Result<Emulator, EmulatorError> {
    Emulator::serve(Box::new(Robot::of(&options, Some(body))), options)
}

/// A Darwin OP without a port, for its [`MemoryBus`]. The link is ignored.
#[must_use]
pub fn in_memory(options: &EmulatorOptions, body: Option<Box<dyn Body>>) -> Emulator {
    Emulator::of(Box::new(Robot::of(options, body)), options)
}

/// Holds a button of an emulated Darwin OP down for a while.
pub fn press_button(emulator: &Emulator, button: Button, held: Duration) {
    emulator.press(button as usize, held);
}

#[cfg(test)]
mod tests;
