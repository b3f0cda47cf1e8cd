//! Messages met at run time against the structs of the same definitions, and against what is malformed.

#![allow(clippy::unwrap_used)]

mod malformed;
mod paths;
#[path = "../interop/random.rs"]
mod random;
mod typed;
