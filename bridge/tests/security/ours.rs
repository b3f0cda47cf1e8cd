//! A node of this project with an enclave.

use crate::common::{WATCHDOG, on_loopback, wait_until};
use downbeat_bridge::middleware::rtps::RtpsParticipant;
use downbeat_bridge::middleware::{Middleware, ParticipantOptions, SecurityOptions, SecurityState};
use downbeat_bridge::ros::{MessageType, Node, NodeName, Participant, Publisher, Subscription};
use downbeat_msgs::cdr;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::std_msgs::msg::String as Text;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};

pub struct Ours {
    pub domain_id: u16,
    pub node: Node,
    pub participant: Participant,
    pub middleware: Arc<RtpsParticipant>,
}

/// Texts from a topic.
pub struct Texts {
    pub subscription: Subscription,
    received: Receiver<String>,
}

fn text() -> MessageType {
    MessageType::new("std_msgs/msg/String").unwrap()
}

impl Ours {
    /// Node `/node` with an enclave of a keystore.
    pub fn join(domain_id: u16, keystore: &Path, enclave: &str) -> Self {
        let security = SecurityOptions {
            keystore: Some(keystore.to_owned()),
            enclave: enclave.to_owned(),
            enclave_override: None,
            is_enforced: true,
        };
        Self::with(&ParticipantOptions { security: Some(security), ..on_loopback(domain_id) })
    }

    /// Node `/node` without security.
    pub fn join_in_clear(domain_id: u16) -> Self {
        Self::with(&on_loopback(domain_id))
    }

    fn with(options: &ParticipantOptions) -> Self {
        let middleware = Arc::new(RtpsParticipant::new(options).unwrap());
        let participant = Participant::on(middleware.clone()).unwrap();
        let node = participant.create_node(NodeName::new("/", "node").unwrap()).unwrap();
        Self { domain_id: options.domain_id, node, participant, middleware }
    }

    pub fn publisher(&self, topic: &str, qos: QosProfile) -> Publisher {
        self.node.publish(topic, &text(), qos).unwrap()
    }

    pub fn texts(&self, topic: &str, qos: QosProfile) -> Texts {
        let (sender, received) = channel();
        let handler = Box::new(move |sample: downbeat_bridge::middleware::Sample| {
            // The test may have stopped listening.
            let _ = sender.send(cdr::from_slice::<Text>(&sample.cdr).unwrap().data);
        });
        Texts { subscription: self.node.subscribe(topic, &text(), qos, handler).unwrap(), received }
    }

    pub fn security(&self) -> SecurityState {
        self.middleware.security().expect("a participant with security")()
    }

    /// Waits until that many participants have proven their identity.
    pub fn wait_for_authenticated(&self, count: usize) {
        wait_until(&format!("{count} participants are authenticated, not {:?}", self.security()), || {
            self.security().authenticated == count
        });
    }
}

impl Drop for Ours {
    fn drop(&mut self) {
        if std::thread::panicking() {
            println!(
                "ours: {:#?} {:#?}",
                self.middleware.security().map(|state| state()),
                self.middleware.counters()
            );
        }
    }
}

impl Texts {
    pub fn next(&self) -> String {
        self.received.recv_timeout(WATCHDOG).expect("a text within the watchdog time")
    }

    pub fn received(&self) -> Vec<String> {
        self.received.try_iter().collect()
    }
}

/// Waits for a subscription, then publishes texts.
pub fn publish<'a>(publisher: &Publisher, texts: impl IntoIterator<Item = &'a str>) {
    wait_until(&format!("{} has a subscription", publisher.topic()), || {
        publisher.matched_subscriptions() > 0
    });
    for data in texts {
        publisher.publish(cdr::to_vec(&Text { data: data.to_owned() }).into()).unwrap();
    }
}
