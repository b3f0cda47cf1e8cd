//! The thread that publishes the lines.

use super::collector::{Rosout, mark_this_thread};
use super::{LogLine, Severity, logger_name};
use crate::middleware::WriteError;
use crate::ros::{MessageType, Node, NodeError, Publisher};
use crossbeam::sync::Parker;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rcl_interfaces::msg::Log;
use downbeat_msgs::{Message, cdr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use thiserror::Error;

/// Absolute: all nodes publish on one topic, whatever their namespace.
pub const TOPIC: &str = "/rosout";

/// `/rosout` could not be published.
#[derive(Debug, Error)]
pub enum RosoutError {
    /// The publisher could not be created.
    #[error("publishing {TOPIC}: {0}")]
    Node(#[from] NodeError),
    /// A thread publishes it already.
    #[error("{TOPIC} is published by another node of this program; drop that publisher before")]
    Published,
    /// The thread could not be started.
    #[error("starting the thread that publishes {TOPIC}: {0}")]
    Thread(#[from] std::io::Error),
}

/// Publishes `/rosout` until it is dropped, which sends what was logged before.
pub struct RosoutPublisher {
    rosout: Rosout,
    is_ending: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Rosout {
    /// Publishes on `/rosout` of a node what was collected and what will be, with the QoS of rcl: reliable, transient local,
    /// keep last 1000, lifespan 10 s.
    ///
    /// # Errors
    /// [`RosoutError`] where the publisher or its thread cannot be had, or another node publishes already.
    pub fn publish(&self, node: &Node) -> Result<RosoutPublisher, RosoutError> {
        let message_type = MessageType::new(Log::TYPE_NAME).map_err(NodeError::from)?;
        let publisher = node.publish(TOPIC, &message_type, QosProfile::ROSOUT)?;
        let Some(parker) = self.shared.parker.lock().take() else { return Err(RosoutError::Published) };
        let is_ending = Arc::new(AtomicBool::new(false));
        let logger = logger_name(node.name());
        let sender = Sender { rosout: self.clone(), publisher, logger, missing: 0 };
        let thread = std::thread::Builder::new().name("rosout".into()).spawn({
            let is_ending = Arc::clone(&is_ending);
            move || sender.run(parker, &is_ending)
        })?;
        Ok(RosoutPublisher { rosout: self.clone(), is_ending, thread: Some(thread) })
    }
}

impl Drop for RosoutPublisher {
    fn drop(&mut self) {
        self.is_ending.store(true, Ordering::Release);
        self.rosout.shared.unparker.unpark();
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread that publishes {TOPIC} panicked");
        }
    }
}

struct Sender {
    rosout: Rosout,
    publisher: Publisher,
    logger: String,
    /// Dropped lines that were reported.
    missing: u64,
}

impl Sender {
    fn run(mut self, parker: Parker, is_ending: &AtomicBool) {
        mark_this_thread();
        loop {
            // Read before the lines, so that what was logged before the end is sent.
            let is_last = is_ending.load(Ordering::Acquire);
            while let Some(line) = self.rosout.take() {
                self.send(&line);
            }
            self.report_missing();
            if is_last {
                break;
            }
            parker.park();
        }
        let Self { rosout, publisher, .. } = self;
        drop(publisher);
        *rosout.shared.parker.lock() = Some(parker);
    }

    fn send(&self, line: &LogLine) {
        let counters = &self.rosout.shared;
        match self.publish(line) {
            // A line that comes while the participant is away is latched, and sent when it has joined its domain again.
            Ok(()) => drop(counters.published.fetch_add(1, Ordering::Relaxed)),
            Err(error) => {
                if counters.failed.fetch_add(1, Ordering::Relaxed) == 0 {
                    tracing::warn!(%error, "a line was not sent on {TOPIC}; further errors are only counted");
                }
            }
        }
    }

    fn publish(&self, line: &LogLine) -> Result<(), WriteError> {
        match self.rosout.shared.of_modules.find(line) {
            Some((publisher, message)) => publisher.publish(cdr::to_vec(&message).into()),
            None => self.publisher.publish(cdr::to_vec(&line.to_message(&self.logger)).into()),
        }
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
