//! Bags as input of a core: the same bag gives the same result each time.

mod extract;
pub(crate) mod settings;
mod steps;

use std::collections::BTreeMap;

use downbeat_bags::{BagMessage, Reader, ReaderError, RecordedTopic, Selection, TopicId};
use downbeat_bridge::edge::{EncodedInlet, EncodedInletError, Interfaces};
use downbeat_executor::{Clock, Core, ManualClock, RunError, SetupError, Time, TopicInfo};
use downbeat_msgs::encoding;

use crate::encoding::{RecordedType, RecordedTypeError};

pub(crate) use extract::{Extract, ReadError};
pub use settings::SettingsError;
pub(crate) use steps::replay_steps;
pub use steps::{ReplayError, ReplayedSteps, replay_module};

/// Why a bag cannot be played into a core.
#[derive(Debug, thiserror::Error)]
pub enum PlaybackError {
    /// The bag cannot be read.
    #[error(transparent)]
    Bag(#[from] ReaderError),
    /// A topic that was asked for is not there.
    #[error("topic \"{topic}\" is not in the bag; it has {}", known.join(", "))]
    NoSuchTopic {
        /// The topic.
        topic: String,
        /// The topics of the bag.
        known: Vec<String>,
    },
    /// No module takes anything from the bag.
    #[error("the bag has no message that the robot's modules receive and do not publish themselves")]
    NothingToPlay,
    /// Messages of the bag would mix with a module's.
    #[error("a module of the robot publishes \"{0}\" itself; remap it there, or leave that module out")]
    IsPublished(String),
    /// The type is not registered, or its messages are in an encoding that is not read here.
    #[error(transparent)]
    Type(#[from] RecordedTypeError),
    /// A message is not what its encoding says.
    #[error(transparent)]
    Encoding(#[from] encoding::Error),
    /// The core has the topic with another type.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// A message is not of its topic's type.
    #[error(transparent)]
    Message(#[from] EncodedInletError),
    /// The core does not run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Modules answer each other without end, and the bag's time cannot go on.
    #[error("at {0} the modules still had work after {MOST_CYCLES} cycles without time going on")]
    Restless(Time),
}

/// Cycles at one instant of the bag.
const MOST_CYCLES: u32 = 10_000;

/// Plays a bag into a core: its clock follows the bag, timers fire between the messages at their exact times,
/// and messages of one time are given in the order of the bag. It takes no longer than the modules need.
///
/// Played are `topics`, or if there are none, those of the bag that modules receive and none publishes. Returns
/// the number of messages played. The core's modules are stopped at the end.
///
/// # Errors
/// If the bag cannot be read, a topic or type is not known, or the modules do not come to rest.
pub fn play_into(
    core: &mut Core,
    clock: &ManualClock,
    reader: &Reader,
    topics: &[String],
    interfaces: &Interfaces,
) -> Result<u64, PlaybackError> {
    let inlets = inlets(core, reader, topics, interfaces)?;
    let selection = Selection::all().topics(inlets.keys().copied());
    let mut played = 0;
    for message in reader.messages(selection)? {
        let BagMessage { topic, log_time, data, .. } = message?;
        run_until(core, clock, Time::from_nanos(log_time))?;
        if let Some((inlet, recorded)) = inlets.get(&topic) {
            inlet.publish(&recorded.to_cdr(data)?)?;
            played += 1;
        }
    }
    if played == 0 {
        return Err(PlaybackError::NothingToPlay);
    }
    run_until(core, clock, Time::from_nanos(reader.end_time().unwrap_or(0)))?;
    core.stop();
    Ok(played)
}

/// Runs what is due before `end`, then moves the clock there.
pub(crate) fn run_until(core: &mut Core, clock: &ManualClock, end: Time) -> Result<(), PlaybackError> {
    let (mut instant, mut cycles) = (clock.now(), 0);
    while let Some(event) = core.next_event().filter(|&event| event < end || event == clock.now()) {
        clock.set(event);
        core.cycle()?;
        cycles = if event == instant { cycles + 1 } else { 0 };
        instant = event;
        if cycles > MOST_CYCLES {
            return Err(PlaybackError::Restless(instant));
        }
    }
    clock.set(end);
    Ok(())
}

fn inlets(
    core: &mut Core,
    reader: &Reader,
    topics: &[String],
    interfaces: &Interfaces,
) -> Result<BTreeMap<TopicId, (EncodedInlet, RecordedType)>, PlaybackError> {
    let known = || reader.topics().iter().map(|topic| topic.info.name.clone()).collect();
    let mut inlets = BTreeMap::new();
    if topics.is_empty() {
        for topic in reader.topics() {
            let name = topic.info.name.trim_start_matches('/');
            let is_wanted = core.topics().any(|known| *known.name == *name && !known.is_published);
            if let (true, Some(id)) = (is_wanted, reader.topic(&topic.info.name)) {
                inlets.insert(id, open(core, name, topic, interfaces)?);
            }
        }
        return Ok(inlets);
    }
    for topic in topics {
        let absolute = format!("/{}", topic.trim_start_matches('/'));
        let Some(id) = reader.topic(&absolute) else {
            return Err(PlaybackError::NoSuchTopic { topic: topic.clone(), known: known() });
        };
        let is_published = |known: &TopicInfo| *known.name == absolute[1..] && known.is_published;
        if core.topics().any(is_published) {
            return Err(PlaybackError::IsPublished(topic.clone()));
        }
        inlets.insert(id, open(core, &absolute, &reader.topics()[id.index()], interfaces)?);
    }
    Ok(inlets)
}

fn open(
    core: &mut Core,
    name: &str,
    topic: &RecordedTopic,
    interfaces: &Interfaces,
) -> Result<(EncodedInlet, RecordedType), PlaybackError> {
    let recorded = RecordedType::of(topic, interfaces)?;
    Ok((interfaces.inlet(core, name, recorded.message_type())?, recorded))
}
