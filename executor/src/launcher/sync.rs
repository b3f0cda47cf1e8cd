//! What the gate is built from. The model of `tests/gate_model.rs` puts its own in this place.

pub(super) use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
pub(super) use std::sync::{Arc, Mutex};
pub(super) use std::thread::{Thread, current, park};
