//! Emulated servos behind a pseudo terminal, or in memory.

mod body;
mod devices;
mod emulator;
mod fault;
mod memory;
mod pseudo_terminal;
mod random;
mod wire;

pub use body::{Body, FootForces, ImuMotion, JointMotion, ServoCommand};
pub(crate) use devices::{Device, answer};
pub(crate) use emulator::Devices;
pub use emulator::{Emulator, EmulatorError, EmulatorOptions};
pub use fault::{Fault, FaultKind, FaultParseError, Rate};
pub use memory::{MemoryBus, MemoryPorts, NameInUse, PortBus};
pub(crate) use random::Random;
pub(crate) use wire::Answer;
pub use wire::Timing;
