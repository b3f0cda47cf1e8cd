//! Ready robot modules.
//!
//! - [`darwin_op`]: the hardware of the humanoid Darwin OP;
//! - [`darwin_op_emulator`]: an emulated one behind a pseudo terminal;
//! - [`device`]: no module, but what modules use: devices whose answers are recorded and replayed;
//! - [`joint_command_mux`]: who may command which joint;
//! - [`stand_nod_wave`]: a small motion;
//! - [`transform_server`]: an action that answers where frames are in each other.
//!
//! What modules use has packages of its own, without the serial port: [`actions`] that they serve and use, and [`transforms`],
//! where frames are in each other over time.
//!
//! What each publishes, takes and can be set to is on its page, and all together in `README.md`.

pub mod darwin_op;
pub mod darwin_op_emulator;
pub mod device;
pub mod joint_command_mux;
pub mod stand_nod_wave;
pub mod transform_server;

pub use downbeat_actions as actions;
pub use downbeat_transforms as transforms;

#[cfg(test)]
mod testing;
