//! The time of PX4, and that of the robot.
//!
//! PX4 stamps its messages in microseconds. While its uXRCE-DDS client is synchronised with the agent
//! (`UXRCE_DDS_SYNCT`, on by default), the client converts them to the clock of the agent's machine. Without
//! that they count from the start of the autopilot. [`PilotClock`] accepts both, and finds out which it is.

use downbeat_executor::Time;
use std::time::Duration;

/// Converts stamps of PX4 to times of the robot.
///
/// In this order, the time of a stamp is
///
/// 1. the stamp itself, if it is near the time at which the message was received: the client converts it;
/// 2. the stamp minus the offset that PX4 has estimated (`timesync_status`), if that is near;
/// 3. the stamp plus the smallest difference seen between receiving and stamp, which is that of the message
///    with the least delay. A stamp that does not agree with this difference is a *step*: the first ones are
///    refused, and when [`AGREEING`](Self::AGREEING) of them agree with each other the difference is theirs.
///    This is what a restart of the autopilot looks like.
///
/// ```
/// use downbeat_executor::Time;
/// use downbeat_px4::clock::PilotClock;
///
/// let mut clock = PilotClock::default();
/// let received = Time::from_nanos(1_700_000_000_020_000_000);
/// // A converted stamp, 20 ms old.
/// let time = clock.time_of(1_700_000_000_000_000, received)?;
/// assert_eq!(time, Time::from_nanos(1_700_000_000_000_000_000));
/// # Ok::<(), downbeat_px4::clock::StampRefused>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct PilotClock {
    /// PX4's clock minus that of the companion, in µs.
    estimated_offset: Option<i64>,
    /// Receiving minus stamp, in ns: the smallest one, and when it was last looked at.
    difference: Option<(i64, Time)>,
    /// Differences of refused stamps that agree with each other: the smallest one and their number.
    other: Option<(i64, u32)>,
    /// What stamps are by now.
    source: Option<TimeSource>,
    steps: u64,
}

/// How the time of a stamp was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeSource {
    /// The client converts stamps to the clock of the agent's machine.
    Agent,
    /// By the offset that `timesync_status` reports.
    TimesyncStatus,
    /// By the time at which messages are received.
    Arrival,
}

/// A stamp of which no time is known.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum StampRefused {
    /// A stamp of 0 is none.
    #[error("its timestamp is 0")]
    Zero,
    /// The stamp is neither near the time of the robot nor where the stamps before it say.
    #[error(
        "its timestamp {stamp_us} us is {by_s:.3} s from where the ones before it say; if the autopilot has restarted, the \
         next ones will agree"
    )]
    Step {
        /// The stamp.
        stamp_us: u64,
        /// How far it is from what was expected, in s: positive for one from the past.
        by_s: f64,
    },
}

impl PilotClock {
    /// How near a stamp is to be to the time at which its message is received, if their clocks are the same:
    /// far longer than a message takes, and far shorter than a machine runs.
    pub const NEAR: Duration = Duration::from_secs(5);

    /// How many stamps in a row have to agree after a step.
    pub const AGREEING: u32 = 3;

    /// By how much the delays of messages differ, at most.
    const JITTER_NS: i64 = 1_000_000_000;

    /// By how much the clocks may drift apart, in parts of the time that passes: 50 ppm, twice that of a
    /// usual quartz. The smallest difference grows at this pace, so that it follows a slower clock of PX4.
    const DRIFT: f64 = 50e-6;

    /// Takes the offset of a `TimesyncStatus`, in µs: PX4's clock minus that of the companion. 0 means that
    /// PX4 knows none.
    pub fn on_estimated_offset(&mut self, offset_us: i64) {
        self.estimated_offset = Some(offset_us).filter(|offset| *offset != 0);
    }

    /// Converts a stamp of a message that was received now.
    ///
    /// # Errors
    /// Returns an error if the stamp is 0, or does not agree with earlier stamps.
    pub fn time_of(&mut self, stamp_us: u64, received: Time) -> Result<Time, StampRefused> {
        if stamp_us == 0 {
            return Err(StampRefused::Zero);
        }
        // A stamp that no clock shows is far from everything, and so refused below.
        let stamp = i64::try_from(stamp_us).unwrap_or(i64::MAX).saturating_mul(1000);
        if is_near(stamp, received) {
            self.now_by(TimeSource::Agent);
            return Ok(Time::from_nanos(stamp));
        }
        if let Some(offset) = self.estimated_offset {
            let converted = stamp.saturating_sub(offset.saturating_mul(1000));
            if is_near(converted, received) {
                self.now_by(TimeSource::TimesyncStatus);
                return Ok(Time::from_nanos(converted));
            }
        }
        self.by_arrival(stamp_us, stamp, received)
    }

    /// How the last accepted stamp was converted.
    #[must_use]
    pub fn source(&self) -> Option<TimeSource> {
        self.source
    }

    /// How often stamps have begun to follow another clock.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.steps
    }

    fn by_arrival(&mut self, stamp_us: u64, stamp: i64, received: Time) -> Result<Time, StampRefused> {
        let difference = received.as_nanos().saturating_sub(stamp);
        if self.source.is_none() {
            self.difference = Some((difference, received));
            self.now_by(TimeSource::Arrival);
            return Ok(received);
        }
        // Without a difference, stamps were converted so far, and one that leads nowhere may be damaged.
        let (known, since) = self.difference.unwrap_or((0, received));
        let by = difference.saturating_sub(known);
        let difference = if self.difference.is_none() || by.saturating_abs() > Self::JITTER_NS {
            let (least, count) = match self.other {
                Some((other, count))
                    if difference.saturating_sub(other).saturating_abs() <= Self::JITTER_NS =>
                {
                    (other.min(difference), count + 1)
                }
                _ => (difference, 1),
            };
            if count < Self::AGREEING {
                self.other = Some((least, count));
                return Err(StampRefused::Step { stamp_us, by_s: by as f64 * 1e-9 });
            }
            // A change of the source is counted as a step, too, but once.
            if self.source == Some(TimeSource::Arrival) {
                self.steps += 1;
            }
            least
        } else {
            // Delays are never negative, so the smallest difference is the best.
            let drifted = received.saturating_since(since).as_nanos() as f64 * Self::DRIFT;
            difference.min(known.saturating_add(drifted as i64))
        };
        self.difference = Some((difference, received));
        self.now_by(TimeSource::Arrival);
        Ok(Time::from_nanos(stamp.saturating_add(difference)))
    }

    /// Notes how a stamp was converted that is accepted.
    fn now_by(&mut self, source: TimeSource) {
        self.other = None;
        if self.source.is_some_and(|before| before != source) {
            self.steps += 1;
        }
        self.source = Some(source);
    }
}

/// The stamp for a message to PX4, in µs of the robot's clock, from which its client converts.
#[must_use]
pub fn stamp_us(now: Time) -> u64 {
    u64::try_from(now.as_nanos() / 1000).unwrap_or(0)
}

fn is_near(stamp: i64, received: Time) -> bool {
    let apart = stamp.saturating_sub(received.as_nanos()).unsigned_abs();
    u128::from(apart) <= PilotClock::NEAR.as_nanos()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    const DAY: i64 = 1_700_000_000_000_000_000;

    fn at(ms: i64) -> Time {
        Time::from_nanos(DAY + ms * 1_000_000)
    }

    /// The stamp of an autopilot that started 60 s before `DAY`.
    fn since_boot(ms: i64) -> u64 {
        u64::try_from(60_000 + ms).unwrap() * 1000
    }

    #[test]
    fn a_converted_stamp_is_the_time() {
        let mut clock = PilotClock::default();
        let stamp = stamp_us(at(0));
        assert_eq!(clock.time_of(stamp, at(30)), Ok(at(0)));
        assert_eq!(clock.source(), Some(TimeSource::Agent));
        // A clock that runs ahead by a little is the same clock.
        assert_eq!(clock.time_of(stamp_us(at(40)), at(30)), Ok(at(40)));
        assert_eq!(clock.steps(), 0);
    }

    #[test]
    fn the_offset_of_timesync_status_converts_stamps_since_the_start() {
        let mut clock = PilotClock::default();
        let offset = 60_000_000 - DAY / 1000;
        clock.on_estimated_offset(offset);
        assert_eq!(clock.time_of(since_boot(5), at(9)), Ok(at(5)));
        assert_eq!(clock.source(), Some(TimeSource::TimesyncStatus));
        // An offset from before a restart leads nowhere, and is not used.
        clock.on_estimated_offset(offset + 3_600_000_000);
        let times: Vec<_> = (1..4).map(|n| clock.time_of(since_boot(10 * n), at(10 * n + 4))).collect();
        assert!(times[0].is_err() && times[1].is_err() && times[2] == Ok(at(34)), "{times:?}");
        assert_eq!((clock.source(), clock.steps()), (Some(TimeSource::Arrival), 1));
    }

    #[test]
    fn a_damaged_stamp_among_converted_ones_is_refused() {
        let mut clock = PilotClock::default();
        clock.time_of(stamp_us(at(0)), at(1)).unwrap();
        for number in 1..10 {
            assert!(clock.time_of(stamp_us(at(3_600_000)), at(number * 10)).is_err());
            let stamp = at(number * 10 + 1);
            assert_eq!(clock.time_of(stamp_us(stamp), at(number * 10 + 2)), Ok(stamp));
        }
        assert_eq!((clock.source(), clock.steps()), (Some(TimeSource::Agent), 0));
    }

    #[test]
    fn without_an_offset_the_fastest_message_says_what_time_it_is() {
        let mut clock = PilotClock::default();
        assert_eq!(clock.time_of(since_boot(0), at(50)), Ok(at(50)), "the first one, 50 ms late");
        assert_eq!(clock.time_of(since_boot(10), at(12)), Ok(at(12)), "2 ms late");
        let third = clock.time_of(since_boot(20), at(60)).unwrap();
        assert!((third.as_nanos() - at(22).as_nanos()).abs() < 10_000, "{third:?}");
        assert_eq!(clock.steps(), 0);
    }

    #[test]
    fn one_stamp_that_jumps_is_refused_and_a_restart_is_followed() {
        let mut clock = PilotClock::default();
        clock.time_of(since_boot(0), at(2)).unwrap();
        let error = clock.time_of(since_boot(900_000), at(12)).unwrap_err();
        assert!(error.to_string().contains("is -899.990 s from where the ones before it say"), "{error}");
        let next = clock.time_of(since_boot(20), at(22)).unwrap();
        assert!((next.as_nanos() - at(22).as_nanos()).abs() < 10_000, "the one after it agrees again");
        // The autopilot starts anew.
        let restarted = |ms: i64| u64::try_from(ms).unwrap() * 1000;
        assert!(clock.time_of(restarted(1000), at(3000)).is_err());
        assert!(clock.time_of(restarted(1010), at(3009)).is_err());
        assert_eq!(clock.time_of(restarted(1020), at(3020)), Ok(at(3019)));
        assert_eq!(clock.steps(), 1);
    }

    #[test]
    fn stamps_that_jump_about_are_never_believed() {
        let mut clock = PilotClock::default();
        clock.time_of(since_boot(0), at(2)).unwrap();
        for number in 1..100_i64 {
            let wild = since_boot(number * 10_000_000);
            assert!(clock.time_of(wild, at(number * 10)).is_err(), "{number}");
        }
        assert_eq!((clock.steps(), clock.source()), (0, Some(TimeSource::Arrival)));
    }

    #[test]
    fn numbers_out_of_range_are_refused_or_saturate() {
        let mut clock = PilotClock::default();
        assert_eq!(clock.time_of(0, at(0)), Err(StampRefused::Zero));
        clock.on_estimated_offset(i64::MIN);
        clock.time_of(since_boot(0), at(2)).unwrap();
        assert!(clock.time_of(u64::MAX, at(4)).is_err());
        clock.on_estimated_offset(i64::MAX);
        assert!(clock.time_of(u64::MAX, Time::from_nanos(i64::MIN)).is_err());
        assert_eq!(stamp_us(Time::from_nanos(-5)), 0);
    }

    proptest! {
        #[test]
        fn with_delays_of_milliseconds_times_are_never_late_by_more(
            delays in prop::collection::vec(0..40_i64, 2..200),
        ) {
            let mut clock = PilotClock::default();
            let (mut least, mut last) = (i64::MAX, at(-1));
            for (number, delay) in (0_i64..).zip(delays) {
                let sent = number * 10;
                least = least.min(delay);
                let time = clock.time_of(since_boot(sent), at(sent + delay)).unwrap();
                let late = time.as_nanos() - at(sent).as_nanos();
                prop_assert!((0..=delay * 1_000_000).contains(&late));
                // The drift of two seconds is less than a millisecond.
                prop_assert!(late <= (least + 1) * 1_000_000, "{late} ns, the least delay is {least} ms");
                last = last.max(time);
            }
            prop_assert_eq!(clock.steps(), 0);
        }
    }
}
