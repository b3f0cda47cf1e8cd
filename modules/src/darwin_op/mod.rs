//! Darwin OP.

pub mod bus;
pub mod protocol;
pub mod tables;
