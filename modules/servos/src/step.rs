//! Steps of time that are no part of a motion.

use downbeat_executor::Time;
use std::time::Duration;

/// The longest step between two runs that a motion follows. After a longer one, the process was halted, the
/// module was paused, or the machine's clock was set, as after the boot of a machine without a battery for
/// it: joints must not leap to where they would be by now.
const LONGEST: Duration = Duration::from_millis(500);

/// How long a motion stands still between two runs at these times.
#[must_use]
pub fn standstill(last: Time, now: Time) -> Duration {
    let step = now.saturating_since(last);
    if step > LONGEST { step } else { Duration::ZERO }
}
