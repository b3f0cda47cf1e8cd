//! Uses a bag as a test: the modules of a robot run again with the messages that they received, and what they
//! publish is compared with the recording.
//!
//! Modules that run inside the cycle are replayed together, in the recorded cycles (`cycle_times`) at exactly
//! their times; messages of other modules and of ROS 2 join in the cycle in which they were recorded. Each
//! detached module is replayed separately from its recorded runs (`module_steps`); in a bag that was recorded
//! in simulated time, detached modules ran inside the cycle, and are replayed there. Modules see nothing of
//! each other but messages, so if every part of a robot repeats bit for bit, the whole robot does. Modules
//! that drive a device run with the recorded answers of the device if their kind records them. Otherwise they
//! are left out, and the messages that they published become input. If a simulation was recorded in simulated
//! time, its simulated devices can run again as well ([`Simulators::RunAgain`]): nothing but what came from
//! outside the robot is then taken from the bag.
//!
//! Modules inside the cycle are compared until the robot began to stop, detached ones to their end.
//!
//! Modules start with the settings with which they were recorded, except for those that are given on the
//! command line. Modules in other languages run in the versions in which they were recorded, and change at
//! the same places; the last version is the file as it is now.
//!
//! Settings that were changed while the robot ran (`module_settings`) change again in the same cycles.
//! Requests and responses from outside, commands to modules and results of jobs (`module_events`) are
//! repeated as well; the responses and requests of the modules are compared.

mod calls;
mod comparison;
mod coverage;
mod plan;
mod planning;
mod report;
mod runs;
mod session;
mod wiring;

use std::time::Instant;

use downbeat_bags::{FieldRule, Reader};
use downbeat_bridge::expose::TopicPattern;
use downbeat_executor::SetupError;

use crate::journal;
use crate::playback::PlaybackError;
use crate::playback::journals::Extract;
use crate::{
    ChangedSetting, LastVersion, ReplaySection, RobotFile, RobotFileError, Sources, VersionsInBag,
    use_recorded_settings,
};
use calls::Calls;
use comparison::Comparisons;
use plan::Plan;

pub use report::{
    Difference, LeftOut, NotCompared, NotComparedReason, NotSame, ReplayReport, Strictness, TopicReport, What,
};
pub use session::{MessageRange, ReplaySession, SessionInfo, SessionRun, ShownMessage, Standing};

/// What to replay and how exactly to compare.
#[derive(Clone, Debug, Default)]
pub struct ReplayOptions {
    /// The modules to replay; messages of all others become input. If empty, all modules that can be
    /// replayed.
    pub modules: Vec<String>,
    /// Rules for comparing fields. Fields without a rule are compared bit for bit.
    pub rules: Vec<FieldRule>,
    /// Topics that are not compared.
    pub except: Vec<TopicPattern>,
    /// What happens to the simulated devices of the robot.
    pub simulators: Simulators,
    /// In which version modules in other languages run that were not replaced until the end of the recording.
    pub last_version: LastVersion,
}

/// What a replay does with simulated devices: emulators and simulators, and modules whose device is behind a
/// port in memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Simulators {
    /// Simulators are left out, and modules that drive a simulated device run with its recorded answers.
    #[default]
    LeftOut,
    /// Simulators run again from their seeds, modules drive them again, and all that they publish is
    /// compared, pictures too. Only for bags that were recorded in simulated time.
    RunAgain,
}

impl ReplayOptions {
    /// Returns the options in `[replay]` of a robot file.
    #[must_use]
    pub fn of(file: &RobotFile) -> Self {
        let ReplaySection { modules, rules, except } = file.replay.clone();
        Self { modules, rules, except, ..Self::default() }
    }

    fn excludes(&self, topic: &str) -> bool {
        self.except.iter().any(|pattern| pattern.matches(topic))
    }
}

/// Error while replaying a bag.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The robot file is invalid.
    #[error(transparent)]
    Robot(#[from] RobotFileError),
    /// The robot does not have a requested module.
    #[error("the robot has no module \"{module}\"; it has {}", known.join(", "))]
    NoSuchModule {
        /// The requested module.
        module: String,
        /// The modules of the robot.
        known: Vec<String>,
    },
    /// A requested module cannot be replayed from this bag.
    #[error("module \"{0}\" cannot be replayed: {1}")]
    NotReplayable(String, String),
    /// Simulators are to run again, but the bag was recorded in real time.
    #[error(
        "the bag was recorded in real time, in which simulators do not repeat; record with `--fast` to run them again, or \
         replay without them"
    )]
    RealTime,
    /// No module can be replayed, or none publishes a topic of the bag.
    #[error("there is nothing to replay: {0}")]
    Nothing(String),
    /// The messages that a module received cannot be distinguished from those that it published.
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
    /// The bag cannot be played into the modules.
    #[error(transparent)]
    Playback(#[from] PlaybackError),
    /// The modules cannot be added to the core.
    #[error(transparent)]
    Setup(#[from] SetupError),
}

/// Runs the modules of a robot with the messages of a bag, as fast as possible, and compares what they
/// publish with the bag.
///
/// # Errors
/// Returns an error if the bag cannot be replayed. A replay that differs or compares nothing is not an error:
/// the report contains it, and [`ReplayReport::assert_same`] turns it into an error.
pub fn replay(
    file: RobotFile,
    reader: &Reader,
    options: &ReplayOptions,
) -> Result<ReplayReport, ReplayError> {
    let started = Instant::now();
    let Prepared { file, settings, versions, plan, mut extract } = Prepared::new(file, reader, options)?;
    let mut comparisons = Comparisons::new(reader, &plan, &options.rules, &file.catalog.interfaces)?;
    let mut calls = Calls::default();
    if let Some(events) = extract.messages(reader, journal::EVENTS)? {
        calls.recorded(&plan, &events);
    }
    let mut runs = Vec::new();
    for name in &plan.detached {
        comparisons.next_modules();
        runs.push((
            name.clone(),
            runs::detached(&file, reader, &plan, &mut extract, name, &mut comparisons, &mut calls)?,
        ));
    }
    comparisons.next_modules();
    let cycles = if plan.attached.is_empty() {
        0
    } else {
        runs::attached(&file, reader, &plan, &mut extract, &mut comparisons, &mut calls)?
    };
    let mut topics = comparisons.finish()?;
    topics.extend(calls.finish(&plan, &options.rules));
    let notes = notes(&versions, &plan);
    let mut not_compared = plan.not_compared;
    coverage::move_empty(&mut topics, &mut not_compared);
    let sources = Sources::of(&file);
    Ok(ReplayReport {
        changed_sources: reader
            .metadata()
            .filter(|_| options.last_version == LastVersion::AsItIs)
            .map_or_else(Vec::new, |metadata| sources.changed_since(metadata, &versions.last)),
        versions: notes,
        changed_settings: settings,
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

/// What a replay needs before a module runs.
struct Prepared {
    file: RobotFile,
    /// Those that differ from the recording.
    settings: Vec<ChangedSetting>,
    versions: VersionsInBag,
    plan: Plan,
    extract: Extract,
}

impl Prepared {
    fn new(file: RobotFile, reader: &Reader, options: &ReplayOptions) -> Result<Self, ReplayError> {
        let mut file = file.on_any_machine();
        let settings = reader.metadata().map_or_else(Vec::new, |bag| use_recorded_settings(&mut file, bag));
        let mut extract = Extract::new(&file.catalog.interfaces);
        let mut made = Vec::new();
        if file.modules.iter().any(|module| module.kind.is_foreign()) {
            extract.read_journals(reader)?;
            made = extract.messages(reader, journal::EVENTS)?.unwrap_or_default();
        }
        let versions = VersionsInBag::use_in(&mut file, reader, &made, options.last_version);
        let plan = Plan::make(&file, reader, options, versions.reached.clone(), &mut extract)?;
        Ok(Self { file, settings, versions, plan, extract })
    }
}

/// Sentences about what a replay of this bag cannot do.
fn notes(versions: &VersionsInBag, plan: &Plan) -> Vec<String> {
    let mut notes = versions.notes.clone();
    notes.extend(plan.other_modules.iter().cloned());
    if plan.cycles.begin().is_some() {
        notes.push(
            "the bag begins while the robot ran: modules start anew there, so what depends on their state or the phase of their \
             timers differs"
                .to_owned(),
        );
    }
    notes
}
