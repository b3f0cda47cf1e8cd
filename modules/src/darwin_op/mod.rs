//! The Darwin OP humanoid: its bus, its devices and its joints.

pub mod bus;
pub mod protocol;
pub mod tables;
