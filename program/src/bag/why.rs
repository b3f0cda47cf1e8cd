//! `downbeat bag why`

use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use anyhow::{anyhow, bail};
use clap::Args;
use downbeat_bags::{Reader, TopicId};
use downbeat_executor::Time;
use downbeat_robot::Catalog;
use downbeat_robot::causes::{Explained, From, Guessed, Limits, Remembered, Rule, RunExplained, Stamped};
use serde_json::json;

use super::causes::{guess, offset, runs, start, times, topic};
use super::cut::{Place, place};
use super::open;
use super::select::absolute;
use crate::statistics::short;

#[derive(Args)]
pub(crate) struct WhyArguments {
    /// A rosbag2 directory or a single file.
    pub(crate) bag: PathBuf,
    /// The message: TOPIC@TIME with an offset into the bag (joint_goals@12.5s) or seconds since the epoch
    /// (joint_goals@1795230923.877), which is the last message at or before this time; or TOPIC#N, with N
    /// from 0.
    #[arg(value_name = "MESSAGE")]
    pub(crate) message: MessagePlace,
    /// How many runs behind each other are followed back.
    #[arg(long, default_value_t = Limits::default().depth, value_name = "N")]
    pub(crate) depth: usize,
    /// Print JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

/// A message on the command line.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MessagePlace {
    topic: String,
    at: At,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum At {
    Time(Place),
    /// From 0.
    Number(u64),
}

impl FromStr for MessagePlace {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong =
            || format!("\"{text}\" is no message; write TOPIC@TIME, such as joint_goals@12.5s, or TOPIC#N");
        let (topic, at) = match (text.rsplit_once('@'), text.rsplit_once('#')) {
            (Some((topic, time)), _) => (topic, At::Time(place(time)?)),
            (None, Some((topic, number))) => (topic, At::Number(number.parse().map_err(|_| wrong())?)),
            (None, None) => return Err(wrong()),
        };
        if topic.is_empty() {
            return Err(wrong());
        }
        Ok(Self { topic: topic.to_owned(), at })
    }
}

/// A message that is further than this before the wanted time is not meant.
const FARTHEST: i64 = 1_000_000_000;

/// A message of a bag.
struct Found {
    /// Its number among those of the topic.
    number: usize,
    time: i64,
    /// Its number among those with the same time, and how many these are.
    at_once: (u64, u64),
}

/// Finds the message in the bag.
fn find(bag: &Reader, id: TopicId, at: At) -> anyhow::Result<Found> {
    let (times, name) = (times(bag, id)?, &bag.topics()[id.index()].info.name);
    if times.is_empty() {
        bail!("{name} has no messages in this bag");
    }
    let number = match at {
        At::Number(number) => {
            usize::try_from(number).ok().filter(|number| *number < times.len()).ok_or_else(|| {
                anyhow!(
                    "{name} has {0} messages in this bag, #0 to #{1}; there is no #{number}",
                    times.len(),
                    times.len() - 1
                )
            })?
        }
        At::Time(place) => {
            let wanted = place.in_bag(start(bag)?);
            let after = times.partition_point(|&time| time <= wanted);
            let is_near = |number: &usize| wanted.saturating_sub(times[*number]) <= FARTHEST;
            after.checked_sub(1).filter(is_near).ok_or_else(|| {
                let around = [after.checked_sub(1), Some(after).filter(|after| *after < times.len())];
                let around = around.into_iter().flatten();
                let shown: Vec<_> = around
                    .map(|number| format!("{name}#{number} at {}", offset(bag, times[number])))
                    .collect();
                anyhow!(
                    "{name} has no message at {} or in the second before; near it is {}",
                    offset(bag, wanted),
                    shown.join(", then ")
                )
            })?
        }
    };
    let time = times[number];
    let first = times.partition_point(|&other| other < time);
    let end = times.partition_point(|&other| other <= time);
    // A damaged bag may have messages in no order.
    let at_once = (number.saturating_sub(first) as u64, end.saturating_sub(first) as u64);
    Ok(Found { number, time, at_once })
}

pub(crate) fn why(arguments: &WhyArguments, catalog: &Catalog) -> anyhow::Result<()> {
    let bag = open(&arguments.bag)?;
    let name = absolute(&arguments.message.topic);
    let id = topic(&bag, &name)?;
    let found = find(&bag, id, arguments.message.at)?;
    let Some(recorded) = runs(&bag, catalog)? else {
        return guessed(arguments, &bag, &name, &found, catalog);
    };
    let history = recorded.history();
    let (nth, at_once) = found.at_once;
    let message = history.message_at(&name[1..], Time::from_nanos(found.time), nth, at_once)?;
    let limits = Limits { depth: arguments.depth, ..Limits::default() };
    let Some(mut explained) = history.explain(message, limits) else {
        bail!("{name}#{} is not among the recorded runs", found.number);
    };
    // The journal also counts messages that the bag lacks.
    explained.number = found.number as u64;
    if arguments.json {
        let output = json!({ "is_exact": true, "message": explained });
        println!("{}", serde_json::to_string_pretty(&output)?);
        return Ok(());
    }
    let root = tree(&bag, &explained, None);
    println!("{}", root.text);
    root.print_branches("");
    if root.is_cut() {
        println!("... follows further with --depth {}", arguments.depth.saturating_mul(2).max(1));
    }
    Ok(())
}

/// Prints what is known of a message without runs.
fn guessed(
    arguments: &WhyArguments,
    bag: &Reader,
    name: &str,
    found: &Found,
    catalog: &Catalog,
) -> anyhow::Result<()> {
    let guess = guess(bag, catalog)?;
    let stamp_ns = guess.stamp(name, found.number);
    let causes = guess.causes(Stamped { topic: name, time_ns: found.time, stamp_ns }, arguments.depth);
    if arguments.json {
        let message = json!({ "topic": name, "number": found.number, "time_ns": found.time });
        let output = json!({ "is_exact": false, "has_graph": guess.has_graph(), "message": message, "causes": causes });
        println!("{}", serde_json::to_string_pretty(&output)?);
        return Ok(());
    }
    if causes.is_empty() {
        let reason = match stamp_ns {
            _ if guess.has_graph() => "its publisher receives no topic of the bag",
            Some(_) => "no earlier message of another topic has its stamp",
            None => "its type has no header.stamp, and the bag has no graph of nodes",
        };
        bail!("nothing is known of the causes of {name}#{}: {reason}", found.number);
    }
    println!("{name}#{} at {}, probably from", found.number, offset(bag, found.time));
    let root = Branch {
        text: String::new(),
        branches: causes.iter().map(|cause| guessed_tree(bag, cause)).collect(),
    };
    root.print_branches("");
    Ok(())
}

fn guessed_tree(bag: &Reader, cause: &Guessed) -> Branch {
    let rule = match cause.rule {
        Rule::SameStamp => "same header.stamp",
        Rule::LastBefore => "last one before",
    };
    let delay = short(Duration::from_nanos(cause.delay_ns));
    let text = format!("{} at {}, {delay} before: {rule}", cause.topic, offset(bag, cause.time_ns));
    Branch { text, branches: cause.from.iter().map(|cause| guessed_tree(bag, cause)).collect() }
}

/// A line with those below it.
struct Branch {
    text: String,
    branches: Vec<Branch>,
}

/// Ends the line of a run that is not followed.
const CUT: &str = "...";

impl Branch {
    fn leaf(text: String) -> Self {
        Self { text, branches: Vec::new() }
    }

    fn print_branches(&self, indentation: &str) {
        for (number, branch) in self.branches.iter().enumerate() {
            let (mark, below) =
                if number + 1 == self.branches.len() { ("└─ ", "   ") } else { ("├─ ", "│  ") };
            println!("{indentation}{mark}{}", branch.text);
            branch.print_branches(&format!("{indentation}{below}"));
        }
    }

    fn is_cut(&self) -> bool {
        self.text.ends_with(CUT) || self.branches.iter().any(Self::is_cut)
    }
}

/// A message, or messages that were published together; `before` is when the run that received them
/// published.
fn tree(bag: &Reader, message: &Explained, before: Option<()>) -> Branch {
    let Explained { topic, number, count, time_ns, delay_ns, from } = message;
    let mut text = format!("/{topic}#{number}");
    if *count > 1 {
        text += &format!(" to #{}", number + count - 1);
    }
    text += &match before {
        None => format!(" at {}", offset(bag, *time_ns)),
        Some(()) => format!(", {} before", short(Duration::from_nanos(*delay_ns))),
    };
    from_tree(bag, text, *time_ns, from)
}

/// The publisher of something that happened at `time_ns`.
fn from_tree(bag: &Reader, text: String, time_ns: i64, from: &From) -> Branch {
    match from {
        From::Outside => Branch::leaf(format!("{text}: from outside")),
        From::Shown { module, cycle } => Branch::leaf(format!("{text}: {module} in cycle {cycle}, as above")),
        From::Deeper { module, cycle } => Branch::leaf(format!("{text}: {module} in cycle {cycle} {CUT}")),
        From::Run(run) => run_tree(bag, text, time_ns, run),
    }
}

fn run_tree(bag: &Reader, text: String, time_ns: i64, run: &RunExplained) -> Branch {
    let RunExplained { module, cycle, step, causes, received, remembered, calls, settings, left_out, .. } =
        run;
    let ran = step.map(|step| {
        let took = Duration::from_nanos(time_ns.saturating_sub(run.time_ns).unsigned_abs());
        format!(", run {step} on its own thread, which took {}", short(took))
    });
    let text =
        format!("{text}: {module} in cycle {cycle}{} ({})", ran.unwrap_or_default(), causes.join(", "));
    let mut branches: Vec<_> = received.iter().map(|message| tree(bag, message, Some(()))).collect();
    if *left_out > 0 {
        branches.insert(0, Branch::leaf(format!("{left_out} earlier parts of what it received")));
    }
    for call in calls {
        let (service, delay) = (&call.service, short(since(call.time_ns, time_ns)));
        let what = if call.is_answer { "answer of" } else { "request to" };
        branches.push(from_tree(bag, format!("{what} /{service}, {delay} before"), call.time_ns, &call.from));
    }
    branches
        .extend(settings.iter().map(|setting| Branch::leaf(format!("new value of the setting {setting}"))));
    let state = |remembered: &Remembered| {
        let Remembered { topic, number, time_ns, age_ns, module, from } = remembered;
        let age = short(Duration::from_nanos(*age_ns));
        let text = format!("perhaps state from /{topic}#{number}, received before, {age} old");
        match from {
            Some(from) => from_tree(bag, text, *time_ns, from),
            None => Branch::leaf(format!("{text}: from {}", module.as_deref().unwrap_or("outside"))),
        }
    };
    branches.extend(remembered.iter().map(state));
    Branch { text, branches }
}

fn since(from_ns: i64, until_ns: i64) -> Duration {
    Duration::from_nanos(u64::try_from(until_ns.saturating_sub(from_ns)).unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_named_by_its_time_or_its_number() {
        let by_number = MessagePlace { topic: "imu/data".into(), at: At::Number(3) };
        assert_eq!("imu/data#3".parse(), Ok(by_number));
        let by_time =
            MessagePlace { topic: "/goals".into(), at: At::Time(Place::Offset(Duration::from_millis(1500))) };
        assert_eq!("/goals@1.5s".parse(), Ok(by_time));
        for wrong in ["goals", "@1s", "#1", "goals@soon", "goals#-1", "goals#"] {
            assert!(wrong.parse::<MessagePlace>().is_err(), "{wrong}");
        }
    }
}
