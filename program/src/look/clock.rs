//! The time of a command: that of the machine, or of `/clock`.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

use downbeat_bridge::middleware::Sample;
use downbeat_bridge::ros::{MessageType, Subscription};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rosgraph_msgs::msg::Clock;
use downbeat_msgs::{Message, cdr};

use super::Look;

/// Read from any thread.
#[derive(Clone)]
pub(super) enum LookClock {
    System,
    /// Nanoseconds, 0 until the first message.
    Simulated(Arc<AtomicI64>),
}

/// Updates a clock from `/clock`.
pub(super) struct ClockFollower {
    _subscription: Option<Subscription>,
}

impl LookClock {
    pub(super) fn new(look: &Look, use_sim_time: bool) -> anyhow::Result<(Self, ClockFollower)> {
        if !use_sim_time {
            return Ok((Self::System, ClockFollower { _subscription: None }));
        }
        let time = Arc::new(AtomicI64::new(0));
        let heard = Arc::clone(&time);
        let on_sample = move |sample: Sample| match cdr::from_slice::<Clock>(&sample.cdr) {
            Ok(clock) => heard.store(clock.clock.as_nanos(), Ordering::Relaxed),
            Err(error) => tracing::debug!("a message on /clock is not valid: {error}"),
        };
        let clock_type = MessageType::new(Clock::TYPE_NAME)?;
        let subscription =
            look.node.subscribe("/clock", &clock_type, QosProfile::CLOCK, Box::new(on_sample))?;
        Ok((Self::Simulated(time), ClockFollower { _subscription: Some(subscription) }))
    }

    /// Nanoseconds since the epoch; 0 if the time is unknown.
    pub(super) fn now(&self) -> i64 {
        match self {
            Self::System => {
                let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
                i64::try_from(since_epoch.as_nanos()).unwrap_or(i64::MAX)
            }
            Self::Simulated(time) => time.load(Ordering::Relaxed),
        }
    }
}
