//! The report of a replay.

use std::fmt;
use std::time::Duration;

use downbeat_bags::FieldDifference;
use downbeat_executor::Time;

use crate::ChangedSetting;
use crate::{TestResult, journal};

/// What was replayed and how it differs from the bag.
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayReport {
    /// The robot's name.
    pub robot: String,
    /// The modules that ran together inside the cycle.
    pub modules: Vec<String>,
    /// Number of cycles that they ran.
    pub cycles: u64,
    /// True if the bag contains the times of the cycles.
    pub has_recorded_cycles: bool,
    /// The detached modules with the number of their runs.
    pub detached: Vec<(String, usize)>,
    /// The modules that were not replayed.
    pub left_out: Vec<LeftOut>,
    /// The modules in other languages whose sources are not as they were when the bag was recorded.
    pub changed_sources: Vec<String>,
    /// Sentences about modules that were replaced by newer versions during the recording, and about versions
    /// that are missing.
    pub versions: Vec<String>,
    /// The settings that the robot file or the command line give other values than the recording began with.
    pub changed_settings: Vec<ChangedSetting>,
    /// The topics that the modules inside the cycle received from the bag.
    pub inputs: Vec<String>,
    /// The topics that they received during the recording and that are not in the bag. Includes
    /// `module_settings` and `module_events` if the bag lacks them: changed settings, requests, commands and
    /// results of jobs are then not repeated; and `cycle_messages` if the bag was recorded in simulated time
    /// without it: messages then join in the first cycle at their time.
    pub missing_inputs: Vec<String>,
    /// The topics that were compared.
    pub topics: Vec<TopicReport>,
    /// The topics of the bag and of the replayed modules that were not compared.
    pub not_compared: Vec<NotCompared>,
    /// Time of the first message of the bag, nanoseconds since the epoch.
    pub bag_start: i64,
    /// Duration of the bag.
    pub bag_duration: Duration,
    /// Duration of the replay.
    pub took: Duration,
}

/// A module that was not replayed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeftOut {
    /// Its name.
    pub module: String,
    /// The reason, as a message.
    pub reason: String,
}

/// The comparison of one topic.
#[derive(Clone, Debug, PartialEq)]
pub struct TopicReport {
    /// With the leading slash.
    pub topic: String,
    /// The replayed modules that publish it.
    pub modules: Vec<String>,
    /// True if a rule accepts any message on the topic.
    pub is_ignored: bool,
    /// Number of compared messages.
    pub compared: u64,
    /// Number of different messages.
    pub different: u64,
    /// The first difference.
    pub first: Option<Difference>,
}

/// A message that differs.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// With the leading slash.
    pub topic: String,
    /// Number of the message on the topic, from 0.
    pub number: u64,
    /// Time at which it was recorded, nanoseconds since the epoch; if it was not recorded, time at which it
    /// was replayed.
    pub time: i64,
    /// The kind of difference.
    pub what: What,
}

/// How a message differs.
#[derive(Clone, Debug, PartialEq)]
pub enum What {
    /// A field differs: the first value was recorded, the second replayed.
    Field(FieldDifference),
    /// It was published in another cycle.
    Time {
        /// Time of that cycle, nanoseconds since the epoch.
        replayed: i64,
    },
    /// The message was recorded but not published in the replay.
    Missing,
    /// The message was published in the replay but not recorded.
    Extra,
}

/// The topics that a replay must have compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strictness {
    /// Any topic.
    AnyTopic,
    /// Every topic that the chosen modules publish, except for excluded topics and topics of plain Rust
    /// types.
    EveryTopic,
}

/// A topic of the bag, or of the replayed modules, that was not compared.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NotCompared {
    /// With the leading slash.
    pub topic: String,
    /// The reason.
    pub reason: NotComparedReason,
}

/// Why a topic was not compared.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NotComparedReason {
    /// No module of the robot publishes the topic: its messages came from outside.
    Input,
    /// The topic describes the recorded run itself.
    Journal,
    /// The process publishes the topic, not a module of the robot file.
    Process,
    /// All modules that publish the topic were not chosen.
    NotChosen {
        /// The modules that publish it.
        modules: Vec<String>,
    },
    /// All modules that publish the topic cannot be replayed.
    LeftOut {
        /// The modules that publish it.
        modules: Vec<String>,
    },
    /// Excluded by [`ReplayOptions::except`](super::ReplayOptions::except).
    Excluded,
    /// The messages have a plain Rust type, which cannot be recorded.
    PlainType {
        /// The type.
        rust_type: String,
    },
    /// A service that is called between modules, one of them detached, has plain Rust types, which cannot be
    /// recorded.
    PlainService {
        /// The types of request and response.
        rust_types: String,
    },
    /// The messages of the bag cannot be read.
    Unreadable {
        /// The reason.
        problem: String,
    },
    /// Replayed modules publish the topic, but the bag lacks it.
    NotInBag {
        /// The modules that publish it.
        modules: Vec<String>,
    },
    /// Replayed modules publish the topic, but there was no message, neither recorded nor replayed.
    NoMessages,
}

impl NotCompared {
    /// Returns whether the topic should have been compared, because replayed or chosen modules publish it. A
    /// [strict](ReplayReport::assert_same) comparison then fails.
    #[must_use]
    pub fn is_gap(&self) -> bool {
        use NotComparedReason as Why;
        matches!(self.reason, Why::LeftOut { .. } | Why::Unreadable { .. } | Why::NotInBag { .. })
    }
}

impl ReplayReport {
    /// Returns the number of different messages.
    #[must_use]
    pub fn different(&self) -> u64 {
        self.topics.iter().map(|topic| topic.different).sum()
    }

    /// Returns the number of compared messages, without ignored topics.
    #[must_use]
    pub fn compared(&self) -> u64 {
        self.topics.iter().filter(|topic| !topic.is_ignored).map(|topic| topic.compared).sum()
    }

    /// The topics of the chosen modules that should have been compared and were not.
    pub fn gaps(&self) -> impl Iterator<Item = &NotCompared> {
        self.not_compared.iter().filter(|topic| topic.is_gap())
    }

    /// For tests: fails unless the replay equals the bag on every topic of the chosen modules, except for
    /// topics excluded by [`ReplayOptions::except`](super::ReplayOptions::except) and topics of plain Rust
    /// types.
    ///
    /// # Errors
    /// Returns an error if a message differs, nothing was compared, or a topic of the chosen modules was not
    /// compared. The error prints the report.
    pub fn assert_same(self) -> TestResult {
        Ok(self.check(Strictness::EveryTopic)?)
    }

    /// Fails unless the replay equals the bag.
    ///
    /// # Errors
    /// Returns an error if a message differs, nothing was compared, or a topic that `strictness` requires was
    /// not compared.
    pub fn check(self, strictness: Strictness) -> Result<(), NotSame> {
        let mut problems = Vec::new();
        let topics = self.topics.iter().filter(|topic| topic.different > 0).count();
        if topics > 0 {
            let different = self.different();
            problems
                .push(format!("the replay differs from the bag in {different} messages on {topics} topics"));
        }
        if self.compared() == 0 {
            problems.push(
                "the replay compared nothing: no message of the replayed modules is in the bag".to_owned(),
            );
        }
        let gaps: Vec<String> = self.gaps().map(ToString::to_string).collect();
        if strictness == Strictness::EveryTopic && !gaps.is_empty() {
            problems
                .push(format!("not all topics of the replayed modules were compared: {}", gaps.join("; ")));
        }
        match problems.is_empty() {
            true => Ok(()),
            false => Err(NotSame { report: Box::new(self), problem: problems.join("; ") }),
        }
    }

    /// Returns the earliest difference.
    #[must_use]
    pub fn first_difference(&self) -> Option<&Difference> {
        self.topics.iter().filter_map(|topic| topic.first.as_ref()).min_by_key(|difference| difference.time)
    }
}

/// Error of a replay that differs from its bag. Both `Display` and `Debug` print the report, so that a test
/// that returns the error shows the differences.
#[must_use = "the replay is not the same as the bag"]
pub struct NotSame {
    report: Box<ReplayReport>,
    problem: String,
}

impl NotSame {
    /// What was replayed, and where it differs.
    #[must_use]
    pub fn report(&self) -> &ReplayReport {
        &self.report
    }

    /// Returns the problem as a sentence.
    #[must_use]
    pub fn problem(&self) -> &str {
        &self.problem
    }
}

impl fmt::Display for NotSame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}\n{}", self.problem, self.report)
    }
}

impl fmt::Debug for NotSame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl std::error::Error for NotSame {}

impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.module, self.reason)
    }
}

/// Formats the report as `downbeat` prints it.
impl fmt::Display for ReplayReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (seconds, took) = (self.bag_duration.as_secs_f64(), self.took.as_secs_f64());
        let times = seconds / took.max(1e-9);
        writeln!(
            f,
            "replayed {seconds:.3} s of {} in {took:.3} s, {times:.0} times as fast as it was recorded",
            self.robot
        )?;
        if !self.modules.is_empty() {
            let exact = if self.has_recorded_cycles { "" } else { ", whose times are not in the bag" };
            writeln!(f, "  {} in {} cycles{exact}", self.modules.join(", "), self.cycles)?;
        }
        for (module, runs) in &self.detached {
            writeln!(f, "  {module} in {runs} separate runs")?;
        }
        for left_out in &self.left_out {
            writeln!(f, "  not {left_out}")?;
        }
        for module in &self.changed_sources {
            writeln!(f, "  the source of {module} has changed since the recording")?;
        }
        for note in &self.versions {
            writeln!(f, "  {note}")?;
        }
        for changed in &self.changed_settings {
            writeln!(f, "  {changed}")?;
        }
        for topic in &self.missing_inputs {
            let lost = match topic.as_str() {
                journal::SETTINGS => ": changed settings are not repeated",
                journal::EVENTS => {
                    ": requests from outside, transitions and results of jobs are not repeated"
                }
                journal::MESSAGES => ": messages join in the first cycle at their time",
                _ => "",
            };
            writeln!(f, "  without /{topic}, which is not in the bag{lost}")?;
        }
        let width = self.topics.iter().map(|topic| topic.topic.len()).max().unwrap_or(0).max(5);
        writeln!(f, "\n  {:<width$}  {:>9}  {:>9}", "topic", "compared", "different")?;
        for topic in &self.topics {
            let note = if topic.is_ignored { "  (ignored)" } else { "" };
            let TopicReport { topic, compared, different, .. } = topic;
            writeln!(f, "  {topic:<width$}  {compared:>9}  {different:>9}{note}")?;
        }
        if !self.not_compared.is_empty() {
            writeln!(f, "\n  not compared:")?;
            let width = self.not_compared.iter().map(|topic| topic.topic.len()).max().unwrap_or(0);
            for NotCompared { topic, reason } in &self.not_compared {
                writeln!(f, "  {topic:<width$}  {reason}")?;
            }
        }
        if let Some(difference) = self.first_difference() {
            let into = Duration::from_nanos(u64::try_from(difference.time - self.bag_start).unwrap_or(0));
            let time = Time::from_nanos(difference.time);
            writeln!(f, "\nfirst difference: {time}, {:.6} s into the bag", into.as_secs_f64())?;
            write!(f, "{difference}")?;
        }
        Ok(())
    }
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "  {} message {}", self.topic, self.number)?;
        match &self.what {
            What::Field(FieldDifference { path, first, second }) => {
                writeln!(f, "  {path}\n    recorded {first}\n    replayed {second}")
            }
            What::Time { replayed } => {
                let (recorded, replayed) = (Time::from_nanos(self.time), Time::from_nanos(*replayed));
                writeln!(
                    f,
                    "  the time at which it was published\n    recorded {recorded}\n    replayed {replayed}"
                )
            }
            What::Missing => writeln!(f, "    recorded\n    replayed not at all"),
            What::Extra => writeln!(f, "    recorded not at all\n    replayed"),
        }
    }
}

impl fmt::Display for NotComparedReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Input => write!(f, "input, no module of the robot publishes it"),
            Self::Journal => write!(f, "the recording's own account of the run"),
            Self::Process => write!(f, "published by the process, not by a module"),
            Self::NotChosen { modules } => {
                write!(f, "published by {}, which {} not chosen", modules.join(", "), are(modules))
            }
            Self::LeftOut { modules } => {
                write!(f, "published by {}, which {} not replayed", modules.join(", "), are(modules))
            }
            Self::Excluded => write!(f, "excluded"),
            Self::PlainType { rust_type } => {
                write!(f, "messages of the plain Rust type {rust_type} are in no bag")
            }
            Self::PlainService { rust_types } => {
                write!(f, "calls of the plain Rust types {rust_types} are in no bag")
            }
            Self::Unreadable { problem } => write!(f, "{problem}"),
            Self::NotInBag { modules } => {
                write!(f, "published by {}, but the bag lacks the topic", modules.join(", "))
            }
            Self::NoMessages => write!(f, "no messages, neither recorded nor replayed"),
        }
    }
}

impl fmt::Display for NotCompared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.topic, self.reason)
    }
}

fn are(modules: &[String]) -> &'static str {
    if modules.len() == 1 { "was" } else { "were" }
}
