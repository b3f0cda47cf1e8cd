//! The primitives from which the gate is built. The model in `tests/gate_model.rs` replaces them.

pub(super) use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
pub(super) use std::sync::{Arc, Mutex};
pub(super) use std::thread::{Thread, current, park};

pub(super) use super::guard::unpoisoned;
