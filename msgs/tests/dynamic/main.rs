//! Messages of types known only at run time, compared with the structs of the same definitions, and malformed
//! input.

#![allow(clippy::unwrap_used)]

mod lookup;
mod malformed;
mod paths;
mod peer;
mod random;
mod text;
mod typed;
mod view;
