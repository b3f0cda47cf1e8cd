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

/// The way of a stamp from one topic to another.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct GuessedWay {
    /// When the message was recorded to which the way leads, in nanoseconds.
    pub time_ns: i64,
    /// The time from the first message on the way to it.
    pub age_ns: u64,
    /// The first message with the stamp on each topic, both ends included, by time: topic and time in
    /// nanoseconds.
    pub passed: Vec<(String, i64)>,
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
        let ages = self.aged(from, to).map(|aged| (Duration::from_nanos(aged.age_ns), 1));
        let ages = Ages::new(ages);
        let without = self.messages(to).len() as u64 - ages.count();
        (ages, without)
    }

    /// The message with the greatest of these ages, and where its stamp was on the way. Without a graph of
    /// nodes, every topic that had it in the meantime is taken for a part of the way.
    #[must_use]
    pub fn oldest(&self, from: &str, to: &str) -> Option<GuessedWay> {
        let Aged { time_ns, stamp_ns, age_ns } = self.aged(from, to).max_by_key(|aged| aged.age_ns)?;
        let start = time_ns.saturating_sub_unsigned(age_ns);
        let is_between = |topic: &str| match &self.inputs {
            _ if [from, to].contains(&topic) => true,
            Some(_) => self.leads(from, topic) && self.leads(topic, to),
            None => true,
        };
        let passed = self.topics.iter().filter(|(topic, _)| is_between(topic));
        let passed = passed.filter_map(|(topic, messages)| {
            let in_time =
                |time: i64| if topic == to { time == time_ns } else { (start..time_ns).contains(&time) };
            let &(time, _) =
                messages.iter().find(|&&(time, stamp)| in_time(time) && stamp == Some(stamp_ns))?;
            Some((topic.clone(), time))
        });
        let mut passed: Vec<_> = passed.collect();
        // Those of one time keep the ends outside.
        passed.sort_by_key(|(topic, time)| (*time, topic != from, topic == to));
        Some(GuessedWay { time_ns, age_ns, passed })
    }

    /// The messages of a topic with the stamp of an earlier one of another.
    fn aged(&self, from: &str, to: &str) -> impl Iterator<Item = Aged> {
        let mut origins = HashMap::new();
        for &(time, stamp) in self.messages(from) {
            if let Some(stamp) = stamp.filter(|stamp| *stamp != 0) {
                origins.entry(stamp).or_insert(time);
            }
        }
        self.messages(to).iter().filter_map(move |&(time_ns, stamp)| {
            let (stamp_ns, origin) = (stamp?, *origins.get(&stamp?)?);
            let age_ns = u64::try_from(time_ns.checked_sub(origin)?).ok()?;
            Some(Aged { time_ns, stamp_ns, age_ns })
        })
    }

    fn messages(&self, topic: &str) -> &[(i64, Option<i64>)] {
        self.topics.get(topic).map(Vec::as_slice).unwrap_or_default()
    }

    /// Whether nodes that receive one topic publish the other, or what leads to it.
    fn leads(&self, from: &str, to: &str) -> bool {
        let inputs =
            |topic: &str| self.inputs.as_ref().and_then(|inputs| inputs.get(topic)).into_iter().flatten();
        let (mut reached, mut waiting) = (BTreeSet::new(), vec![to]);
        while let Some(topic) = waiting.pop() {
            waiting.extend(inputs(topic).map(String::as_str).filter(|input| reached.insert(*input)));
        }
        reached.contains(from)
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

/// A message of one topic with the stamp of a message of another.
struct Aged {
    time_ns: i64,
    stamp_ns: i64,
    age_ns: u64,
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

    /// A node for each pair of what it receives and publishes.
    fn graph(nodes: &[(&str, &str)]) -> NetworkGraph {
        let endpoint = |kind, name: &str, node| NetworkEndpoint {
            kind,
            name: name.to_owned(),
            node: format!("/node_{node}"),
            ..NetworkEndpoint::default()
        };
        let endpoints = nodes.iter().enumerate().flat_map(|(node, (received, published))| {
            [
                endpoint(NetworkEndpoint::SUBSCRIPTION, received, node),
                endpoint(NetworkEndpoint::PUBLISHER, published, node),
            ]
        });
        NetworkGraph { endpoints: endpoints.collect(), ..NetworkGraph::default() }
    }

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
    fn the_way_of_the_oldest_has_the_topics_that_had_its_stamp_in_between() {
        let bag = [
            ("/image", 100, 90),
            ("/lines", 110, 90),
            ("/shown", 115, 90),
            ("/box", 125, 90),
            ("/lines", 130, 90),
            ("/image", 200, 190),
            ("/box", 210, 190),
        ];
        let way = |topics: &[(&str, i64)]| GuessedWay {
            time_ns: 125,
            age_ns: 25,
            passed: topics.iter().map(|(topic, time)| ((*topic).to_owned(), *time)).collect(),
        };
        let mut guess = guess(&bag);
        let all = [("/image", 100), ("/lines", 110), ("/shown", 115), ("/box", 125)];
        assert_eq!(guess.oldest("/image", "/box"), Some(way(&all)));
        assert_eq!(guess.oldest("/box", "/image"), None);
        // The graph says that a window of somebody does not lead to it.
        guess.push_graph(&graph(&[("/image", "/lines"), ("/lines", "/box"), ("/image", "/shown")]));
        assert_eq!(guess.oldest("/image", "/box"), Some(way(&[all[0], all[1], all[3]])));
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
        guess.push_graph(&graph(&[("/image", "/box"), ("/box", "/goal")]));
        let goal = Stamped { topic: "/goal", time_ns: 130, stamp_ns: Some(130) };
        let image = guessed("/image", 100, 125, Rule::SameStamp, Vec::new());
        assert_eq!(guess.causes(goal, 9), [guessed("/box", 125, 130, Rule::LastBefore, vec![image])]);
        assert_eq!(guess.causes(goal, 1)[0].from, []);
    }
}
