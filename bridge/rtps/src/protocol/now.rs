//! The time, as callers hand it in.

use std::time::Instant;

/// The two clocks of one moment.
///
/// The steady clock decides every timer. The wall clock only stamps and expires samples, so that a step of it (a time server,
/// a user) neither runs out leases nor starts storms of repetitions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Now {
    /// The steady clock.
    pub steady: Instant,
    /// Nanoseconds since 1970-01-01 UTC.
    pub wall_ns: i64,
}
