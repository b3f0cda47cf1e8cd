//! `[launcher]` in a robot file.

use std::fmt;
use std::num::NonZeroUsize;
use std::str::FromStr;
use std::time::Duration;

use downbeat_executor::{Idle, Spin, ThreadOptions};

use super::table::{Table, Value};
use super::{RobotFileError, suggestion};
use crate::Catalog;

type Result<T> = std::result::Result<T, RobotFileError>;

/// How the process phase runs and on which threads.
#[derive(Clone, Debug)]
pub struct LauncherEntry {
    pub(crate) line: usize,
    /// The number of threads.
    pub choice: LauncherChoice,
    /// CPUs and priority of the threads, including the thread of the core.
    pub threads: ThreadOptions,
    /// How the thread of the core waits while nothing is due.
    pub idle: Idle,
    /// How long a cycle may take before it is reported.
    pub deadline: Option<Duration>,
}

/// On how many threads the process phase runs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum LauncherChoice {
    /// On one thread.
    #[default]
    Linear,
    /// On this number of threads.
    Pool(NonZeroUsize),
    /// Each module on its own thread.
    Threads,
    /// With the launcher of that name, which the app has added.
    Other(String),
}

impl fmt::Display for LauncherChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Linear => f.write_str("on one thread"),
            Self::Pool(threads) => write!(f, "on {threads} threads"),
            Self::Threads => f.write_str("each module on its own thread"),
            Self::Other(name) => write!(f, "by the launcher \"{name}\""),
        }
    }
}

/// Parses the form used on the command line: `linear`, `pool`, `pool:4`, `threads`, or the name of a launcher
/// that the app has added.
impl FromStr for LauncherChoice {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (kind, threads) =
            text.split_once(':').map_or((text, None), |(kind, threads)| (kind, Some(threads)));
        let count = threads.map(|threads| threads.parse::<NonZeroUsize>().map_err(|_| threads));
        match (kind, count.transpose()) {
            ("linear", Ok(None)) => Ok(Self::Linear),
            ("threads", Ok(None)) => Ok(Self::Threads),
            ("pool", Ok(count)) => Ok(Self::Pool(count.unwrap_or_else(available))),
            ("linear" | "threads" | "pool", _) | (_, Err(_) | Ok(Some(_))) => {
                Err(format!("\"{text}\" is not a launcher; write linear, pool, pool:4 or threads"))
            }
            (name, Ok(None)) => Ok(Self::Other(name.to_owned())),
        }
    }
}

fn available() -> NonZeroUsize {
    std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN)
}

/// Reads `[launcher]`, or `launcher` and `threads` of `[robot]`.
pub(super) fn launcher<'a>(
    root: &mut Table<'a>,
    robot: &mut Table<'a>,
    catalog: &Catalog,
) -> Result<LauncherEntry> {
    let threads = robot.take("threads");
    let launcher = match (robot.take("launcher"), root.take("launcher")) {
        (Some(_), Some(value)) => {
            return Err(value.error("the launcher is given here and in [robot]; remove one of them"));
        }
        (value, None) | (None, value) => value,
    };
    let line = launcher.or(threads).map_or(robot.line(), |value| value.line());
    let plain = |choice| {
        let (threads, idle) = (ThreadOptions::default(), Idle::default());
        LauncherEntry { line, choice, threads, idle, deadline: None }
    };
    let Some(value) = launcher else { return Ok(plain(choice(None, threads, catalog)?)) };
    match (value.as_table("[launcher]"), threads) {
        (None, threads) => Ok(plain(choice(Some(value), threads, catalog)?)),
        (Some(_), Some(threads)) => {
            Err(threads.error("\"threads\" belongs into the table of the launcher, next to \"kind\""))
        }
        (Some(table), None) => detailed(table, line, catalog),
    }
}

fn detailed(mut table: Table<'_>, line: usize, catalog: &Catalog) -> Result<LauncherEntry> {
    let kind = table.require("kind")?;
    let choice = choice(Some(kind), table.take("threads"), catalog)?;
    let mut threads = thread(&mut table)?;
    if let Some(value) = table.take("spin") {
        if choice == LauncherChoice::Linear {
            return Err(value.error(
                "\"spin\" is for the threads of kind = \"pool\" or \"threads\"; for the thread of the core use \"idle\"",
            ));
        }
        threads.spin = spin(value)?;
    }
    let idle = match table.take("idle") {
        Some(value) => super::choice(value, &[("park", Idle::Park), ("spin", Idle::Spin)])?,
        None => Idle::default(),
    };
    let deadline = table.take("deadline").map(|value| value.duration()).transpose()?;
    table.finish()?;
    Ok(LauncherEntry { line, choice, threads, idle, deadline })
}

fn choice(
    launcher: Option<Value<'_>>,
    threads: Option<Value<'_>>,
    catalog: &Catalog,
) -> Result<LauncherChoice> {
    let threads = threads.map(|value| value.count().map(|count| (value, count))).transpose()?;
    let kind = launcher.map(|value| value.text().map(|text| (value, text))).transpose()?;
    match (kind, threads) {
        (None | Some((_, "linear")), None) => Ok(LauncherChoice::Linear),
        (Some((_, "threads")), None) => Ok(LauncherChoice::Threads),
        (None | Some((_, "linear" | "threads")), Some((value, _))) => {
            Err(value.error("only the launcher \"pool\" has a number of \"threads\""))
        }
        (Some((_, "pool")), threads) => {
            let threads = threads.and_then(|(_, count)| NonZeroUsize::new(count as usize));
            Ok(LauncherChoice::Pool(threads.unwrap_or_else(available)))
        }
        (Some((_, other)), None) if catalog.launchers().any(|known| known == other) => {
            Ok(LauncherChoice::Other(other.to_owned()))
        }
        (Some((value, other)), _) => {
            let hint = suggestion(other, catalog.launchers());
            Err(value.error(format!("unknown launcher \"{other}\"{hint}")))
        }
    }
}

/// Reads `cpus` and `priority` of a thread.
pub(super) fn thread(table: &mut Table<'_>) -> Result<ThreadOptions> {
    let mut options = ThreadOptions::default();
    if let Some(value) = table.take("cpus") {
        let cpu = |value: &Value<'_>| value.number_in(0..=65_535, "the number of a CPU, from 0");
        options.cpus = value.list()?.iter().map(cpu).collect::<Result<Vec<usize>>>()?;
        if options.cpus.is_empty() {
            return Err(value.error("expected the numbers of CPUs, found none; omit \"cpus\" for all CPUs"));
        }
    }
    if let Some(value) = table.take("priority") {
        let what = "a SCHED_FIFO priority from 1, the lowest, to 99";
        options.fifo_priority = Some(value.number_in(1..=99, what)?);
    }
    Ok(options)
}

fn spin(value: Value<'_>) -> Result<Spin> {
    match value.text()? {
        "auto" => Ok(Spin::Auto),
        "never" => Ok(Spin::Never),
        "always" => Ok(Spin::Always),
        text if text.starts_with(|c: char| c.is_ascii_digit()) => Ok(Spin::For(value.duration()?)),
        other => {
            let hint = suggestion(other, ["auto", "never", "always"]);
            Err(value
                .error(format!("unknown choice \"{other}\"{hint} A time such as \"50us\" is also valid")))
        }
    }
}
