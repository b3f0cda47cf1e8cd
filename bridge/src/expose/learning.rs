//! Finding out what a type looks like that passes through and whose definition this program does not have.

use crate::edge::KnownType;
use crate::ros::{MessageType, Node, Subscription};
use std::io;
use std::sync::{Arc, Weak};
use std::time::Duration;

/// Between one attempt and the next: names of nodes that were there before take some seconds to come.
const PAUSE: Duration = Duration::from_millis(500);

/// How long a node may take to answer.
const PATIENCE: Duration = Duration::from_secs(1);

/// Asks the publishers of a topic for the definition of its type, if it passes through and none is known: on a thread that ends when the definition is known or the
/// subscription is gone.
pub(super) fn learn(
    node: &Node,
    subscription: &Arc<Subscription>,
    message_type: KnownType,
) -> io::Result<()> {
    if !message_type.is_raw() || !message_type.hash().is_empty() {
        return Ok(());
    }
    let (node, subscription) = (node.weak(), Arc::downgrade(subscription));
    let look = move || {
        let Ok(ros_type) = MessageType::new(message_type.name()) else { return };
        let mut is_told = false;
        while message_type.hash().is_empty() {
            std::thread::sleep(PAUSE);
            let Some(topic) = topic_of(&subscription) else { return };
            let Some(topic) = topic else { continue };
            let Some(node) = node.upgrade() else { return };
            match node.describe(&topic, &ros_type, PATIENCE) {
                Ok(definition) => message_type.learn(definition),
                Err(error) if !is_told => {
                    is_told = true;
                    tracing::debug!(topic = topic.as_str(), "{error}");
                }
                Err(_) => {}
            }
        }
    };
    std::thread::Builder::new().name("downbeat-types".to_owned()).spawn(look).map(drop)
}

/// The topic where there is a publisher to ask; nothing inside where there is none, nothing where the subscription is gone.
fn topic_of(subscription: &Weak<Subscription>) -> Option<Option<crate::ros::TopicName>> {
    let subscription = subscription.upgrade()?;
    Some((subscription.matched_publishers() > 0).then(|| subscription.topic().clone()))
}
