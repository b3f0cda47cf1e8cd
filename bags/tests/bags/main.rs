//! What this crate promises, tried on bags of the real recorder and on bags of its own.

#![allow(clippy::unwrap_used)]

mod damage;
mod dynamic;
mod edit;
mod fixtures;
mod fuzz;
mod interrupted;
mod layout;
mod order;
mod others;
mod python;
mod support;
