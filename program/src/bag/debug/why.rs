//! Why a message was published: the run that published it, what that run received, and so on, back to what
//! came from outside.

use std::collections::BTreeSet;

use anyhow::Context;
use serde::Serialize;

use super::protocol::Messages;
use super::travel::Travel;

/// A longer chain is cut.
const MOST_MESSAGES: usize = 200;

/// A message with what led to it.
#[derive(Debug, Serialize)]
pub(super) struct Why {
    pub(super) messages: Messages,
    /// Its time, and the cycle in which it was published.
    pub(super) time_ns: i64,
    pub(super) cycle: u64,
    /// The run that published it; `None` if it came from outside.
    pub(super) run: Option<WhyRun>,
    /// What the run received.
    pub(super) because: Vec<Why>,
    /// The messages that the module had received last before, by topic: what it knew when it ran for another
    /// reason than messages.
    pub(super) known: Vec<(Messages, i64)>,
    /// It is explained elsewhere in the chain, or the chain is too long.
    /// Where the rest is, if it is not here.
    pub(super) rest: Option<String>,
}

#[derive(Debug, Serialize)]
pub(super) struct WhyRun {
    pub(super) module: String,
    pub(super) causes: Vec<String>,
    pub(super) step: Option<u64>,
    /// Requests, answers, commands and results of jobs that it was given, in sentences.
    pub(super) got: Vec<String>,
}

/// Explains a message of a topic, by its number. The replay stands where it stood.
pub(super) fn why(travel: &mut Travel, topic: &str, number: u64) -> anyhow::Result<Why> {
    let here = travel.position();
    let mut seen = BTreeSet::new();
    let explained = explain(travel, Messages { topic: topic.to_owned(), first: number, count: 1 }, &mut seen);
    travel.go(here)?;
    explained
}

fn explain(
    travel: &mut Travel,
    messages: Messages,
    seen: &mut BTreeSet<(String, u64)>,
) -> anyhow::Result<Why> {
    let Messages { topic, first, count } = &messages;
    let last = first + count - 1;
    let position = travel.index.message(topic, last).with_context(|| travel.no_message(topic))?;
    travel.go(position)?;
    let cycle = travel.cycle()?;
    let rest = if seen.contains(&(topic.clone(), last)) {
        Some("the rest is above".to_owned())
    } else if seen.len() >= MOST_MESSAGES {
        Some(format!("the chain goes on, `why {topic}#{last}` shows it"))
    } else {
        seen.insert((topic.clone(), last));
        None
    };
    let has_it = |published: &Messages| {
        published.topic == *topic && (published.first..published.first + published.count).contains(&last)
    };
    let run = cycle.runs.iter().find(|run| run.published.iter().any(has_it));
    let (mut because, mut known) = (Vec::new(), Vec::new());
    if let Some(run) = run.filter(|_| rest.is_none()) {
        for received in &run.received {
            because.push(explain(travel, received.clone(), seen)?);
        }
        if run.received.is_empty() {
            known = travel.known_to(&run.module, position);
        }
    }
    let run = run.map(|run| WhyRun {
        module: run.module.clone(),
        causes: run.causes.clone(),
        step: run.step,
        got: run.got.clone(),
    });
    Ok(Why { messages, time_ns: cycle.time_ns, cycle: cycle.cycle, run, because, known, rest })
}

impl Why {
    /// The chain as an indented tree, with the delay of each step.
    pub(super) fn text(&self) -> String {
        let mut text = String::new();
        self.add_to(&mut text, 0, None);
        text
    }

    fn add_to(&self, text: &mut String, depth: usize, effect_ns: Option<i64>) {
        let indent = "  ".repeat(depth);
        let delay = effect_ns.map(|effect| format!(", {} earlier", milliseconds(effect - self.time_ns)));
        let by = match &self.run {
            None => "from the bag: it came from outside these modules".to_owned(),
            Some(WhyRun { module, causes, step, .. }) => {
                let step = step.map(|step| format!(" in its run {step}")).unwrap_or_default();
                let causes =
                    if causes.is_empty() { String::new() } else { format!(" ({})", causes.join(", ")) };
                format!("published by {module}{step}{causes}")
            }
        };
        let (messages, delay) = (&self.messages, delay.unwrap_or_default());
        let cut = self.rest.as_ref().map(|rest| format!("; {rest}")).unwrap_or_default();
        *text += &format!("{indent}{} in cycle #{}{delay}: {by}{cut}\n", messages.name(), self.cycle);
        for event in self.run.iter().flat_map(|run| &run.got) {
            *text += &format!("{indent}  it got: {event}\n");
        }
        for (messages, time_ns) in &self.known {
            let age = milliseconds(self.time_ns - time_ns);
            *text += &format!("{indent}  it knew {}, {age} old\n", messages.name());
        }
        for cause in &self.because {
            cause.add_to(text, depth + 1, Some(self.time_ns));
        }
    }
}

fn milliseconds(ns: i64) -> String {
    format!("{:.3} ms", ns as f64 / 1e6)
}
