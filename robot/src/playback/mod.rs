//! Playback of bags into a core. The same bag always gives the same result.

pub(crate) mod cycles;
pub(crate) mod events;
pub(crate) mod journals;
mod runs;
mod steps;

use downbeat_bags::{Reader, ReaderError};
use downbeat_edge::{EncodedInletError, Interfaces};
use downbeat_executor::{Core, ManualClock, RunError, SetupError, Time};
use downbeat_msgs::encoding;

use crate::ReplayedTime;
use crate::encoding::RecordedTypeError;
use crate::journal;
use cycles::{Follower, Inputs};
use events::Events;
use journals::{Cycles, Extract, SettingsChanges};

pub use runs::recorded_runs;
pub use steps::{ReplayedSteps, replay_module};
pub(crate) use steps::{StepFollower, first_step, replay_steps};

/// Error while playing a bag into a core, or replaying a module from its recorded runs.
#[derive(Debug, thiserror::Error)]
pub enum PlaybackError {
    /// The bag cannot be read.
    #[error(transparent)]
    Bag(#[from] ReaderError),
    /// A requested topic is not in the bag.
    #[error("topic \"{topic}\" is not in the bag; it has {}", known.join(", "))]
    NoSuchTopic {
        /// The topic.
        topic: String,
        /// The topics of the bag.
        known: Vec<String>,
    },
    /// No module receives a message of the bag.
    #[error("the bag has no message that the robot's modules receive and do not publish themselves")]
    NothingToPlay,
    /// A module publishes a topic that would be played from the bag.
    #[error("a module of the robot publishes \"{0}\" itself; remap it there, or leave that module out")]
    IsPublished(String),
    /// The recorded cycle times have a gap.
    #[error("the bag lacks the times of cycles {expected} to {found}: messages of /cycle_times were lost")]
    CyclesLost {
        /// The first missing cycle.
        expected: u64,
        /// The first cycle after the gap.
        found: u64,
    },
    /// A message that describes the recorded run does not match the type of its topic, or cannot be replayed.
    #[error("a message of /{topic}: {problem}")]
    Journal {
        /// The topic, without the leading slash.
        topic: &'static str,
        /// The decoding error.
        problem: String,
    },
    /// The bag does not contain the runs of the module.
    #[error("the bag has no runs of a module \"{0}\" on /module_steps; record that topic too")]
    NoSteps(String),
    /// The module received a message that the bag does not contain.
    #[error("run {step} received a message of \"{topic}\" that is not in the bag; record that topic too")]
    MissingInput {
        /// The run.
        step: u64,
        /// The topic.
        topic: String,
    },
    /// The first recorded run received messages, which the first run of a module cannot.
    #[error("the first run of the module in the bag is not its start; record it from the start")]
    NotFromStart,
    /// The type is not registered, or the encoding of its messages is not supported.
    #[error(transparent)]
    Type(#[from] RecordedTypeError),
    /// A message is not valid in its encoding.
    #[error(transparent)]
    Encoding(#[from] encoding::Error),
    /// The topic has another type in the core.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// A message does not have the type of its topic.
    #[error(transparent)]
    Message(#[from] EncodedInletError),
    /// The core failed to run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Modules answer each other endlessly, so that the time of the bag cannot advance.
    #[error("at {0} the modules still had work after {MOST_CYCLES} cycles in which time did not advance")]
    Restless(Time),
}

impl PlaybackError {
    fn journal(topic: &'static str, problem: impl ToString) -> Self {
        Self::Journal { topic, problem: problem.to_string() }
    }
}

/// The most cycles at one time of the bag.
const MOST_CYCLES: u32 = 10_000;

/// Plays a bag into a core, whose clock is at or before [`start_time`]. If the bag contains the cycle times
/// of the robot in which it was recorded, the core runs the same cycles at the same times and each message
/// joins in the cycle in which it was recorded; so do changed settings, requests and responses from outside,
/// commands to modules and results of jobs. Otherwise the clock follows the messages, and timers fire between
/// them at their exact times. Messages with the same time are published in the order of the bag. Playback
/// runs as fast as the modules allow.
///
/// Plays `topics`, or, if there are none, the topics of the bag that modules receive and no module publishes.
/// Returns the number of played messages. The modules of the core are stopped at the end.
///
/// # Errors
/// Returns an error if the bag cannot be read, a topic or type is not known, or the modules do not come to
/// rest.
pub fn play_into(
    core: &mut Core,
    clock: &ManualClock,
    reader: &Reader,
    topics: &[String],
    interfaces: &Interfaces,
) -> Result<u64, PlaybackError> {
    let topics = played_topics(core, reader, topics)?;
    let mut extract = Extract::new(interfaces);
    extract.read_journals(reader)?;
    let inputs = Inputs::open(core, reader, topics.iter().map(String::as_str), [], &mut extract)?;
    let cycles = match Cycles::read(reader, &mut extract)? {
        Cycles::OfMessages => Cycles::Unknown,
        cycles => cycles,
    };
    let (mut settings, mut events) = Default::default();
    if cycles.is_recorded() {
        let modules = core.modules();
        let is_there = |name: &str| modules.iter().any(|module| *module.name == *name);
        settings = SettingsChanges::read(reader, &mut extract, &cycles, is_there)?;
        let recorded = extract.messages(reader, journal::EVENTS)?;
        events = Events::of_core(core, recorded.as_deref(), interfaces, None)?;
    }
    let has_events = !events.is_empty();
    let reached = ReplayedTime::default();
    let mut follower = Follower::new(reader, &cycles, clock.clone(), inputs, settings, events, reached)?;
    follower.run(core, |_| {})?;
    match follower.inputs.given() {
        0 if !has_events => Err(PlaybackError::NothingToPlay),
        played => Ok(played),
    }
}

/// Returns the time of the first cycle of a bag, or of its first message if it contains no cycle times.
///
/// # Errors
/// Returns an error if the bag cannot be read.
pub fn start_time(reader: &Reader) -> Result<Time, PlaybackError> {
    let first_cycle = Cycles::read(reader, &mut Extract::new(&Interfaces::carried()))?.first();
    Ok(Time::from_nanos(first_cycle.into_iter().chain(reader.start_time()).min().unwrap_or(0)))
}

/// Returns the names of the played topics without the leading slash.
fn played_topics(core: &Core, reader: &Reader, topics: &[String]) -> Result<Vec<String>, PlaybackError> {
    let is_known = |name: &str, is_published: bool| {
        core.topics().any(|known| *known.name == *name && known.is_published == is_published)
    };
    if topics.is_empty() {
        let names = reader.topics().iter().map(|topic| topic.info.name.trim_start_matches('/').to_owned());
        return Ok(names.filter(|name| is_known(name, false)).collect());
    }
    let chosen = topics.iter().map(|topic| {
        let name = topic.trim_start_matches('/');
        if reader.topic(&format!("/{name}")).is_none() {
            let known = reader.topics().iter().map(|topic| topic.info.name.clone()).collect();
            return Err(PlaybackError::NoSuchTopic { topic: topic.clone(), known });
        }
        match is_known(name, true) {
            true => Err(PlaybackError::IsPublished(topic.clone())),
            false => Ok(name.to_owned()),
        }
    });
    chosen.collect()
}
