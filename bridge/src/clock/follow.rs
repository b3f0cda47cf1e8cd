//! Follows the time on `/clock`.

use super::TOPIC;
use crate::middleware::Sample;
use crate::ros::{MessageType, Node, NodeError, Subscription};
use downbeat_executor::{Clock, CoreHandle, Time};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rosgraph_msgs::msg::Clock as ClockMessage;
use downbeat_msgs::{Message, cdr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};

/// A clock that shows what `/clock` said last, as that of a ROS 2 node with `use_sim_time`: 0 until there was
/// a message, and still between two of them. Clones show the same.
#[derive(Clone, Debug, Default)]
pub struct FollowedClock {
    shared: Arc<Shared>,
}

/// Keeps a clock following until it is dropped.
pub struct FollowedTime {
    subscription: Subscription,
    clock: FollowedClock,
}

#[derive(Debug, Default)]
struct Shared {
    time_ns: AtomicI64,
    is_set: AtomicBool,
    messages: AtomicU64,
    errors: AtomicU64,
}

impl FollowedClock {
    /// A clock that shows 0.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Follows `/clock`, best effort, keep last 1, for the core that has this clock. The time may jump, and
    /// go back.
    ///
    /// # Errors
    /// [`NodeError`] when the subscription cannot be created.
    pub fn follow(&self, node: &Node, core: &CoreHandle) -> Result<FollowedTime, NodeError> {
        let (clock, core) = (self.clone(), core.clone());
        let on_sample = Box::new(move |sample: Sample| clock.take(&sample, &core));
        let kind = MessageType::new(ClockMessage::TYPE_NAME)?;
        let subscription = node.subscribe(TOPIC, &kind, QosProfile::CLOCK, on_sample)?;
        Ok(FollowedTime { subscription, clock: self.clone() })
    }

    /// True once there was a message.
    #[must_use]
    pub fn is_set(&self) -> bool {
        self.shared.is_set.load(Ordering::Acquire)
    }

    fn take(&self, sample: &Sample, core: &CoreHandle) {
        match cdr::from_slice::<ClockMessage>(&sample.cdr) {
            Ok(ClockMessage { clock }) => {
                self.shared.time_ns.store(clock.as_nanos(), Ordering::SeqCst);
                self.shared.messages.fetch_add(1, Ordering::Relaxed);
                if !self.shared.is_set.swap(true, Ordering::AcqRel) {
                    tracing::info!("time is that of {TOPIC}: {}", self.now());
                }
                core.clock_moved();
            }
            Err(error) => {
                if self.shared.errors.fetch_add(1, Ordering::Relaxed) == 0 {
                    tracing::warn!(writer = %sample.writer, %error, "a message of {TOPIC} is none; from now on this is only counted");
                }
            }
        }
    }
}

impl Clock for FollowedClock {
    fn now(&self) -> Time {
        Time::from_nanos(self.shared.time_ns.load(Ordering::SeqCst))
    }

    /// True: it is moved by others, not by who runs the core.
    fn runs_by_itself(&self) -> bool {
        true
    }
}

impl FollowedTime {
    /// The number of publishers of the time; there should be one.
    #[must_use]
    pub fn matched_publishers(&self) -> usize {
        self.subscription.matched_publishers()
    }

    /// Messages that set the clock.
    #[must_use]
    pub fn messages(&self) -> u64 {
        self.clock.shared.messages.load(Ordering::Relaxed)
    }

    /// Samples that were no such messages.
    #[must_use]
    pub fn errors(&self) -> u64 {
        self.clock.shared.errors.load(Ordering::Relaxed)
    }
}
