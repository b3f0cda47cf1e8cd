//! What probably caused a message in a bag that knows of no runs, such as one of ROS.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::time::Duration;

use downbeat_msgs::downbeat_interfaces::msg::{NetworkEndpoint, NetworkGraph};
use serde::Serialize;

use super::Ages;

/// A message of a bag, by what is known of it without runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamped<'a> {
    /// The topic, absolute.
    pub topic: &'a str,
    /// When it was recorded, in nanoseconds.
    pub time_ns: i64,
    /// Its `header.stamp` in nanoseconds, if its type has one.
    pub stamp_ns: Option<i64>,
}

/// The rule by which a message was guessed to be a cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// It has the same `header.stamp`, which nodes pass on with what they make of a message.
    SameStamp,
    /// It is the last one before on a topic that the publisher receives.
    LastBefore,
}

/// A probable cause.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Guessed {
    /// The topic, absolute.
    pub topic: String,
    /// When it was recorded, in nanoseconds.
    pub time_ns: i64,
    /// The time from then to the message that it caused.
    pub delay_ns: u64,
    /// Why it is taken for a cause.
    pub rule: Rule,
    /// Its own causes. Empty without a graph of nodes, which all rules but the first need.
    pub from: Vec<Guessed>,
}

/// The messages of a bag, and the graph of nodes if the bag has it.
#[derive(Default)]
pub struct Guess {
    /// Times and stamps of each topic, in the order of recording.
    topics: BTreeMap<String, Vec<(i64, Option<i64>)>>,
    /// The topics that a publisher of a topic receives.
    inputs: Option<BTreeMap<String, BTreeSet<String>>>,
}

impl Guess {
    /// Adds a message, in the order of recording.
    pub fn push(&mut self, message: Stamped<'_>) {
        // A new key only for a new topic.
        match self.topics.get_mut(message.topic) {
            Some(messages) => messages.push((message.time_ns, message.stamp_ns)),
            None => {
                drop(self.topics.insert(message.topic.to_owned(), vec![(message.time_ns, message.stamp_ns)]))
            }
        }
    }

    /// Adds what a recorded graph says about who publishes and receives.
    pub fn push_graph(&mut self, graph: &NetworkGraph) {
        let inputs = self.inputs.get_or_insert_default();
        let of_kind = |kind| graph.endpoints.iter().filter(move |endpoint| endpoint.kind == kind);
        for publisher in of_kind(NetworkEndpoint::PUBLISHER).filter(|publisher| !publisher.node.is_empty()) {
            let received =
                of_kind(NetworkEndpoint::SUBSCRIPTION).filter(|other| other.node == publisher.node);
            let received = received.map(|subscription| subscription.name.clone());
            inputs.entry(publisher.name.clone()).or_default().extend(received);
        }
    }

    /// True if the bag has a graph of nodes.
    #[must_use]
    pub fn has_graph(&self) -> bool {
        self.inputs.is_some()
    }

    /// The stamp of a message of a topic, by its number from 0.
    #[must_use]
    pub fn stamp(&self, topic: &str, number: usize) -> Option<i64> {
        self.topics.get(topic)?.get(number)?.1
    }

    /// The time from each message of one topic to the message of another with the same stamp, and how many
    /// messages of the other have none.
    #[must_use]
    pub fn ages(&self, from: &str, to: &str) -> (Ages, u64) {
        let of = |topic: &str| self.topics.get(topic).map(Vec::as_slice).unwrap_or_default();
        let mut origins = HashMap::new();
        for &(time, stamp) in of(from) {
            if let Some(stamp) = stamp.filter(|stamp| *stamp != 0) {
                origins.entry(stamp).or_insert(time);
            }
        }
        let age = |&(time, stamp): &(i64, Option<i64>)| {
            let age = time.checked_sub(*origins.get(&stamp?)?)?;
            Some((Duration::from_nanos(u64::try_from(age).ok()?), 1))
        };
        let ages = Ages::new(of(to).iter().filter_map(age));
        let without = of(to).len() as u64 - ages.count();
        (ages, without)
    }

    /// What probably caused a message, followed back up to `depth` messages.
    #[must_use]
    pub fn causes(&self, message: Stamped<'_>, depth: usize) -> Vec<Guessed> {
        let Some(inputs) = &self.inputs else { return self.of_same_stamp(message) };
        if depth == 0 {
            return Vec::new();
        }
        let inputs = inputs.get(message.topic).into_iter().flatten().filter(|input| *input != message.topic);
        let causes = inputs.filter_map(|input| {
            let (topic, messages) = self.topics.get_key_value(input)?;
            let before = &messages[..messages.partition_point(|&(time, _)| time <= message.time_ns)];
            let stamp = message.stamp_ns.filter(|stamp| *stamp != 0);
            let same = before.iter().rev().find(|(_, other)| stamp.is_some() && *other == stamp);
            let rule = if same.is_some() { Rule::SameStamp } else { Rule::LastBefore };
            let &(time_ns, stamp_ns) = same.or(before.last())?;
            let from = self.causes(Stamped { topic, time_ns, stamp_ns }, depth - 1);
            Some(guessed(topic, time_ns, message.time_ns, rule, from))
        });
        causes.collect()
    }

    /// All earlier messages of other topics with the same stamp, the newest first.
    fn of_same_stamp(&self, message: Stamped<'_>) -> Vec<Guessed> {
        let Some(stamp) = message.stamp_ns.filter(|stamp| *stamp != 0) else { return Vec::new() };
        let others = self.topics.iter().filter(|(topic, _)| *topic != message.topic);
        let causes = others.filter_map(|(topic, messages)| {
            let before = &messages[..messages.partition_point(|&(time, _)| time <= message.time_ns)];
            let &(time, _) = before.iter().rev().find(|(_, other)| *other == Some(stamp))?;
            Some(guessed(topic, time, message.time_ns, Rule::SameStamp, Vec::new()))
        });
        let mut causes: Vec<_> = causes.collect();
        causes.sort_by_key(|cause| cause.delay_ns);
        causes
    }
}

fn guessed(topic: &str, time_ns: i64, until: i64, rule: Rule, from: Vec<Guessed>) -> Guessed {
    Guessed {
        topic: topic.to_owned(),
        time_ns,
        delay_ns: until.saturating_sub(time_ns).unsigned_abs(),
        rule,
        from,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guess(messages: &[(&str, i64, i64)]) -> Guess {
        let mut guess = Guess::default();
        for &(topic, time_ns, stamp) in messages {
            guess.push(Stamped { topic, time_ns, stamp_ns: Some(stamp) });
        }
        guess
    }

    const BAG: [(&str, i64, i64); 5] = [
        ("/image", 100, 90),
        ("/other", 101, 91),
        ("/image", 120, 110),
        ("/box", 125, 90),
        ("/goal", 130, 130),
    ];

    #[test]
    fn a_stamp_that_was_passed_on_names_the_cause() {
        let causes = guess(&BAG).causes(Stamped { topic: "/box", time_ns: 125, stamp_ns: Some(90) }, 9);
        assert_eq!(causes, [guessed("/image", 100, 125, Rule::SameStamp, Vec::new())]);
    }

    #[test]
    fn ages_are_those_of_messages_with_the_same_stamp() {
        let (ages, without) = guess(&BAG).ages("/image", "/box");
        assert_eq!((ages.quantile(1.0), without), (Some(Duration::from_nanos(25)), 0));
        assert_eq!(guess(&BAG).ages("/image", "/goal"), (Ages::default(), 1));
    }

    #[test]
    fn without_a_graph_and_a_shared_stamp_there_is_no_guess() {
        let goal = Stamped { topic: "/goal", time_ns: 130, stamp_ns: Some(130) };
        assert_eq!(guess(&BAG).causes(goal, 9), []);
        assert_eq!(
            guess(&[("/a", 1, 0), ("/b", 2, 0)])
                .causes(Stamped { topic: "/b", time_ns: 2, stamp_ns: Some(0) }, 9),
            []
        );
    }

    #[test]
    fn with_a_graph_the_last_message_before_is_taken_and_followed_back() {
        let mut guess = guess(&BAG);
        let endpoint = |kind, name: &str, node: &str| NetworkEndpoint {
            kind,
            name: name.to_owned(),
            node: node.to_owned(),
            ..NetworkEndpoint::default()
        };
        let (publisher, subscription) = (NetworkEndpoint::PUBLISHER, NetworkEndpoint::SUBSCRIPTION);
        guess.push_graph(&NetworkGraph {
            endpoints: vec![
                endpoint(publisher, "/box", "/detector"),
                endpoint(subscription, "/image", "/detector"),
                endpoint(publisher, "/goal", "/walker"),
                endpoint(subscription, "/box", "/walker"),
            ],
            ..NetworkGraph::default()
        });
        let goal = Stamped { topic: "/goal", time_ns: 130, stamp_ns: Some(130) };
        let image = guessed("/image", 100, 125, Rule::SameStamp, Vec::new());
        assert_eq!(guess.causes(goal, 9), [guessed("/box", 125, 130, Rule::LastBefore, vec![image])]);
        assert_eq!(guess.causes(goal, 1)[0].from, []);
    }
}
