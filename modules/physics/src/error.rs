//! Errors of simulations.

use downbeat_darwin_op::emulator::EmulatorError;
use std::time::Duration;

use crate::world::EngineError;

/// Why a robot cannot be simulated.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// A servo has no joint to turn.
    #[error("the robot \"{robot}\" has no joint \"{joint}\", which a servo turns; add it to the URDF")]
    Joint {
        /// The name of the robot.
        robot: String,
        /// The name of the joint.
        joint: String,
    },
    /// The step is too short or too long.
    #[error("a step of {found:?} is not possible; it has to be 1 to 10 ms, in whole milliseconds")]
    Step {
        /// The given step.
        found: Duration,
    },
    /// The engine cannot be used.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// The port of the robot cannot be opened.
    #[error(transparent)]
    Port(#[from] EmulatorError),
    /// The robot starts inside something.
    #[error("the robot starts {depth:.3} m inside \"{other}\" of the world \"{world}\"; move one of them")]
    Overlap {
        /// The name of the world.
        world: String,
        /// What is in the way.
        other: String,
        /// How far, in m.
        depth: f64,
    },
}
