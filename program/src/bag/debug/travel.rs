//! Goes to any cycle of a replay: engines that stand at cycles, and copies of them as checkpoints.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::os::unix::net::{UnixListener, UnixStream};
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use downbeat_executor::{Graph, Snapshot};
use downbeat_files::suggestion;
use tempfile::TempDir;

use super::protocol::{About, Cycle, Link, Message, Messages, Module, Order, Passed, Report, Role};
use super::words::Goal;
use crate::own_command::this_command;

/// Checkpoints that the first pass leaves, at most.
const MOST_SPREAD: usize = 64;

/// Checkpoints around the cycles that were looked at, at most.
const MOST_NEAR: usize = 32;

/// The most memory of all checkpoints, beyond what they share.
const MOST_MEMORY: u64 = 400 << 20;

/// How many cycles before a goal checkpoints are left on the way to it, for steps backwards from there.
const BEFORE_GOAL: [u64; 8] = [1, 4, 16, 64, 256, 1024, 4096, 16384];

/// How long a copy may take to connect.
const PATIENCE: Duration = Duration::from_secs(30);

/// How long an engine may take to end by itself.
const END: Duration = Duration::from_millis(500);

/// A replay, and where it stands.
pub(super) struct Travel {
    // Declared first: engines end before the folder of their socket goes.
    current: Engine,
    checkpoints: BTreeMap<u64, Checkpoint>,
    /// The engine that was started, once it is not the current one. It owns what its copies use.
    first: Option<Engine>,
    started: Child,
    listener: UnixListener,
    folder: TempDir,
    about: About,
    pub(super) index: Index,
    /// How many goals were reached, and how many copies ordered.
    arrivals: u64,
    copies: u64,
}

struct Checkpoint {
    engine: Engine,
    /// The goal on the way to which it was left, counted.
    arrival: u64,
}

/// An engine that waits for orders.
struct Engine {
    link: Link,
    process: u32,
    position: u64,
    role: Role,
}

/// What happened in which cycle. Positions count the cycles up to and with one.
#[derive(Default)]
pub(super) struct Index {
    /// The times of cycles, in nanoseconds.
    times: Vec<i64>,
    modules: BTreeMap<String, Vec<u32>>,
    topics: BTreeMap<String, Vec<(u32, u32)>>,
    module_names: Vec<String>,
    topic_names: Vec<String>,
    /// Where the first difference from the bag came up.
    pub(super) difference: Option<(u64, String)>,
}

impl Index {
    fn add(&mut self, passed: Passed) {
        let Passed { times, new_modules, new_topics, runs, messages, difference } = passed;
        self.module_names.extend(new_modules);
        self.topic_names.extend(new_topics);
        for ((time, runs), messages) in times.into_iter().zip(runs).zip(messages) {
            self.times.push(time);
            let position = u32::try_from(self.times.len()).unwrap_or(u32::MAX);
            for name in runs.iter().filter_map(|number| self.module_names.get(*number as usize)) {
                self.modules.entry(name.clone()).or_default().push(position);
            }
            for (number, count) in messages {
                if let Some(name) = self.topic_names.get(number as usize) {
                    self.topics.entry(name.clone()).or_default().push((position, count));
                }
            }
        }
        if let Some(difference) = difference {
            self.difference = Some((self.end(), difference));
        }
    }

    /// The position after the last cycle.
    pub(super) fn end(&self) -> u64 {
        self.times.len() as u64
    }

    /// The position of the last cycle at or before a time; that of the first one if none is.
    pub(super) fn at(&self, time_ns: i64) -> u64 {
        (self.times.partition_point(|time| *time <= time_ns) as u64).clamp(1, self.end().max(1))
    }

    fn time(&self, position: u64) -> Option<i64> {
        self.times.get(usize::try_from(position.checked_sub(1)?).ok()?).copied()
    }

    pub(super) fn modules(&self) -> impl Iterator<Item = &str> {
        self.modules.keys().map(String::as_str)
    }

    pub(super) fn topics(&self) -> impl Iterator<Item = (&str, u64)> {
        let count = |cycles: &Vec<(u32, u32)>| cycles.iter().map(|(_, count)| u64::from(*count)).sum();
        self.topics.iter().map(move |(name, cycles)| (name.as_str(), count(cycles)))
    }

    /// How many messages a topic had.
    fn count(&self, topic: &str) -> u64 {
        let cycles = self.topics.get(topic.trim_start_matches('/'));
        cycles.into_iter().flatten().map(|(_, count)| u64::from(*count)).sum()
    }

    /// The positions of the cycles in which a module ran.
    pub(super) fn runs(&self, module: &str) -> Option<impl DoubleEndedIterator<Item = u64>> {
        Some(self.modules.get(module)?.iter().map(|position| u64::from(*position)))
    }

    /// The positions of the cycles in which a topic had messages.
    pub(super) fn messages(&self, topic: &str) -> Option<impl DoubleEndedIterator<Item = u64>> {
        let cycles = self.topics.get(topic.trim_start_matches('/'))?;
        Some(cycles.iter().map(|(position, _)| u64::from(*position)))
    }

    /// The last message of a topic before a position: its number, and its position.
    fn last_before(&self, topic: &str, position: u64) -> Option<(u64, u64)> {
        let cycles = self.topics.get(topic)?;
        let before = cycles.partition_point(|(at, _)| u64::from(*at) < position);
        let count: u64 = cycles.iter().take(before).map(|(_, count)| u64::from(*count)).sum();
        let (at, _) = cycles.get(before.checked_sub(1)?)?;
        Some((count.checked_sub(1)?, u64::from(*at)))
    }

    /// The position of the cycle with a message of a topic, by its number from 0.
    pub(super) fn message(&self, topic: &str, number: u64) -> Option<u64> {
        let mut before = 0;
        let cycles = self.topics.get(topic.trim_start_matches('/'))?;
        let has_it = |(_, count): &&(u32, u32)| {
            before += u64::from(*count);
            before > number
        };
        cycles.iter().find(has_it).map(|(position, _)| u64::from(*position))
    }
}

impl Travel {
    /// Starts an engine, which is this program with the same command line.
    pub(super) fn start() -> anyhow::Result<Self> {
        let folder = TempDir::with_prefix("downbeat_debug_").context("cannot create a folder for sockets")?;
        let path = folder.path().join("engines");
        let listener = UnixListener::bind(&path).with_context(|| path.display().to_string())?;
        let mut started = start_engine(path)?;
        let mut current = accept(&listener, &mut started, Duration::MAX)?;
        let about = match current.link.receive()? {
            Some(Report::About(about)) => *about,
            _ => bail!("the replay has ended before it began"),
        };
        Ok(Self {
            current,
            checkpoints: BTreeMap::new(),
            first: None,
            started,
            listener,
            folder,
            about,
            index: Index::default(),
            arrivals: 0,
            copies: 0,
        })
    }

    pub(super) fn about(&self) -> &About {
        &self.about
    }

    pub(super) fn position(&self) -> u64 {
        self.current.position
    }

    /// Runs the whole replay once. `progress` is called with the number of cycles so far, and ends the pass
    /// by returning false.
    pub(super) fn pass(&mut self, mut progress: impl FnMut(u64) -> bool) -> anyhow::Result<()> {
        self.current.link.send(&Order::Pass)?;
        loop {
            match self.current.link.receive()? {
                Some(Report::Passed(passed)) => {
                    self.index.add(passed);
                    self.take_checkpoints()?;
                    if !progress(self.index.end()) {
                        bail!("stopped");
                    }
                }
                Some(Report::Done { position, .. }) => {
                    self.current.position = position;
                    // That of the start may still be on its way.
                    while self.about.no_checkpoints.is_none() && self.checkpoints.is_empty() {
                        let engine = accept(&self.listener, &mut self.started, PATIENCE)?;
                        self.keep(engine);
                    }
                    return self.take_checkpoints();
                }
                Some(Report::Failed { problem }) => bail!("{problem}"),
                Some(other) => bail!("an engine said {other:?}"),
                None => bail!("the replay has crashed; its output is above"),
            }
        }
    }

    /// Goes to a position.
    pub(super) fn go(&mut self, to: u64) -> anyhow::Result<()> {
        if to == self.current.position {
            return Ok(());
        }
        self.start_from(to)?;
        let from = self.current.position;
        let is_missing = |at: &u64| *at > from && !self.checkpoints.contains_key(at);
        let checkpoints: Vec<u64> = match self.about.no_checkpoints {
            None => {
                BEFORE_GOAL.iter().filter_map(|before| to.checked_sub(*before)).filter(is_missing).collect()
            }
            Some(_) => Vec::new(),
        };
        self.arrivals += 1;
        let report = self.current.ask(&Order::Go { to, checkpoints })?;
        let Report::Done { position, .. } = report else { bail!("an engine said {report:?}") };
        self.current.position = position;
        self.take_checkpoints()
    }

    /// Makes the nearest engine before a position the current one.
    fn start_from(&mut self, to: u64) -> anyhow::Result<()> {
        let nearest = self.checkpoints.range_mut(..=to).next_back();
        let own = Some(self.current.position).filter(|position| *position <= to);
        let next = match nearest {
            Some((at, _)) if own.is_some_and(|own| own >= *at) => return Ok(()),
            Some((_, checkpoint)) => {
                self.copies += 1;
                checkpoint.engine.link.send(&Order::Fork { number: self.copies })?;
                self.await_engine(Role::Copy(self.copies), PATIENCE)?
            }
            None if own.is_some() => return Ok(()),
            None => return self.start_again(),
        };
        let old = std::mem::replace(&mut self.current, next);
        if old.process == self.started.id() {
            self.first = Some(old);
        }
        Ok(())
    }

    /// Waits for an engine. Checkpoints may connect before it.
    fn await_engine(&mut self, role: Role, patience: Duration) -> anyhow::Result<Engine> {
        loop {
            let engine = accept(&self.listener, &mut self.started, patience)?;
            if engine.role == role {
                return Ok(engine);
            }
            self.keep(engine);
        }
    }

    fn keep(&mut self, engine: Engine) {
        let checkpoint = Checkpoint { engine, arrival: self.arrivals };
        self.checkpoints.entry(checkpoint.engine.position).or_insert(checkpoint);
    }

    /// Without checkpoints: from the start.
    fn start_again(&mut self) -> anyhow::Result<()> {
        self.current.link.close();
        drop(self.first.take());
        self.started.wait().context("cannot end a replay")?;
        self.started = start_engine(self.folder.path().join("engines"))?;
        let mut engine = self.await_engine(Role::First, Duration::MAX)?;
        if !matches!(engine.link.receive()?, Some(Report::About(_))) {
            bail!("the replay has ended before it began");
        }
        self.current = engine;
        Ok(())
    }

    /// The position after the current one, up to `to`, at which a condition becomes true.
    pub(super) fn search_forwards(&mut self, condition: &str, to: u64) -> anyhow::Result<Option<u64>> {
        let order = Order::Search { condition: condition.to_owned(), to, stops: true };
        self.current.search(&order)
    }

    /// The last position before the current one at which a condition became true.
    pub(super) fn search_backwards(&mut self, condition: &str) -> anyhow::Result<Option<u64>> {
        let mut to = self.current.position.saturating_sub(1);
        while to > 0 {
            self.start_from(to - 1)?;
            let from = self.current.position;
            let order = Order::Search { condition: condition.to_owned(), to, stops: false };
            if let Some(found) = self.current.search(&order)? {
                return Ok(Some(found));
            }
            to = from;
        }
        Ok(None)
    }

    pub(super) fn cycle(&mut self) -> anyhow::Result<Cycle> {
        match self.current.ask(&Order::Show)? {
            Report::Cycle(cycle) => Ok(*cycle),
            other => bail!("an engine said {other:?}"),
        }
    }

    pub(super) fn message(&mut self, topic: &str) -> anyhow::Result<Option<Message>> {
        match self.current.ask(&Order::Print { topic: topic.to_owned() })? {
            Report::Message(message) => Ok(message),
            other => bail!("an engine said {other:?}"),
        }
    }

    pub(super) fn module(&mut self, name: &str) -> anyhow::Result<Module> {
        match self.current.ask(&Order::Module { name: name.to_owned() })? {
            Report::Module(module) => Ok(module),
            other => bail!("an engine said {other:?}"),
        }
    }

    #[cfg_attr(not(feature = "view"), expect(dead_code))]
    pub(super) fn graph(&mut self) -> anyhow::Result<Graph> {
        match self.current.ask(&Order::Graph)? {
            Report::Graph(graph) => Ok(*graph),
            other => bail!("an engine said {other:?}"),
        }
    }

    /// What was counted some time before, and what has been counted.
    #[cfg_attr(not(feature = "view"), expect(dead_code))]
    pub(super) fn snapshots(&mut self, window: Duration) -> anyhow::Result<[Snapshot; 2]> {
        let mut now = match self.current.ask(&Order::Snapshot)? {
            Report::Snapshot(snapshot) => *snapshot,
            other => bail!("an engine said {other:?}"),
        };
        let (index, position) = (&self.index, self.current.position);
        let time = index.time(position).unwrap_or(self.about.start_ns);
        let since_start = |time: i64| u64::try_from(time.saturating_sub(self.about.start_ns)).unwrap_or(0);
        now.uptime_ns = since_start(time);
        let window = i64::try_from(window.as_nanos()).unwrap_or(i64::MAX);
        let earlier = index.at(time.saturating_sub(window)).min(position);
        let mut before = now.clone();
        before.uptime_ns = since_start(index.time(earlier).unwrap_or(time));
        for module in &mut before.modules {
            let runs = index.modules.get(&module.name).map(|runs| {
                let until = |position| runs.partition_point(|run| u64::from(*run) <= position);
                until(position).saturating_sub(until(earlier))
            });
            module.runs = module.runs.saturating_sub(runs.unwrap_or(0) as u64);
        }
        for topic in &mut before.topics {
            let cycles = index.topics.get(&topic.name).into_iter().flatten();
            let since = cycles.filter(|(at, _)| (earlier + 1..=position).contains(&u64::from(*at)));
            let messages: u64 = since.map(|(_, count)| u64::from(*count)).sum();
            topic.messages = topic.messages.saturating_sub(messages);
        }
        Ok([before, now])
    }

    /// Takes in the copies that have connected, and lets those go that are too many.
    fn take_checkpoints(&mut self) -> anyhow::Result<()> {
        self.listener.set_nonblocking(true)?;
        let before = self.checkpoints.len();
        loop {
            match self.listener.accept() {
                Ok((stream, _)) => {
                    let engine = Engine::of(stream)?;
                    self.keep(engine);
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) => return Err(error.into()),
            }
        }
        self.listener.set_nonblocking(false)?;
        // To measure their memory takes longer than a thousand cycles.
        if self.checkpoints.len() > before {
            self.thin_out();
        }
        Ok(())
    }

    fn thin_out(&mut self) {
        let memory = |checkpoints: &BTreeMap<u64, Checkpoint>| -> u64 {
            checkpoints.values().map(|checkpoint| private_memory(checkpoint.engine.process)).sum()
        };
        let spread = |checkpoints: &BTreeMap<u64, Checkpoint>| -> Vec<u64> {
            checkpoints
                .iter()
                .filter(|(_, checkpoint)| checkpoint.engine.role == Role::Spread)
                .map(|(at, _)| *at)
                .collect()
        };
        let is_too_large =
            self.checkpoints.len().is_multiple_of(8) && memory(&self.checkpoints) > MOST_MEMORY;
        let all = spread(&self.checkpoints);
        if all.len() > MOST_SPREAD || (is_too_large && all.len() > 2) {
            for at in all.iter().skip(1).step_by(2) {
                self.checkpoints.remove(at);
            }
        }
        loop {
            let near = self.checkpoints.iter().filter(|(_, checkpoint)| checkpoint.engine.role == Role::Near);
            if near.clone().count() <= MOST_NEAR {
                break;
            }
            let Some(oldest) = near.min_by_key(|(_, checkpoint)| checkpoint.arrival).map(|(at, _)| *at)
            else {
                break;
            };
            self.checkpoints.remove(&oldest);
        }
    }
}

impl Drop for Travel {
    fn drop(&mut self) {
        self.current.link.close();
        if let Some(first) = &self.first {
            first.link.close();
        }
        let begin = Instant::now();
        while begin.elapsed() < END {
            if let Ok(Some(_)) = self.started.try_wait() {
                return;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        // It computes, and does not hear of the end.
        let _ = self.started.kill();
        let _ = self.started.wait();
    }
}

impl Engine {
    fn of(stream: UnixStream) -> anyhow::Result<Self> {
        stream.set_nonblocking(false)?;
        let mut link = Link::new(stream);
        match link.receive()? {
            Some(Report::Here { process, position, role }) => Ok(Self { link, process, position, role }),
            other => bail!("an engine said {other:?}"),
        }
    }

    fn ask(&mut self, order: &Order) -> anyhow::Result<Report> {
        self.link.send(order)?;
        match self.link.receive()? {
            Some(Report::Failed { problem }) => {
                // It may have gone on before it failed.
                self.link.send(&Order::Show)?;
                if let Some(Report::Cycle(cycle)) = self.link.receive()? {
                    self.position = cycle.position;
                }
                bail!("{problem}")
            }
            Some(report) => Ok(report),
            None => bail!("the replay has crashed"),
        }
    }

    fn search(&mut self, order: &Order) -> anyhow::Result<Option<u64>> {
        match self.ask(order)? {
            Report::Found { position, last } => {
                self.position = last;
                Ok(position)
            }
            other => bail!("an engine said {other:?}"),
        }
    }
}

fn start_engine(socket: PathBuf) -> anyhow::Result<Child> {
    let mut command = this_command()?;
    command.arg("--engine").arg(socket);
    // Signals of the terminal are for the debugger.
    command.process_group(0).stdin(Stdio::null()).stdout(Stdio::null());
    if std::env::var_os("DOWNBEAT_LOG").is_none() {
        // The same lines would come again and again.
        command.env("DOWNBEAT_LOG", "error");
    }
    command.spawn().context("cannot start the replay")
}

/// Waits for an engine to connect; the one that was started opens robot and bag before.
fn accept(listener: &UnixListener, started: &mut Child, patience: Duration) -> anyhow::Result<Engine> {
    listener.set_nonblocking(true)?;
    let begin = Instant::now();
    loop {
        match listener.accept() {
            Ok((stream, _)) => {
                listener.set_nonblocking(false)?;
                return Engine::of(stream);
            }
            Err(error) if error.kind() != ErrorKind::WouldBlock => return Err(error.into()),
            Err(_) => {}
        }
        if let Some(status) = started.try_wait()? {
            // It has said why.
            bail!("the replay has ended, {status}");
        }
        if begin.elapsed() > patience {
            bail!("a checkpoint does not answer");
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// The memory that a process shares with no other, in bytes; 0 where the system does not tell.
fn private_memory(process: u32) -> u64 {
    let Ok(text) = std::fs::read_to_string(format!("/proc/{process}/smaps_rollup")) else { return 0 };
    let lines = text.lines().filter(|line| line.starts_with("Private_"));
    let kilobytes = lines.filter_map(|line| line.split_whitespace().nth(1)?.parse::<u64>().ok());
    kilobytes.sum::<u64>() * 1024
}

/// Goals.
impl Travel {
    /// Goes to a goal; stays where it is if there is none.
    pub(super) fn go_to(&mut self, goal: &Goal) -> anyhow::Result<()> {
        let (here, end) = (self.position(), self.index.end());
        if end == 0 {
            bail!("the replay has no cycle");
        }
        let to = match goal {
            Goal::By(by) => {
                let to = here.checked_add_signed(*by).filter(|to| (1..=end).contains(to));
                to.with_context(|| match by {
                    1.. => format!("the bag ends {} cycles from here", end - here.min(end)),
                    _ => format!("the bag begins {} cycles before this one", here.saturating_sub(1)),
                })?
            }
            Goal::Run { name, is_back } => self.run_of(name, *is_back)?,
            Goal::Condition { expression, is_back } => {
                let found = match is_back {
                    true => self.search_backwards(expression)?,
                    false => self.search_forwards(expression, end)?,
                };
                let Some(found) = found else {
                    self.go(here)?;
                    bail!(
                        "{expression} does not become true {} this cycle",
                        if *is_back { "before" } else { "after" }
                    );
                };
                found
            }
            Goal::Time(into) => self.index.at(self.about.start_ns.saturating_add(*into)),
            Goal::Stamp(stamp) => self.index.at(*stamp),
            Goal::Cycle(cycle) => {
                let first = self.about.first_cycle;
                let to =
                    cycle.checked_sub(first).map(|cycle| cycle.saturating_add(1)).filter(|to| *to <= end);
                to.with_context(|| format!("the bag has the cycles #{first} to #{}", first + end - 1))?
            }
            Goal::Message { topic, number } => {
                self.index.message(topic, *number).with_context(|| match self.index.count(topic) {
                    0 => self.no_message(topic),
                    count => format!("{topic} has {count} messages, counted from 0"),
                })?
            }
            Goal::Difference => self
                .index
                .difference
                .as_ref()
                .map(|(at, _)| *at)
                .context("the replay does not differ from the bag")?,
            Goal::Start => 1,
            Goal::End => end,
        };
        self.go(to)
    }

    /// The messages that a module had received last before a cycle, with their times.
    pub(super) fn known_to(&self, module: &str, position: u64) -> Vec<(Messages, i64)> {
        let topics = self.about.subscriptions.get(module).into_iter().flatten();
        // Those of the cycle before are received in this one.
        let last = |topic: &String| {
            let (first, at) = self.index.last_before(topic, position.saturating_sub(1))?;
            Some((Messages { topic: topic.clone(), first, count: 1 }, self.index.time(at)?))
        };
        topics.filter_map(last).collect()
    }

    fn run_of(&self, name: &str, is_back: bool) -> anyhow::Result<u64> {
        let here = self.position();
        let (runs, messages) = (self.index.runs(name), self.index.messages(name));
        if runs.is_none() && messages.is_none() {
            bail!("{}", self.no_name(name));
        }
        let mut all = runs.into_iter().flatten().chain(messages.into_iter().flatten());
        let found = match is_back {
            true => all.filter(|at| *at < here).max(),
            false => all.find(|at| *at > here),
        };
        found.with_context(|| match is_back {
            true => format!("{name} has nothing before this cycle"),
            false => format!("{name} has nothing after this cycle"),
        })
    }

    pub(super) fn no_message(&self, topic: &str) -> String {
        match self.about.topics.contains_key(topic.trim_start_matches('/')) {
            true => format!("{topic} has had no message yet"),
            false => self.no_name(topic),
        }
    }

    pub(super) fn no_module(&self, name: &str) -> String {
        let left_out = self.about.notes.iter().find(|note| note.starts_with(name));
        left_out.cloned().unwrap_or_else(|| self.no_name(name))
    }

    fn no_name(&self, name: &str) -> String {
        let About { modules, detached, topics, .. } = &self.about;
        let known = modules.iter().chain(detached).chain(topics.keys()).map(String::as_str);
        let hint = suggestion(name, known);
        format!("there is no module or topic \"{name}\"{hint}; `list` lists them")
    }
}
