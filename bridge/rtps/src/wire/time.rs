//! Times and durations: seconds and fractions of 2⁻³² s (section 9.3.2).

use std::time::Duration;

use super::Malformed;
use super::bytes::{Cursor, Encoder};

const NANOS_PER_SECOND: u64 = 1_000_000_000;

/// A point in time between 1970 and 2106 with a resolution of 0.23 ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Timestamp {
    seconds: u32,
    fraction: u32,
}

impl Timestamp {
    /// Converts from nanoseconds since 1970. Times out of range become the nearest in range.
    pub fn from_nanos(since_epoch: i64) -> Self {
        let nanos = u64::try_from(since_epoch).unwrap_or(0);
        match u32::try_from(nanos / NANOS_PER_SECOND) {
            Ok(seconds) => Self { seconds, fraction: fraction((nanos % NANOS_PER_SECOND) as u32) },
            Err(_) => Self { seconds: u32::MAX, fraction: 0 },
        }
    }

    /// Nanoseconds since 1970. The exact inverse of [`Timestamp::from_nanos`].
    pub fn to_nanos(self) -> i64 {
        // Below 2³² s: half of what fits.
        (u64::from(self.seconds) * NANOS_PER_SECOND + nanos(self.fraction)).cast_signed()
    }

    /// Reads a time; `None` is `TIME_INVALID` of the specification.
    pub(super) fn read(cursor: &mut Cursor<'_>) -> Result<Option<Self>, Malformed> {
        let time = Self { seconds: cursor.u32()?, fraction: cursor.u32()? };
        Ok((time != Self { seconds: u32::MAX, fraction: u32::MAX }).then_some(time))
    }

    pub(super) fn write(self, out: &mut Encoder<'_>) {
        out.u32(self.seconds);
        out.u32(self.fraction);
    }
}

/// Reads a duration. `Some(None)` is infinite; `None` is an error: negative or cut off.
pub(super) fn read_duration(cursor: &mut Cursor<'_>) -> Option<Option<Duration>> {
    let (seconds, fraction) = (cursor.i32().ok()?, cursor.u32().ok()?);
    let seconds = u32::try_from(seconds).ok()?;
    let finite = Duration::from_secs(seconds.into()) + Duration::from_nanos(nanos(fraction));
    Some((seconds != i32::MAX.cast_unsigned()).then_some(finite))
}

/// Writes a duration. `None` and durations above 68 years become infinite.
pub(super) fn write_duration(duration: Option<Duration>, out: &mut Encoder<'_>) {
    let finite = duration.and_then(|duration| {
        let seconds = i32::try_from(duration.as_secs()).ok().filter(|seconds| *seconds < i32::MAX)?;
        Some((seconds, fraction(duration.subsec_nanos())))
    });
    let (seconds, fraction) = finite.unwrap_or((i32::MAX, u32::MAX));
    out.i32(seconds);
    out.u32(fraction);
}

/// Rounds down, so that `nanos` returns the same nanoseconds.
fn fraction(nanos: u32) -> u32 {
    ((u64::from(nanos) << 32) / NANOS_PER_SECOND) as u32
}

/// The nearest number of nanoseconds below a second.
fn nanos(fraction: u32) -> u64 {
    ((u64::from(fraction) * NANOS_PER_SECOND + (1 << 31)) >> 32).min(NANOS_PER_SECOND - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::ByteOrder;

    fn read(seconds: u32, fraction: u32) -> Option<Option<Duration>> {
        let bytes = [seconds.to_be_bytes(), fraction.to_be_bytes()].concat();
        read_duration(&mut Cursor::new(&bytes, ByteOrder::Big))
    }

    #[test]
    fn nanoseconds_round_trip() {
        for nanos in [0, 1, 2, 3, 499_999_999, 500_000_000, 999_999_998, 999_999_999] {
            let since_epoch = 1_795_300_000_000_000_000 + nanos;
            assert_eq!(Timestamp::from_nanos(since_epoch).to_nanos(), since_epoch);
            let duration = Some(Duration::from_nanos(nanos.cast_unsigned()));
            let mut bytes = Vec::new();
            write_duration(duration, &mut Encoder::new(&mut bytes, ByteOrder::Little));
            assert_eq!(read_duration(&mut Cursor::new(&bytes, ByteOrder::Little)), Some(duration));
        }
    }

    #[test]
    fn times_out_of_range_become_the_nearest() {
        assert_eq!(Timestamp::from_nanos(-1), Timestamp::from_nanos(0));
        assert!(Timestamp::from_nanos(i64::MAX) > Timestamp::from_nanos(1_795_300_000_000_000_000));
        assert!(Timestamp { seconds: u32::MAX, fraction: u32::MAX }.to_nanos() > 0);
    }

    #[test]
    fn the_invalid_time_is_none() {
        assert_eq!(Timestamp::read(&mut Cursor::new(&[0xff; 8], ByteOrder::Big)), Ok(None));
    }

    #[test]
    fn an_infinite_duration_is_none_and_a_negative_one_is_invalid() {
        assert_eq!(read(0x7fff_ffff, 0xffff_ffff), Some(None));
        assert_eq!(read(0x7fff_ffff, 0), Some(None));
        assert_eq!(read(0x8000_0000, 0), None);
        assert_eq!(read(0xffff_ffff, 0xffff_ffff), None);
        assert_eq!(read(1, 0x8000_0000), Some(Some(Duration::from_millis(1500))));
        assert_eq!(read(0x7fff_fffe, 0xffff_ffff), Some(Some(Duration::new(0x7fff_fffe, 999_999_999))));
    }

    #[test]
    fn a_duration_that_does_not_fit_becomes_infinite() {
        for duration in [None, Some(Duration::MAX), Some(Duration::from_secs(0x7fff_ffff))] {
            let mut bytes = Vec::new();
            write_duration(duration, &mut Encoder::new(&mut bytes, ByteOrder::Big));
            assert_eq!(bytes, [0x7f, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff]);
        }
    }
}
