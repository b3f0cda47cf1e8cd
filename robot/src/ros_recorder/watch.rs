//! Snapshots at a condition on topics of the network, which may come after the recording has begun.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use downbeat_bags::RecordingControl;
use downbeat_bridge::middleware::Sample;
use downbeat_bridge::ros::{MessageType, Node, NodeError, Participant, Subscription};
use downbeat_executor::Time;
use downbeat_msgs::dynamic::DynamicType;
use downbeat_msgs::qos::QosProfile;
use parking_lot::Mutex;

use super::channel::RecorderClock;
use super::definitions::{self, Definition, Inquiry};
use super::{Seen, offers};
use crate::snapshot_condition::SnapshotCondition;

/// Watches the topics that a condition names, whether they are recorded or not.
pub(super) struct Watch {
    expression: String,
    control: RecordingControl,
    after: Duration,
    clock: RecorderClock,
    /// What stands for topics in the expression, as long as it is not evaluated.
    wanted: BTreeSet<String>,
    /// The topics, by what stands for them.
    found: BTreeMap<String, Found>,
    _subscriptions: Vec<Subscription>,
}

/// A topic of the condition.
struct Found {
    topic: String,
    type_name: String,
    requested: QosProfile,
    description: Description,
}

enum Description {
    AskedFor(Box<Inquiry>),
    Known(DynamicType),
}

impl Watch {
    /// The error is a sentence.
    pub(super) fn new(
        expression: &str,
        control: RecordingControl,
        after: Duration,
        clock: RecorderClock,
    ) -> Result<Self, String> {
        Ok(Self {
            expression: expression.to_owned(),
            control,
            after,
            clock,
            wanted: SnapshotCondition::variables(expression)?,
            found: BTreeMap::new(),
            _subscriptions: Vec::new(),
        })
    }

    /// Whether it looks for no further topics.
    pub(super) fn is_complete(&self) -> bool {
        self.wanted.is_empty()
    }

    /// What stands for topics that have not been seen.
    pub(super) fn missing(&self) -> impl Iterator<Item = &str> {
        self.wanted.iter().filter(|name| !self.found.contains_key(*name)).map(String::as_str)
    }

    /// Looks for its topics among those that there are now.
    pub(super) fn discover(&mut self, participant: &Participant, seen: &BTreeMap<String, Seen<'_>>) {
        for (topic, seen) in seen {
            let name = topic.trim_start_matches('/').replace('/', "_");
            let Some(type_name) = seen.types.first().filter(|_| seen.types.len() == 1) else { continue };
            if seen.publishers.is_empty() || !self.wanted.contains(&name) || self.found.contains_key(&name) {
                continue;
            }
            let hash = offers::common_hash(topic, &seen.publishers);
            let description = match (definitions::at_hand(participant.interfaces(), type_name, hash), hash) {
                (Err(_), Some(hash)) => {
                    Ok(Description::AskedFor(Box::new(Inquiry::new(type_name, hash, Instant::now()))))
                }
                (found, _) => read(type_name, found).map(Description::Known),
            };
            match description {
                Ok(description) => {
                    let requested = offers::request_for(topic, &seen.publishers);
                    let (topic, type_name) = (topic.clone(), type_name.clone());
                    self.found.insert(name, Found { topic, type_name, requested, description });
                }
                Err(problem) => return self.give_up(&problem),
            }
        }
    }

    /// Goes on finding out what types look like. Once all are known, the condition is evaluated with each
    /// message.
    pub(super) fn describe(&mut self, participant: &Participant, node: &Node) {
        if self.is_complete() {
            return;
        }
        let now = Instant::now();
        for found in self.found.values_mut() {
            let Description::AskedFor(inquiry) = &mut found.description else { continue };
            let Some(answer) = inquiry.poll(participant, node, &found.topic, now) else { continue };
            match read(&found.type_name, answer) {
                Ok(known) => found.description = Description::Known(known),
                Err(problem) => return self.give_up(&problem),
            }
        }
        let is_known = |found: &Found| matches!(found.description, Description::Known(_));
        if self.found.len() == self.wanted.len() && self.found.values().all(is_known) {
            match self.begin(node) {
                Ok(subscriptions) => self._subscriptions = subscriptions,
                Err(problem) => return self.give_up(&problem),
            }
            self.wanted.clear();
        }
    }

    fn begin(&self, node: &Node) -> Result<Vec<Subscription>, String> {
        let types = self.found.values().filter_map(|found| match &found.description {
            Description::Known(known) => Some((found.topic.trim_start_matches('/'), known.clone())),
            Description::AskedFor(_) => None,
        });
        let condition = SnapshotCondition::new(&self.expression, types, self.control.clone(), self.after)?;
        let condition = Arc::new(Mutex::new(condition));
        let subscribe = |found: &Found| {
            let (condition, clock) = (Arc::clone(&condition), self.clock.clone());
            let name = found.topic.trim_start_matches('/').to_owned();
            let on_sample = Box::new(move |sample: Sample| {
                let Some(now) = clock.now() else { return };
                condition.lock().take(&name, Time::from_nanos(now), &sample.cdr);
            });
            let message_type = MessageType::new(&found.type_name)?;
            node.subscribe(&found.topic, &message_type, found.requested, on_sample)
        };
        let subscriptions: Result<_, NodeError> = self.found.values().map(subscribe).collect();
        subscriptions.map_err(|error| error.to_string())
    }

    fn give_up(&mut self, problem: &str) {
        tracing::error!("the condition of snapshots is not evaluated: {problem}");
        self.wanted.clear();
    }
}

fn read(type_name: &str, found: Result<Definition, String>) -> Result<DynamicType, String> {
    let text = found.map_err(|problem| format!("no definition of {type_name} was found: {problem}"))?.text;
    DynamicType::from_definition_text(type_name, "ros2msg", &text).map_err(|error| error.to_string())
}
