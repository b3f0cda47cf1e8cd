//! How devices are emulated.

use super::fault::Fault;
use super::wire::Timing;
use std::path::PathBuf;

/// Options of the emulator.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EmulatorOptions {
    /// A symbolic link to the port, whose path stays the same when the port changes.
    pub link: Option<PathBuf>,
    /// The same seed gives the same starting pose, noise and faults.
    pub seed: u64,
    /// Whether the timing of the bus is emulated.
    pub timing: Timing,
    /// Faults, with times relative to the start.
    pub faults: Vec<Fault>,
}
