//! Robots in a simulated world: rigid bodies with contacts (rapier) behind the bytes of a robot's bus, so
//! that the hardware module and everything above it cannot tell the simulated robot from a real one.
//!
//! - [`SimulatedRobot`] is for tests: a Darwin OP in a world, the bus in memory, any modules, simulated time;
//! - [`Simulation`] is the body of an emulated robot ([`Body`](downbeat_darwin_op::emulator::Body)) in its
//!   world;
//! - [`simulator::HumanoidSimulator`] is the module for robot files: emulated devices, ground truth, camera,
//!   services;
//! - [`Arena`] is a world with several robots and a ball;
//! - [`tasks`] are what a walking robot has to be able to do;
//! - [`WorldFile`] describes what is around the robot.
//!
//! ```
//! use std::time::Duration;
//! use downbeat_servos::joint_command_mux::JointCommandMux;
//! use downbeat_darwin_op::stand_nod_wave::StandNodWave;
//! use downbeat_physics::{Ball, SimulatedRobot, SimulationOptions};
//!
//! let mut options = SimulationOptions::darwin_op();
//! options.world.ball = Some(Ball { position: [0.2, 0.05], ..Ball::default() });
//! let mut robot = SimulatedRobot::new(options, 1)?;
//! robot.hardware_listens_to("joint_goals")?;
//! robot.add("motion", StandNodWave::default())?;
//! robot.add("mux", JointCommandMux::default())?;
//! robot.run_for(Duration::from_secs(2))?;
//! assert!(robot.is_upright());
//! robot.push("torso", [0.0, 2.0, 0.0]); // N s
//! robot.run_for(Duration::from_secs(1))?;
//! assert!(!robot.is_upright());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The same options, seed and modules give the same bits, under every launcher. `docs/physics.md` says what
//! is modelled.

mod arena;
pub mod camera;
mod error;
mod harness;
mod kinds;
mod machine;
mod model;
mod scenery;
mod simulation;
pub mod simulator;
mod spawned;
pub mod tasks;
mod world;
mod world_file;

/// Version 2.1 of simulation_interfaces, as far as it differs from the carried one.
#[allow(rustdoc::broken_intra_doc_links)] // units in brackets, as ROS writes them in comments of messages
pub mod version_2 {
    downbeat_msgs::include_interfaces!();
}

pub use arena::{Arena, ArenaOptions, ArenaRobot, ArenaSnapshot, Picture, RobotTruth};
pub use error::SimulationError;
pub use harness::{DARWIN_OP, SimulatedRobot, SimulatedRunError};
pub use kinds::kinds;
pub use model::{Body, Joint, Marks, Model, ModelError, Shape};
pub use scenery::{Ball, Block, Field, Floor, WorldFile};
pub use simulation::{Request, RunState, Simulation, SimulationOptions, Snapshot};
pub use spawned::{Spawned, SpawnedShape};
pub use world::{Engine, EngineError, Motion, Posture, Start, Variation};
pub use world_file::WorldFileError;
