//! The core's time for others.

use super::TOPIC;
use crate::expose::ExposeError;
use crate::ros::{MessageType, Node, NodeError, Publisher};
use downbeat_executor::{Context, Core, Inbox, Module, ModuleOptions, Role, Setup, SetupError, Synchrony};
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rosgraph_msgs::msg::Clock;
use downbeat_msgs::{Message, cdr};
use std::num::NonZeroUsize;
use std::time::Duration;

/// The name under which the publisher joins a core.
pub const MODULE_NAME: &str = "clock";

/// As often as `ros2 bag play --clock` publishes the time.
pub const DEFAULT_RATE_HZ: f64 = 40.0;

/// It has no inputs.
const INBOX: NonZeroUsize = NonZeroUsize::MIN;

/// Publishes the core's time on `/clock` every `period` of that time, best effort, keep last 1: adds the
/// detached observer [`MODULE_NAME`] to the core. It ends with the core.
///
/// # Errors
/// [`ExposeError`] where the publisher cannot be created, or the core has such a module already.
pub fn publish(core: &mut Core, node: &Node, period: Duration) -> Result<(), ExposeError> {
    let create = || -> Result<Publisher, NodeError> {
        node.publish(TOPIC, &MessageType::new(Clock::TYPE_NAME)?, QosProfile::CLOCK)
    };
    let publisher = create().map_err(|error| ExposeError::Endpoint { topic: TOPIC.into(), error })?;
    let options = ModuleOptions {
        synchrony: Synchrony::Detached(Inbox::KeepLast(INBOX)),
        role: Role::Observer,
        ..ModuleOptions::default()
    };
    let publisher = ClockPublisher { publisher: Some(publisher), period, has_failed: false };
    Ok(core.add_with(MODULE_NAME, publisher, options)?)
}

struct ClockPublisher {
    publisher: Option<Publisher>,
    period: Duration,
    has_failed: bool,
}

impl Module for ClockPublisher {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.every(self.period, Self::publish_time)
    }

    fn shutdown(&mut self, _ctx: &mut Context<'_>) {
        self.publisher = None;
    }
}

impl ClockPublisher {
    fn publish_time(&mut self, ctx: &mut Context<'_>) {
        let Some(publisher) = &self.publisher else { return };
        // Best effort: an old time is of no use to anyone.
        if !publisher.is_subscribed() {
            return;
        }
        let clock = Clock { clock: Time::from_nanos(ctx.now().as_nanos()) };
        if let Err(error) = publisher.publish(cdr::to_vec(&clock).into())
            && !std::mem::replace(&mut self.has_failed, true)
        {
            tracing::warn!(%error, "the time was not sent on {TOPIC}; further errors are not logged");
        }
    }
}
