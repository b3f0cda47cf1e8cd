//! Publishing the lines.

use super::collector::{Publishing, Rosout};
use super::{LogLine, Severity, logger_name};
use crate::middleware::WriteError;
use crate::ros::{MessageType, Node, NodeError, Publisher};
use crate::worker::Mailbox;
use bytes::Bytes;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rcl_interfaces::msg::Log;
use downbeat_msgs::{Message, cdr};
use parking_lot::Mutex;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use thiserror::Error;

/// Absolute: all nodes publish on one topic, whatever their namespace.
pub const TOPIC: &str = "/rosout";

/// `/rosout` could not be published.
#[derive(Debug, Error)]
pub enum RosoutError {
    /// The publisher could not be created.
    #[error("publishing {TOPIC}: {0}")]
    Node(#[from] NodeError),
    /// Another node publishes it already.
    #[error("{TOPIC} is published by another node of this program; drop that publisher before")]
    Published,
}

/// How many lines are sent before the worker attends to other work.
const TURN: usize = 50;

/// Publishes `/rosout` until it is dropped, which sends what was logged before.
pub struct RosoutPublisher {
    sender: Arc<Mutex<Sender>>,
    lines: Mailbox<()>,
}

impl Rosout {
    /// Publishes collected and future lines on `/rosout` of a node, with the QoS of rcl: reliable, transient
    /// local, keep last 1000, lifespan 10 s.
    ///
    /// # Errors
    /// [`RosoutError`] if the publisher cannot be created, or another node publishes already.
    pub fn publish(&self, node: &Node) -> Result<RosoutPublisher, RosoutError> {
        self.publish_between(node, &[])
    }

    /// The same, and on `/rosout` of nodes in further networks, where lines of modules come from these nodes.
    ///
    /// # Errors
    /// [`RosoutError`] if a publisher cannot be created, or another node publishes already.
    pub fn publish_between(&self, node: &Node, further: &[&Node]) -> Result<RosoutPublisher, RosoutError> {
        let message_type = MessageType::new(Log::TYPE_NAME).map_err(NodeError::from)?;
        let publish = |node: &Node| node.publish(TOPIC, &message_type, QosProfile::ROSOUT);
        let publisher = publish(node)?;
        let further = further.iter().map(|node| publish(node)).collect::<Result<_, _>>()?;
        let lines = Mailbox::new(1);
        let mut waiting = self.shared.waiting.lock();
        if waiting.is_some() {
            return Err(RosoutError::Published);
        }
        *waiting = Some(lines.clone());
        drop(waiting);
        let (rosout, logger) = (self.clone(), logger_name(node.name()));
        let sender = Sender { rosout, publisher, further, logger, missing: 0 };
        let sender = Arc::new(Mutex::new(sender));
        let (weak, incoming, worker) = (Arc::downgrade(&sender), lines.clone(), node.worker());
        worker.clone().spawn(async move {
            loop {
                let Some(sender) = weak.upgrade() else { return };
                let has_sent_all = sender.lock().send_some(TURN);
                drop(sender);
                match has_sent_all {
                    true if incoming.next().await.is_none() => return,
                    true => {}
                    false => worker.catch_up().await,
                }
            }
        });
        Ok(RosoutPublisher { sender, lines })
    }
}

impl Drop for RosoutPublisher {
    fn drop(&mut self) {
        self.lines.close();
        let mut sender = self.sender.lock();
        sender.send_some(usize::MAX);
        *sender.rosout.shared.waiting.lock() = None;
    }
}

struct Sender {
    rosout: Rosout,
    publisher: Publisher,
    /// Those in further networks.
    further: Vec<Publisher>,
    logger: String,
    /// Dropped lines that were reported.
    missing: u64,
}

impl Sender {
    /// Sends at most so many lines. Returns true if no more wait.
    fn send_some(&mut self, most: usize) -> bool {
        let _publishing = Publishing::begin();
        for _ in 0..most {
            let Some(line) = self.rosout.take() else {
                self.report_missing();
                return true;
            };
            self.send(&line);
        }
        false
    }

    fn send(&self, line: &LogLine) {
        let counters = &self.rosout.shared;
        match self.publish(line) {
            // A line that comes while the participant is away is latched, and sent when it has joined its
            // domain again.
            Ok(()) => drop(counters.published.fetch_add(1, Ordering::Relaxed)),
            Err(error) => {
                if counters.failed.fetch_add(1, Ordering::Relaxed) == 0 {
                    tracing::warn!(%error, "a line was not sent on {TOPIC}; further errors are only counted");
                }
            }
        }
    }

    fn publish(&self, line: &LogLine) -> Result<(), WriteError> {
        let of_robot = || Bytes::from(cdr::to_vec(&line.to_message(&self.logger)));
        let sent = match self.rosout.shared.of_modules.find(line) {
            Some((publisher, message)) => publisher.publish(cdr::to_vec(&message).into()),
            None => self.publisher.publish(of_robot()),
        };
        self.further.iter().fold(sent, |sent, publisher| publisher.publish(of_robot()).and(sent))
    }

    fn report_missing(&mut self) {
        let dropped = self.rosout.status().dropped;
        let missing = dropped.saturating_sub(self.missing);
        if missing > 0 {
            self.missing = dropped;
            let text = format!("{missing} lines are missing here: more were logged at once than could wait");
            self.send(&LogLine::now(Severity::Warn, text));
        }
    }
}
