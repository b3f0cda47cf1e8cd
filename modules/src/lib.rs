//! Ready robot modules.

pub mod darwin_op;
