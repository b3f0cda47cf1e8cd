//! A bag as a test: a robot's modules run again on what they received, and what they publish is compared with what they
//! published then.
//!
//! Modules that run inside the cycle are run together, in the cycles that the bag tells (`cycle_times`) at their very
//! times; what others published, and what came from ROS 2, joins in the cycle in which it joined then. Each detached
//! module is run by itself, by its recorded runs (`module_steps`). As no module sees of another more than its messages,
//! a robot whose parts all repeat bit for bit does so as a whole. Modules that drive a device run on the recorded answers
//! of the device, if their kind records these; else they are left out, and what they published is input.
//!
//! Modules inside the cycle are compared until the robot began to stop, detached ones to their end.
//!
//! Settings that were changed while the robot ran (`module_settings`) change again where they did. So do requests from outside,
//! answers from outside, commands to modules and results of jobs (`module_events`); what the modules answer and whom they call is
//! compared.

mod calls;
mod comparison;
mod coverage;
mod plan;
mod report;
mod runs;

use std::time::Instant;

use downbeat_bags::{FieldRule, Reader};
use downbeat_bridge::expose::TopicPattern;
use downbeat_executor::SetupError;

use crate::journal;
use crate::playback::PlaybackError;
use crate::robot::{ReplaySection, RobotFile, RobotFileError};
use calls::Calls;
use comparison::Comparisons;
use plan::Plan;

pub use coverage::{NotCompared, NotComparedReason};
pub use report::{Difference, LeftOut, NotSame, ReplayReport, Strictness, TopicReport, What};

/// What to replay and how exactly to compare.
#[derive(Clone, Debug, Default)]
pub struct ReplayOptions {
    /// Only these modules; what the others published is input. Empty: all that can be.
    pub modules: Vec<String>,
    /// How exactly fields are compared: bit for bit where no rule says otherwise.
    pub rules: Vec<FieldRule>,
    /// Topics that are not compared.
    pub except: Vec<TopicPattern>,
}

impl ReplayOptions {
    /// As `[replay]` of a robot file says.
    #[must_use]
    pub fn of(file: &RobotFile) -> Self {
        let ReplaySection { modules, rules, except } = file.replay.clone();
        Self { modules, rules, except }
    }

    fn excludes(&self, topic: &str) -> bool {
        self.except.iter().any(|pattern| pattern.matches(topic))
    }
}

/// Why a bag cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The robot file does not describe a robot.
    #[error(transparent)]
    Robot(#[from] RobotFileError),
    /// A module was asked for that the robot does not have.
    #[error("the robot has no module \"{module}\"; it has {}", known.join(", "))]
    NoSuchModule {
        /// What was asked for.
        module: String,
        /// What there is.
        known: Vec<String>,
    },
    /// A module was asked for that cannot be replayed from this bag.
    #[error("module \"{0}\" cannot be replayed: {1}")]
    NotReplayable(String, String),
    /// No module can be replayed, or none publishes anything that the bag has.
    #[error("there is nothing to replay: {0}")]
    Nothing(String),
    /// What a module received cannot be told from what it published.
    #[error(
        "topic \"{topic}\" is received by modules that are replayed and published by them and by others; the bag does not \
         say who published a message. Replay other modules than {}", modules.join(", ")
    )]
    SharedInput {
        /// The topic.
        topic: String,
        /// The modules that are replayed and publish it.
        modules: Vec<String>,
    },
    /// The recorded answers of a device cannot be used.
    #[error("module \"{module}\" cannot have its device's recorded answers: {problem}")]
    Device {
        /// The module.
        module: String,
        /// What is wrong with them.
        problem: String,
    },
    /// A detached module cannot be replayed.
    #[error("module \"{module}\": {source}")]
    Steps {
        /// The module.
        module: String,
        /// Why not.
        source: Box<PlaybackError>,
    },
    /// The modules cannot be played to.
    #[error(transparent)]
    Playback(#[from] PlaybackError),
    /// The core does not take the modules.
    #[error(transparent)]
    Setup(#[from] SetupError),
}

/// Runs a robot's modules on a bag, as fast as they can, and compares what they publish with what the bag has.
///
/// # Errors
/// If the bag cannot be replayed. That the replay differs, or compared nothing, is no error: the report tells it, and
/// [`ReplayReport::assert_same`] makes an error of it.
pub fn replay(
    file: RobotFile,
    reader: &Reader,
    options: &ReplayOptions,
) -> Result<ReplayReport, ReplayError> {
    let started = Instant::now();
    let file = file.on_any_machine();
    let (plan, mut extract) = Plan::make(&file, reader, options)?;
    let mut comparisons = Comparisons::new(reader, &plan, &options.rules, &file.catalog.interfaces)?;
    let mut calls = Calls::default();
    if let Some(events) = extract.messages(reader, journal::EVENTS)? {
        calls.recorded(&plan, &events);
    }
    let mut runs = Vec::new();
    for name in &plan.detached {
        runs.push((
            name.clone(),
            runs::detached(&file, reader, &plan, &mut extract, name, &mut comparisons, &mut calls)?,
        ));
    }
    let cycles = if plan.attached.is_empty() {
        0
    } else {
        runs::attached(&file, reader, &plan, &mut extract, &mut comparisons, &mut calls)?
    };
    let mut topics = comparisons.finish()?;
    topics.extend(calls.finish(&plan, &options.rules));
    let mut not_compared = plan.not_compared;
    coverage::move_empty(&mut topics, &mut not_compared);
    Ok(ReplayReport {
        robot: file.name.clone(),
        modules: plan.attached,
        cycles,
        has_recorded_cycles: plan.cycles.is_recorded(),
        detached: runs,
        left_out: plan.left_out,
        inputs: plan.inputs.into_iter().collect(),
        missing_inputs: plan.missing_inputs.into_iter().collect(),
        topics,
        not_compared,
        bag_start: reader.start_time().unwrap_or(0),
        bag_duration: reader.duration(),
        took: started.elapsed(),
    })
}
