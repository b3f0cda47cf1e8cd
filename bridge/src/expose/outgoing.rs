//! Messages on their way to ROS 2.

use super::limit::{Limiter, OfACycle};
use super::status::Traffic;
use crate::edge::{Offered, Sink};
use crate::ros::Publisher;
use bytes::Bytes;
use downbeat_executor::{Inbox, OutletInbox, Time};
use downbeat_msgs::qos::Durability;
use std::num::NonZeroUsize;
use std::sync::Arc;

/// Batches of a topic that wait while the bridge is busy: 8 s at 125 Hz. Older ones are dropped.
const CAPACITY: NonZeroUsize = NonZeroUsize::new(1000).unwrap();

/// Where messages wait for the bridge.
pub(super) fn inbox() -> OutletInbox {
    OutletInbox::new("bridge", Inbox::KeepLast(CAPACITY))
}

/// Sends what an outlet takes.
pub(super) struct ToRos {
    pub(super) publisher: Arc<Publisher>,
    pub(super) traffic: Arc<Traffic>,
    pub(super) limiter: Limiter,
    pub(super) of_a_cycle: OfACycle,
}

impl Sink for ToRos {
    fn is_wanted(&mut self, message: Offered) -> bool {
        self.traffic.count_dropped(message.missed);
        let is_too_old = self.of_a_cycle == OfACycle::Latest && !message.is_last_of_cycle;
        if is_too_old || !self.limiter.lets_pass(message.time) {
            self.traffic.count_limited();
            return false;
        }
        let is_latched = self.publisher.qos().durability == Durability::TransientLocal;
        let is_wanted = is_latched || self.publisher.matched_subscriptions() > 0;
        if !is_wanted {
            self.traffic.count_skipped();
        }
        is_wanted
    }

    fn take(&mut self, _time: Time, cdr: Bytes) {
        let result = self.publisher.publish(cdr);
        if self.traffic.count(&result)
            && let Err(error) = result
        {
            let topic = self.publisher.topic().as_str();
            tracing::warn!(topic, %error, "a message was not sent; from now on this is only counted");
        }
    }
}
