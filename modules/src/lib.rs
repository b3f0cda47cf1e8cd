//! Ready robot modules.

pub mod darwin_op;
pub mod darwin_op_emulator;
