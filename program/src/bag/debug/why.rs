//! Why a message was published: the run that published it, what that run received, and so on, back to what
//! came from outside.

use std::collections::BTreeSet;

use anyhow::Context;
use serde::Serialize;

use super::protocol::{Messages, Run};
use super::travel::Travel;

/// A longer chain is cut.
const MOST_MESSAGES: usize = 200;

/// Messages, or a call, with what led to them.
#[derive(Debug, Serialize)]
pub(super) struct Why {
    #[serde(flatten)]
    pub(super) what: What,
    /// The time and the number of the cycle in which they were published, or the call was made.
    pub(super) time_ns: i64,
    pub(super) cycle: u64,
    /// The run that did so; `None` if they came from outside.
    pub(super) run: Option<WhyRun>,
    /// The messages, requests and answers that the run received.
    pub(super) because: Vec<Why>,
    /// The messages that the module had received last before, by topic: what it knew when it ran for another
    /// reason than messages.
    pub(super) known: Vec<(Messages, i64)>,
    /// Where the rest is, if it is not here.
    pub(super) rest: Option<String>,
}

#[derive(Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum What {
    Messages(Messages),
    /// A request or an answer of a module.
    Call {
        /// In words.
        event: String,
        from: String,
    },
}

#[derive(Debug, Serialize)]
pub(super) struct WhyRun {
    pub(super) module: String,
    pub(super) causes: Vec<String>,
    pub(super) step: Option<u64>,
    /// Requests and answers from outside, commands and results of jobs that it was given, in sentences.
    pub(super) got: Vec<String>,
}

/// What is explained only once in a chain.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
enum Explained {
    /// The last message of a topic, by its number.
    Message(String, u64),
    /// The run of a module at a position, as the one behind a call.
    Run(String, u64),
}

/// Explains a message of a topic, by its number. The replay stands where it stood.
pub(super) fn why(travel: &mut Travel, topic: &str, number: u64) -> anyhow::Result<Why> {
    let here = travel.position();
    let mut seen = BTreeSet::new();
    let messages = Messages { topic: topic.to_owned(), first: number, count: 1 };
    let explained = explain_messages(travel, messages, &mut seen);
    travel.go(here)?;
    explained
}

fn explain_messages(
    travel: &mut Travel,
    messages: Messages,
    seen: &mut BTreeSet<Explained>,
) -> anyhow::Result<Why> {
    let (topic, last) = (messages.topic.clone(), messages.first + messages.count - 1);
    let position = travel.index.message(&topic, last).with_context(|| travel.no_message(&topic))?;
    let has_it = |run: &Run| {
        let its = |published: &Messages| {
            published.topic == topic && (published.first..published.first + published.count).contains(&last)
        };
        run.published.iter().any(its)
    };
    let (key, hint) = (Explained::Message(topic.clone(), last), format!("`why {topic}#{last}`"));
    explain(travel, What::Messages(messages), position, has_it, key, &hint, seen)
}

/// Explains a request or an answer that took effect at the end of the cycle at a position.
fn explain_call(
    travel: &mut Travel,
    event: String,
    from: String,
    position: u64,
    seen: &mut BTreeSet<Explained>,
) -> anyhow::Result<Why> {
    let (module, key) = (from.clone(), Explained::Run(from.clone(), position));
    let hint = "`why` of a message of that cycle";
    explain(travel, What::Call { event, from }, position, |run| run.module == module, key, hint, seen)
}

fn explain(
    travel: &mut Travel,
    what: What,
    position: u64,
    is_behind: impl Fn(&Run) -> bool,
    key: Explained,
    hint: &str,
    seen: &mut BTreeSet<Explained>,
) -> anyhow::Result<Why> {
    travel.go(position)?;
    let cycle = travel.cycle()?;
    let rest = if seen.contains(&key) {
        Some("the rest is above".to_owned())
    } else if seen.len() >= MOST_MESSAGES {
        Some(format!("the chain goes on, {hint} shows it"))
    } else {
        seen.insert(key);
        None
    };
    // Of several runs of a detached module in a cycle, the last one called.
    let run = cycle.runs.into_iter().rfind(is_behind);
    let (mut because, mut known, mut got) = (Vec::new(), Vec::new(), Vec::new());
    if let Some(run) = run.as_ref().filter(|_| rest.is_none()) {
        for received in &run.received {
            because.push(explain_messages(travel, received.clone(), seen)?);
        }
        for given in &run.got {
            match given.from.clone().zip(position.checked_sub(1)) {
                Some((from, before)) => {
                    because.push(explain_call(travel, given.event.clone(), from, before, seen)?);
                }
                None => got.push(given.event.clone()),
            }
        }
        if run.received.is_empty() {
            known = travel.known_to(&run.module, position);
        }
    }
    let run = run.map(|Run { module, causes, step, .. }| WhyRun { module, causes, step, got });
    Ok(Why { what, time_ns: cycle.time_ns, cycle: cycle.cycle, run, because, known, rest })
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
        let (name, verb) = match &self.what {
            What::Messages(messages) => (messages.name(), "published"),
            What::Call { event, .. } => (event.clone(), "made"),
        };
        let by = match (&self.run, &self.what) {
            (None, What::Messages(_)) => "from the bag: it came from outside these modules".to_owned(),
            (None, What::Call { from, .. }) => format!("{from} did not run in it"),
            (Some(WhyRun { module, causes, step, .. }), _) => {
                let step = step.map(|step| format!(" in its run {step}")).unwrap_or_default();
                let causes =
                    if causes.is_empty() { String::new() } else { format!(" ({})", causes.join(", ")) };
                format!("{verb} by {module}{step}{causes}")
            }
        };
        let delay = delay.unwrap_or_default();
        let cut = self.rest.as_ref().map(|rest| format!("; {rest}")).unwrap_or_default();
        *text += &format!("{indent}{name} in cycle #{}{delay}: {by}{cut}\n", self.cycle);
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
