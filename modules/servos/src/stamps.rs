//! Stamps of messages, and whether commands with stamps are current.
//!
//! A command says when it was given. One that was on its way for longer than it is valid, from a slow network
//! or a bag, is no command for now; one far in the future comes from a machine with another clock. A stamp of
//! 0 is now, as in ros2_control. The time is that of the core, so it is that of the simulator, or of the bag
//! in a replay.

use downbeat_executor::Time;
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::std_msgs::msg::Header;
use std::time::Duration;

/// When a command with this stamp was given: now if that is 0, and never later than now.
///
/// # Errors
/// Returns what is wrong with the stamp if it is older or newer than `timeout`. No stamp is, if that is 0.
pub fn given_at(stamp: &Stamp, now: Time, timeout: Duration) -> Result<Time, String> {
    let given = Time::from_nanos(stamp.as_nanos());
    if given == Time::ZERO {
        return Ok(now);
    }
    let remedy = "check the clocks and the delay, or send a stamp of 0, which means now";
    let (age, lead) = (now.saturating_since(given), given.saturating_since(now));
    if timeout > Duration::ZERO && age > timeout {
        return Err(format!(
            "its stamp is {:.3} s old, and a command is valid for {} s; {remedy}",
            age.as_secs_f64(),
            timeout.as_secs_f64()
        ));
    }
    if timeout > Duration::ZERO && lead > timeout {
        return Err(format!(
            "its stamp is {:.3} s in the future, more than the {} s for which a command is valid; {remedy}",
            lead.as_secs_f64(),
            timeout.as_secs_f64()
        ));
    }
    Ok(given.min(now))
}

/// A header with that stamp.
#[must_use]
pub fn header(stamp: Time, frame_id: &str) -> Header {
    let stamp = Stamp::from_nanos(stamp.as_nanos());
    Header { stamp, frame_id: frame_id.to_owned() }
}

/// Counts the commands that are dropped for their stamps, and reports the first one.
#[derive(Debug, Default)]
pub struct Stale(u64);

impl Stale {
    /// Counts a command that is dropped for this reason.
    pub fn drop_for(&mut self, topic: &str, reason: &str) {
        self.0 += 1;
        let count = self.0;
        if count == 1 {
            tracing::warn!("a command on {topic} is dropped: {reason}; further ones are counted");
        } else if 10_u64.pow(count.ilog10()) == count {
            tracing::info!("{count} commands on {topic} have been dropped for their stamps so far: {reason}");
        }
    }

    /// The number of dropped commands.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stamp_is_compared_with_the_time_of_the_core() {
        let now = Time::from_nanos(1_000_000_000_000);
        let half = Duration::from_millis(500);
        let at = |ms: i64| Stamp::from_nanos(1_000_000_000_000 + ms * 1_000_000);
        let given = |ms: i64, timeout| given_at(&at(ms), now, timeout).map(Time::as_nanos);
        assert_eq!(given_at(&Stamp::default(), now, half), Ok(now), "0 is now");
        assert_eq!(given(-500, half), Ok(999_500_000_000));
        assert_eq!(given(500, half), Ok(1_000_000_000_000), "never later than now");
        assert!(given(-501, half).is_err_and(|reason| reason.starts_with("its stamp is 0.501 s old")));
        assert!(
            given(501, half).is_err_and(|reason| reason.starts_with("its stamp is 0.501 s in the future"))
        );
        assert!(given(-10_000, Duration::ZERO).is_ok() && given(10_000, Duration::ZERO).is_ok());
        assert!(given_at(&Stamp { sec: i32::MIN, nanosec: 0 }, now, half).is_err());
        assert!(given_at(&Stamp { sec: i32::MAX, nanosec: u32::MAX }, now, half).is_err());
    }
}
