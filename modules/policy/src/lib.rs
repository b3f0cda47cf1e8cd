//! Learned policies as modules of a robot: a neural network in an ONNX file takes numbers from topics and
//! moves joints, at a fixed rate, and computes the same bits on every machine.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut network = downbeat_policy::Network::read("balance.onnx".as_ref())?;
//! println!("{} gives {}", network.inputs()[0], network.outputs()[0]); // obs (1 x 12) gives action (1 x 4)
//! let action = network.run(&[&[0.0; 12]])?;
//! # Ok(())
//! # }
//! ```
//!
//! The kind `policy` binds inputs and outputs to topics and joints as a file describes it: docs/policies.md.

mod description;
mod kinds;
mod module;
mod network;

pub use kinds::kinds;
pub use network::{Network, NetworkError, Port};
