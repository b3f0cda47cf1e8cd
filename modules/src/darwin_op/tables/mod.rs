//! The control tables of the Darwin OP's devices, its joints, and its units, as data.

pub mod cm730;
mod field;
pub mod joints;
pub mod mx28;
pub mod units;

pub use field::{Access, Field};
