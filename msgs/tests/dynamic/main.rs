//! Messages met at run time against the structs of the same definitions, and against what is malformed.

#![allow(clippy::unwrap_used)]

mod lookup;
mod malformed;
mod paths;
mod peer;
mod random;
mod text;
mod typed;
mod view;
