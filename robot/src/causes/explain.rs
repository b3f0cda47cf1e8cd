//! The causes of a message as a tree.

use std::collections::HashSet;
use std::ops::Range;
use std::time::Duration;

use downbeat_executor::{RunCause, Time};
use serde::Serialize;

use super::history::{Called, History, MessageId, Run, RunId};

/// Messages of a topic that one run published together, and where they came from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Explained {
    /// The topic, without a leading slash.
    pub topic: String,
    /// The number of the first message among those of the topic, from 0.
    pub number: u64,
    /// How many messages these are.
    pub count: u64,
    /// The time of the cycle that published them, in nanoseconds.
    pub time_ns: i64,
    /// The time until the message in whose explanation this is was published; 0 for that message itself.
    pub delay_ns: u64,
    /// Where they came from.
    pub from: From,
}

/// Where messages or a call came from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum From {
    /// From outside the robot's modules: the bridge, a player, a caller.
    Outside,
    /// From a run of a module.
    Run(Box<RunExplained>),
    /// From a run that is explained elsewhere in the tree.
    Shown {
        /// The module.
        module: String,
        /// The cycle in which the messages of the run were published.
        cycle: u64,
    },
    /// From a run that the limits leave out.
    Deeper {
        /// The module.
        module: String,
        /// The cycle in which the messages of the run were published.
        cycle: u64,
    },
}

/// A run, and what led to it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RunExplained {
    /// The module.
    pub module: String,
    /// The cycle in which the messages of the run were published.
    pub cycle: u64,
    /// The number of the run of a detached module.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step: Option<u64>,
    /// The time that the module was given, in nanoseconds.
    pub time_ns: i64,
    /// The reasons of the run.
    pub causes: Vec<&'static str>,
    /// The messages that the run received, by topic and publisher.
    pub received: Vec<Explained>,
    /// What the module had received before on its other subscriptions.
    pub remembered: Vec<Remembered>,
    /// Requests that the run received, and answers to its calls.
    pub calls: Vec<Call>,
    /// The settings that the run was the first to have.
    pub settings: Vec<String>,
    /// How many entries of `received` the limits leave out.
    pub left_out: usize,
}

/// The last message on a subscription without messages in a run. The state of the module may come from it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Remembered {
    /// The topic.
    pub topic: String,
    /// The number of the message.
    pub number: u64,
    /// The time of the cycle that published it, in nanoseconds.
    pub time_ns: i64,
    /// The time from then to the run.
    pub age_ns: u64,
    /// The module that published it; `None` if it came from outside.
    pub module: Option<String>,
    /// Where it came from, if the run had no message or call to follow.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from: Option<From>,
}

/// A request or an answer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Call {
    /// The service.
    pub service: String,
    /// True for an answer to a call of the module, false for a request to it.
    pub is_answer: bool,
    /// When it was sent, in nanoseconds.
    pub time_ns: i64,
    /// The run that called or answered.
    pub from: From,
}

/// How much of the causes is followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// The number of runs behind each other.
    pub depth: usize,
    /// The number of entries of what a run received.
    pub width: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self { depth: 12, width: 16 }
    }
}

/// The name of a cause, for people and JSON.
fn name(cause: RunCause) -> &'static str {
    match cause {
        RunCause::Start => "start",
        RunCause::Messages => "messages",
        RunCause::Time => "timer",
        RunCause::Request => "request",
        RunCause::Response => "response",
        RunCause::Setting => "setting",
        RunCause::Result => "result of a job",
        RunCause::Woken => "woken",
        RunCause::Transition => "transition",
        RunCause::Stop => "stop",
    }
}

fn nanoseconds(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

impl History {
    /// The causes of a message, back to what came from outside, to devices and to timers.
    #[must_use]
    pub fn explain(&self, message: MessageId, limits: Limits) -> Option<Explained> {
        let group = self.group(message)?;
        let mut walk = Walk { history: self, limits, shown: HashSet::new() };
        Some(walk.messages(message.topic, message.number..message.number + 1, group.time, 0))
    }
}

struct Walk<'a> {
    history: &'a History,
    limits: Limits,
    shown: HashSet<RunId>,
}

impl Walk<'_> {
    /// Explains messages that have one publisher, for a run that published at `until`.
    fn messages(&mut self, topic: usize, numbers: Range<u64>, until: Time, depth: usize) -> Explained {
        let id = MessageId { topic, number: numbers.start };
        let group = self.history.group(id);
        let time = group.map_or(until, |group| group.time);
        Explained {
            topic: self.history.topics[topic].name.to_string(),
            number: numbers.start,
            count: numbers.end - numbers.start,
            time_ns: time.as_nanos(),
            delay_ns: nanoseconds(until.saturating_since(time)),
            from: self.from(group.and_then(|group| group.run), depth),
        }
    }

    fn from(&mut self, run: Option<RunId>, depth: usize) -> From {
        let Some(id) = run else { return From::Outside };
        let (module, cycle) = (self.history.module(id).to_owned(), self.history.runs[id.0].cycle);
        if !self.shown.insert(id) {
            return From::Shown { module, cycle };
        }
        if depth >= self.limits.depth {
            return From::Deeper { module, cycle };
        }
        From::Run(Box::new(self.run(id, depth)))
    }

    fn run(&mut self, id: RunId, depth: usize) -> RunExplained {
        let Run { cycle, time, causes, step, .. } = &self.history.runs[id.0];
        let given = self.history.time(id);
        let spans = self.history.received_spans(id).into_iter();
        // The newest of each topic matter most, so they are kept where there are too many.
        let parts: Vec<_> = spans.flat_map(|(topic, span)| self.by_publisher(topic, span)).collect();
        let left_out = parts.len().saturating_sub(self.limits.width);
        let received = parts
            .into_iter()
            .skip(left_out)
            .map(|(topic, span)| self.messages(topic, span, *time, depth + 1));
        let received: Vec<_> = received.collect();
        let calls: Vec<Called> = self.history.calls_of(id).into_iter().cloned().collect();
        let calls = calls.iter().map(|call| Call {
            service: call.service.to_string(),
            is_answer: call.is_answer,
            time_ns: call.time.as_nanos(),
            from: self.from(self.history.run_behind(call), depth + 1),
        });
        let calls: Vec<_> = calls.collect();
        // A run for a timer comes from what the module had received before.
        let depth = (received.is_empty() && calls.is_empty()).then_some(depth + 1);
        let remembered = self.history.remembered(id).into_iter();
        let remembered = remembered.map(|message| self.remembered(message, given, depth)).collect();
        RunExplained {
            module: self.history.module(id).to_owned(),
            cycle: *cycle,
            step: *step,
            time_ns: given.as_nanos(),
            causes: causes.iter().map(name).collect(),
            received,
            remembered,
            calls,
            settings: self.history.settings_of(id).map(|name| name.to_string()).collect(),
            left_out,
        }
    }

    /// The parts of the span that different runs published.
    fn by_publisher(&self, topic: usize, mut span: Range<u64>) -> Vec<(usize, Range<u64>)> {
        let mut parts = Vec::new();
        while !span.is_empty() {
            let group = self.history.group(MessageId { topic, number: span.start });
            let end = group.map_or(span.end, |group| {
                (group.first + u64::from(group.count)).clamp(span.start + 1, span.end)
            });
            parts.push((topic, span.start..end));
            span.start = end;
        }
        parts
    }

    /// A message from which the state at `now` may come, followed back if there is a `depth`.
    fn remembered(&mut self, message: MessageId, now: Time, depth: Option<usize>) -> Remembered {
        let time = self.history.group(message).map_or(now, |group| group.time);
        let publisher = self.history.publisher(message);
        Remembered {
            from: depth.map(|depth| self.from(publisher, depth)),
            topic: self.history.topic(message).to_owned(),
            number: message.number,
            time_ns: time.as_nanos(),
            age_ns: nanoseconds(now.saturating_since(time)),
            module: publisher.map(|run| self.history.module(run).to_owned()),
        }
    }
}
