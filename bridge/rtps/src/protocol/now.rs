//! The time, which callers pass in.

use std::time::Instant;

/// The two clocks of one moment.
///
/// Timers use the steady clock. The wall clock is only used for timestamps and expiry of samples, so that a
/// step of it (by a time server or a user) neither ends leases nor causes retransmissions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Now {
    /// The steady clock.
    pub steady: Instant,
    /// Nanoseconds since 1970-01-01 UTC.
    pub wall_ns: i64,
}
