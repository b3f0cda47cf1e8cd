//! A process that replays a bag for the debugger, and copies itself for checkpoints.

use std::collections::{BTreeMap, BTreeSet};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use downbeat_executor::RunCause;
use downbeat_msgs::downbeat_interfaces::msg::ModuleEvent;
use downbeat_msgs::dynamic::{DynamicMessage, YamlStyle};
use downbeat_robot::replay::{MessageRange, ReplaySession, SessionRun};
#[cfg(feature = "state_machine")]
use downbeat_state_machine::Condition;

use super::fork::{self, Forked};
use super::protocol::{About, Cycle, Got, Link, Message, Messages, Module, Order, Passed, Report, Role, Run};

/// How many cycles of the first pass are told at a time.
const TOLD_TOGETHER: usize = 1000;

/// How long the first pass runs between two checkpoints, at first; and after how many checkpoints that
/// doubles.
const FIRST_INTERVAL: Duration = Duration::from_millis(50);
const DOUBLED_AFTER: u32 = 64;

/// A message of more bytes is not shown whole, and has its checksum.
const LONG: usize = 4096;

/// Carries out orders until the debugger ends.
pub(super) fn serve(
    session: ReplaySession,
    socket: &Path,
    no_checkpoints: Option<String>,
) -> anyhow::Result<()> {
    let mut engine = Engine {
        link: connect(socket)?,
        session,
        socket: socket.to_owned(),
        can_be_copied: no_checkpoints.is_none(),
        is_copy: false,
        has_copies: false,
    };
    engine.begin(Role::First)?;
    let about = engine.about(no_checkpoints);
    engine.link.send(&Report::About(Box::new(about)))?;
    let served = engine.serve();
    if engine.is_copy {
        fork::end();
    }
    served
}

fn connect(socket: &Path) -> anyhow::Result<Link> {
    let stream = UnixStream::connect(socket)
        .with_context(|| format!("cannot reach the debugger at {}", socket.display()))?;
    Ok(Link::new(stream))
}

struct Engine {
    session: ReplaySession,
    link: Link,
    socket: PathBuf,
    /// Whether copies can go on by themselves.
    can_be_copied: bool,
    /// Of another engine.
    is_copy: bool,
    /// Whether there are copies of this one.
    has_copies: bool,
}

impl Engine {
    fn begin(&mut self, role: Role) -> anyhow::Result<()> {
        let here = Report::Here { process: std::process::id(), position: self.session.position(), role };
        self.link.send(&here)
    }

    fn serve(&mut self) -> anyhow::Result<()> {
        while let Some(order) = self.link.receive()? {
            if self.has_copies {
                fork::forget_copies();
            }
            let report = match self.obey(order) {
                Ok(Some(report)) => report,
                Ok(None) => continue,
                Err(error) => Report::Failed { problem: format!("{error:#}") },
            };
            self.link.send(&report)?;
        }
        Ok(())
    }

    fn obey(&mut self, order: Order) -> anyhow::Result<Option<Report>> {
        Ok(Some(match order {
            Order::Pass => self.pass()?,
            Order::Go { to, checkpoints } => self.go(to, &checkpoints)?,
            Order::Search { condition, to, stops } => self.search(&condition, to, stops)?,
            Order::Fork { number } => {
                self.fork(Role::Copy(number))?;
                return Ok(None);
            }
            Order::Show => Report::Cycle(Box::new(self.cycle())),
            Order::Print { topic } => Report::Message(self.message(&topic)?),
            Order::Module { name } => Report::Module(Module {
                settings: self.session.settings(&name).map(|settings| {
                    settings.into_iter().map(|setting| (setting.name, setting.value.to_string())).collect()
                }),
                state: self.session.debug(&name),
                name,
            }),
            Order::Graph => Report::Graph(Box::new(self.session.graph())),
            Order::Snapshot => Report::Snapshot(Box::new(self.session.snapshot())),
        }))
    }

    /// Makes a copy of this process, which connects to the debugger. In the copy, the order is over.
    fn fork(&mut self, role: Role) -> anyhow::Result<Forked> {
        let forked = fork::fork().context("cannot make a checkpoint")?;
        self.has_copies = matches!(forked, Forked::Original);
        if let Forked::Copy = forked {
            self.is_copy = true;
            self.link = connect(&self.socket)?;
            self.begin(role)?;
        }
        Ok(forked)
    }

    /// Makes a copy that waits for orders where this process is, while this one goes on.
    fn leave_checkpoint(&mut self, role: Role) -> anyhow::Result<()> {
        if let Forked::Copy = self.fork(role)? {
            // Not back into the order of the original.
            let _ = self.serve();
            fork::end();
        }
        Ok(())
    }

    fn done(&self, is_at_end: bool) -> Report {
        Report::Done { position: self.session.position(), is_at_end }
    }

    fn go(&mut self, to: u64, checkpoints: &[u64]) -> anyhow::Result<Report> {
        while self.session.position() < to {
            if checkpoints.contains(&self.session.position()) {
                self.leave_checkpoint(Role::Near)?;
            }
            if !self.session.step()? {
                return Ok(self.done(true));
            }
        }
        Ok(self.done(false))
    }

    fn pass(&mut self) -> anyhow::Result<Report> {
        let mut index = Index::default();
        let (mut interval, mut left, mut last) = (FIRST_INTERVAL, 0, Instant::now());
        if self.can_be_copied {
            self.leave_checkpoint(Role::Spread)?;
        }
        while self.session.step()? {
            index.add(&self.session);
            if index.passed.times.len() >= TOLD_TOGETHER || index.passed.difference.is_some() {
                self.link.send(&Report::Passed(index.take()))?;
            }
            if self.can_be_copied && last.elapsed() >= interval {
                self.leave_checkpoint(Role::Spread)?;
                left += 1;
                if left == DOUBLED_AFTER {
                    (interval, left) = (interval * 2, DOUBLED_AFTER / 2);
                }
                last = Instant::now();
            }
        }
        self.link.send(&Report::Passed(index.take()))?;
        Ok(self.done(true))
    }

    #[cfg(feature = "state_machine")]
    fn search(&mut self, expression: &str, to: u64, stops: bool) -> anyhow::Result<Report> {
        let types = self.session.types().iter().filter_map(|(topic, of)| Some((&**topic, of.dynamic()?)));
        let mut condition = Condition::new(expression, types).map_err(anyhow::Error::msg)?;
        for message in self.session.latest() {
            condition.take(&message.topic, message.time, message.cdr());
        }
        let mut becomes_true = |session: &ReplaySession| {
            let standing = session.standing();
            for message in &standing.messages {
                condition.take(&message.topic, message.time, message.cdr());
            }
            condition.becomes_true(standing.time).map_err(anyhow::Error::msg)
        };
        becomes_true(&self.session)?;
        let mut found = None;
        while self.session.position() < to && self.session.step()? {
            if becomes_true(&self.session)? {
                found = Some(self.session.position());
                if stops {
                    break;
                }
            }
        }
        Ok(Report::Found { position: found, last: self.session.position() })
    }

    #[cfg(not(feature = "state_machine"))]
    fn search(&mut self, _: &str, _: u64, _: bool) -> anyhow::Result<Report> {
        use downbeat_robot::features::built_without;
        anyhow::bail!("conditions are not in this program, {}", built_without("state_machine"))
    }

    fn about(&self, no_checkpoints: Option<String>) -> About {
        let about = self.session.about();
        let left_out = about.left_out.iter().map(|left| format!("{left} does not run"));
        let settings = about.changed_settings.iter().map(ToString::to_string);
        let missing = about
            .missing_inputs
            .iter()
            .map(|topic| format!("the bag lacks {topic}, on which the run depended"));
        About {
            robot: about.robot.clone(),
            modules: about.modules.clone(),
            detached: about.detached.clone(),
            topics: self
                .session
                .types()
                .iter()
                .map(|(topic, of)| (topic.to_string(), of.name().to_owned()))
                .collect(),
            notes: about.notes.iter().cloned().chain(left_out).chain(settings).chain(missing).collect(),
            subscriptions: self.session.subscriptions(),
            cycles: about.cycles,
            first_cycle: about.first_cycle,
            start_ns: about.start.as_nanos(),
            no_checkpoints,
        }
    }

    fn cycle(&self) -> Cycle {
        let standing = self.session.standing();
        Cycle {
            position: self.session.position(),
            cycle: standing.cycle,
            time_ns: standing.time.as_nanos(),
            runs: standing.runs.iter().map(|run| self.run(run)).collect(),
            given: standing.given.iter().map(messages).collect(),
            events: self.events(&standing.events, |[from, _]| from.is_empty()),
            difference: self.session.first_difference().map(ToString::to_string),
        }
    }

    fn got(&self, event: &ModuleEvent) -> Got {
        let is_call = [ModuleEvent::REQUEST, ModuleEvent::ANSWER].contains(&event.kind);
        let [from, _] = self.session.parties(event);
        Got {
            event: self.session.sentence(event),
            from: Some(from.to_owned()).filter(|from| is_call && !from.is_empty()),
        }
    }

    /// The sentences of events between certain modules.
    fn events(&self, events: &[ModuleEvent], is_meant: impl Fn([&str; 2]) -> bool) -> Vec<String> {
        let meant = events.iter().filter(|event| is_meant(self.session.parties(event)));
        meant.map(|event| self.session.sentence(event)).collect()
    }

    fn run(&self, run: &SessionRun) -> Run {
        let SessionRun { module, causes, step, received, published, replayed: _ } = run;
        // Messages are listed.
        let causes = causes.iter().filter(|cause| *cause != RunCause::Messages);
        // What took effect at the end of a cycle is there for the runs of the next one.
        let (before, now) = (&self.session.before().events, &self.session.standing().events);
        let got = before.iter().filter(|event| *self.session.parties(event)[1] == **module);
        Run {
            module: module.to_string(),
            causes: causes.map(|cause| cause.to_string()).collect(),
            step: *step,
            received: received.iter().map(messages).collect(),
            published: published.iter().map(messages).collect(),
            got: got.map(|event| self.got(event)).collect(),
            gave: self.events(now, |[from, _]| *from == **module),
        }
    }

    fn message(&self, topic: &str) -> anyhow::Result<Option<Message>> {
        let topic = topic.trim_start_matches('/');
        let Some(message) = self.session.latest().find(|message| *message.topic == *topic) else {
            return Ok(None);
        };
        let of = message.message_type().dynamic();
        let of = of.with_context(|| format!("the definition of {} is not known", message.type_name()))?;
        // As much of a picture as `ros2 topic echo` prints.
        let style = YamlStyle { truncate_length: Some(128), ..YamlStyle::default() };
        let mut yaml = DynamicMessage::from_cdr(&of, message.cdr())?.as_message().to_yaml(&style);
        if message.cdr().len() > LONG {
            yaml +=
                &format!("# {} bytes, CRC-32 {:08x}\n", message.cdr().len(), crc32fast::hash(message.cdr()));
        }
        Ok(Some(Message {
            topic: topic.to_owned(),
            type_name: message.type_name().to_owned(),
            number: message.number,
            time_ns: message.time.as_nanos(),
            yaml,
        }))
    }
}

fn messages(range: &MessageRange) -> Messages {
    Messages { topic: range.topic.to_string(), first: range.first, count: range.count }
}

/// What the first pass tells, collected.
#[derive(Default)]
struct Index {
    modules: BTreeMap<Arc<str>, u32>,
    topics: BTreeMap<Arc<str>, u32>,
    has_difference: bool,
    passed: Passed,
}

impl Index {
    fn add(&mut self, session: &ReplaySession) {
        let standing = session.standing();
        let Self { modules, topics, passed, .. } = self;
        passed.times.push(standing.time.as_nanos());
        let runs = standing.runs.iter().map(|run| number(modules, &run.module, &mut passed.new_modules));
        let runs: BTreeSet<u32> = runs.collect();
        passed.runs.push(runs.into_iter().collect());
        let mut counts = BTreeMap::<u32, u32>::new();
        for message in &standing.messages {
            *counts.entry(number(topics, &message.topic, &mut passed.new_topics)).or_default() += 1;
        }
        passed.messages.push(counts.into_iter().collect());
        if !self.has_difference
            && let Some(difference) = session.first_difference()
        {
            self.has_difference = true;
            self.passed.difference = Some(difference.to_string());
        }
    }

    fn take(&mut self) -> Passed {
        std::mem::take(&mut self.passed)
    }
}

/// The number of a name; a new one is told.
fn number(numbers: &mut BTreeMap<Arc<str>, u32>, name: &Arc<str>, new: &mut Vec<String>) -> u32 {
    if let Some(&number) = numbers.get(name) {
        return number;
    }
    let number = u32::try_from(numbers.len()).unwrap_or(u32::MAX);
    numbers.insert(Arc::clone(name), number);
    new.push(name.to_string());
    number
}
