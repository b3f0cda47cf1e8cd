//! Nanoseconds of `builtin_interfaces`.

use crate::builtin_interfaces::msg::{Duration, Time};

const NANOS_PER_SEC: i64 = 1_000_000_000;

impl Time {
    /// The time `nanos` nanoseconds after the epoch, or before it if negative. Times that 32-bit seconds
    /// cannot represent (from the year 2038) saturate.
    #[must_use]
    pub fn from_nanos(nanos: i64) -> Self {
        let (sec, nanosec) = split(nanos);
        Self { sec, nanosec }
    }

    /// Nanoseconds since the epoch.
    #[must_use]
    pub fn as_nanos(self) -> i64 {
        join(self.sec, self.nanosec)
    }
}

impl Duration {
    /// The duration of `nanos` nanoseconds. Durations that 32-bit seconds cannot represent (68 years)
    /// saturate.
    #[must_use]
    pub fn from_nanos(nanos: i64) -> Self {
        let (sec, nanosec) = split(nanos);
        Self { sec, nanosec }
    }

    /// The duration in nanoseconds.
    #[must_use]
    pub fn as_nanos(self) -> i64 {
        join(self.sec, self.nanosec)
    }
}

/// Seconds rounded down, and the nanoseconds to add to them: -1.7 s is -2 s and 300 ms.
fn split(nanos: i64) -> (i32, u32) {
    let nanosec = nanos.rem_euclid(NANOS_PER_SEC) as u32; // Below 10^9.
    match i32::try_from(nanos.div_euclid(NANOS_PER_SEC)) {
        Ok(sec) => (sec, nanosec),
        Err(_) if nanos < 0 => (i32::MIN, 0),
        Err(_) => (i32::MAX, 999_999_999),
    }
}

/// Cannot overflow: 2^31 s and 2^32 ns are a quarter of what an i64 of nanoseconds holds.
fn join(sec: i32, nanosec: u32) -> i64 {
    i64::from(sec) * NANOS_PER_SEC + i64::from(nanosec)
}

#[cfg(test)]
mod tests {
    use super::{Duration, Time};

    #[test]
    fn negative_times_round_down_as_the_definition_says() {
        assert_eq!(Time::from_nanos(-1_700_000_000), Time { sec: -2, nanosec: 300_000_000 });
        assert_eq!(Duration::from_nanos(-1), Duration { sec: -1, nanosec: 999_999_999 });
        assert_eq!(Duration::from_nanos(-1_700_000_000).as_nanos(), -1_700_000_000);
    }

    #[test]
    fn values_out_of_range_saturate() {
        assert_eq!(Time::from_nanos(i64::MAX), Time { sec: i32::MAX, nanosec: 999_999_999 });
        assert_eq!(Time::from_nanos(i64::MIN), Time { sec: i32::MIN, nanosec: 0 });
        assert_eq!(Time { sec: i32::MAX, nanosec: u32::MAX }.as_nanos(), 2_147_483_651_294_967_295);
    }

    proptest::proptest! {
        #[test]
        fn nanoseconds_come_back(nanos in -2_147_483_648_000_000_000_i64..=2_147_483_647_999_999_999) {
            proptest::prop_assert_eq!(Time::from_nanos(nanos).as_nanos(), nanos);
            proptest::prop_assert_eq!(Duration::from_nanos(nanos).as_nanos(), nanos);
        }
    }
}
