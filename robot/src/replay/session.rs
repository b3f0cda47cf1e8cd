//! A replay that stands at a cycle.

use std::collections::BTreeMap;
use std::sync::Arc;

use bytes::Bytes;
use downbeat_bags::Reader;
use downbeat_edge::KnownType;
use downbeat_executor::{Clock, Core, ManualClock, SettingInfo, Time, TraceCause};

use super::comparison::{Comparisons, Replayed};
use super::report::{Difference, LeftOut};
use super::runs::{Captured, build};
use super::{Prepared, ReplayError, ReplayOptions, notes};
use crate::playback::cycles::{Follower, Inputs};
use crate::playback::events::Events;
use crate::playback::journals::{Cycles, SettingsChanges};
use crate::playback::{StepFollower, first_step};
use crate::{ChangedSetting, LauncherChoice, RobotFile, VersionsInBag, journal};

/// A replay that goes on one cycle at a time, and shows what happened in it.
///
/// Modules that run inside the cycle are in one core; each detached module has a core of its own, in which it
/// makes its recorded runs up to the cycle. What they publish is compared with the bag on the way. Everything
/// runs on the calling thread.
pub struct ReplaySession {
    core: Core,
    follower: Follower,
    captured: Captured,
    detached: Vec<Detached>,
    comparisons: Comparisons,
    cycles: Cycles,
    /// The topics of messages that can be read.
    types: BTreeMap<Arc<str>, KnownType>,
    /// How many cycles have run.
    position: u64,
    /// How many messages there were on each topic.
    counts: BTreeMap<Arc<str>, u64>,
    /// The last message of each topic.
    latest: BTreeMap<Arc<str>, ShownMessage>,
    /// What happened in the last cycle and in that before it.
    last: Standing,
    before: Standing,
    about: SessionInfo,
    /// Has files of modules.
    _versions: VersionsInBag,
}

/// What is known of a session before it begins.
#[derive(Clone, Debug)]
pub struct SessionInfo {
    /// The robot's name.
    pub robot: String,
    /// The modules inside the cycle.
    pub modules: Vec<String>,
    /// The detached modules.
    pub detached: Vec<String>,
    /// The modules that do not run.
    pub left_out: Vec<LeftOut>,
    /// The settings that differ from the recording.
    pub changed_settings: Vec<ChangedSetting>,
    /// The topics that modules received during the recording and that the bag lacks.
    pub missing_inputs: Vec<String>,
    /// Sentences about what differs from the recorded run.
    pub notes: Vec<String>,
    /// The number of cycles; `None` if the bag does not say.
    pub cycles: Option<u64>,
    /// When the bag begins.
    pub start: Time,
    /// The number of the first cycle: not 0 if the bag begins while the robot ran.
    pub first_cycle: u64,
}

struct Detached {
    name: String,
    core: Core,
    follower: StepFollower,
    captured: Captured,
}

/// What happened in a cycle.
#[derive(Clone, Debug, Default)]
pub struct Standing {
    /// The number of the cycle.
    pub cycle: u64,
    /// Its time.
    pub time: Time,
    /// The runs of modules, in the order of their effects.
    pub runs: Vec<SessionRun>,
    /// The messages that were published in it. Those of a topic are in order: first those from the bag, then
    /// those of each run.
    pub messages: Vec<ShownMessage>,
}

/// A run of a module.
#[derive(Clone, Debug)]
pub struct SessionRun {
    /// The module.
    pub module: Arc<str>,
    /// Why it ran.
    pub causes: Vec<TraceCause>,
    /// The number of the run of a detached module.
    pub step: Option<u64>,
    /// How many messages it published on which topics.
    pub published: Vec<(Arc<str>, u32)>,
}

/// A message of a cycle.
#[derive(Clone, Debug)]
pub struct ShownMessage {
    /// Its topic, without the leading slash.
    pub topic: Arc<str>,
    /// Its number on the topic, from 0.
    pub number: u64,
    /// When it was published.
    pub time: Time,
    message_type: KnownType,
    cdr: Bytes,
}

impl ShownMessage {
    /// The name of its type.
    #[must_use]
    pub fn type_name(&self) -> &'static str {
        self.message_type.name()
    }

    /// The type.
    #[must_use]
    pub fn message_type(&self) -> KnownType {
        self.message_type
    }

    /// The message as CDR.
    #[must_use]
    pub fn cdr(&self) -> &Bytes {
        &self.cdr
    }
}

impl ReplaySession {
    /// Opens a session before its first cycle.
    ///
    /// # Errors
    /// As for [`replay`](super::replay()), and if no module runs inside the cycle and the bag has no cycles.
    pub fn open(mut file: RobotFile, reader: &Reader, options: &ReplayOptions) -> Result<Self, ReplayError> {
        file.launcher.choice = LauncherChoice::Linear;
        let Prepared { file, settings, versions, plan, mut extract } = Prepared::new(file, reader, options)?;
        let mut comparisons = Comparisons::new(reader, &plan, &options.rules, &file.catalog.interfaces)?;
        let interfaces = &file.catalog.interfaces;
        let mut detached = Vec::new();
        for name in &plan.detached {
            let clock = ManualClock::new(Time::ZERO);
            plan.reached.set(first_step(reader, &mut extract, name)?.unwrap_or(i64::MIN));
            let core = Core::new().with_clock(clock.clone());
            let mut core = build(&file, reader, &plan, &mut extract, core, |module| module == name)?;
            let captured = Captured::add(&mut core, plan.published_by(|module| module == name))?;
            let services = Some(plan.services());
            let follower =
                StepFollower::new(&mut core, &clock, reader, &mut extract, name, &plan.reached, services);
            let follower = follower
                .map_err(|source| ReplayError::Steps { module: name.clone(), source: Box::new(source) })?;
            detached.push(Detached { name: name.clone(), core, follower, captured });
        }
        let start = plan.cycles.first().or(reader.start_time()).unwrap_or(0);
        let clock = ManualClock::new(Time::from_nanos(start));
        plan.reached.reset();
        let mut core = file.launch(Core::new().with_clock(clock.clone()))?;
        let is_replayed = |module: &str| plan.attached.iter().any(|name| name == module);
        core = build(&file, reader, &plan, &mut extract, core, is_replayed)?;
        let names = plan.inputs.iter().map(String::as_str);
        let inputs = Inputs::open(&mut core, reader, names, comparisons.fed_topics(), &mut extract)?;
        let mut types: BTreeMap<Arc<str>, KnownType> = plan.published_by(is_replayed).into_iter().collect();
        let known =
            core.topics().filter_map(|topic| Some((Arc::clone(&topic.name), interfaces.message_in(topic)?)));
        types.extend(known.filter(|(_, of)| !of.is_raw()));
        let captured = Captured::add(&mut core, types.iter().map(|(topic, of)| (Arc::clone(topic), *of)))?;
        let changes = SettingsChanges::read(reader, &mut extract, &plan.cycles, is_replayed)?;
        let recorded = extract.messages(reader, journal::EVENTS)?;
        let events = Events::of_core(&mut core, recorded.as_deref(), interfaces, Some(plan.services()))?;
        let reached = plan.reached.clone();
        let follower = Follower::new(reader, &plan.cycles, clock, inputs, changes, events, reached)?;
        let about = SessionInfo {
            robot: file.name.clone(),
            notes: notes(&versions, &plan),
            cycles: match &plan.cycles {
                Cycles::Recorded { times, .. } => Some(times.len() as u64),
                Cycles::OfMessages | Cycles::Unknown => None,
            },
            start: Time::from_nanos(reader.start_time().unwrap_or(start)),
            first_cycle: plan.cycles.first_number(),
            modules: plan.attached,
            detached: plan.detached,
            left_out: plan.left_out,
            changed_settings: settings,
            missing_inputs: plan.missing_inputs.into_iter().collect(),
        };
        comparisons.next_modules();
        Ok(Self {
            core,
            follower,
            captured,
            detached,
            comparisons,
            cycles: plan.cycles,
            types,
            position: 0,
            counts: BTreeMap::new(),
            latest: BTreeMap::new(),
            last: Standing { time: Time::from_nanos(start), ..Standing::default() },
            before: Standing::default(),
            about,
            _versions: versions,
        })
    }

    /// What is known of the session.
    #[must_use]
    pub fn about(&self) -> &SessionInfo {
        &self.about
    }

    /// How many cycles have run.
    #[must_use]
    pub fn position(&self) -> u64 {
        self.position
    }

    /// The last cycle.
    #[must_use]
    pub fn standing(&self) -> &Standing {
        &self.last
    }

    /// The cycle before the last one, whose messages modules received in the last one.
    #[must_use]
    pub fn before(&self) -> &Standing {
        &self.before
    }

    /// The topics of messages that can be read, without the leading slash, with their types.
    #[must_use]
    pub fn types(&self) -> &BTreeMap<Arc<str>, KnownType> {
        &self.types
    }

    /// The last message of each topic.
    pub fn latest(&self) -> impl Iterator<Item = &ShownMessage> {
        self.latest.values()
    }

    /// The first difference from the bag so far.
    #[must_use]
    pub fn first_difference(&self) -> Option<&Difference> {
        self.comparisons.first_difference()
    }

    /// What a module shows of itself; `None` if it shows nothing or does not run.
    #[must_use]
    pub fn debug(&self, module: &str) -> Option<String> {
        self.core_of(module).debug(module)
    }

    /// The settings of a module; `None` if it does not run.
    #[must_use]
    pub fn settings(&self, module: &str) -> Option<Vec<SettingInfo>> {
        self.core_of(module).settings(module)
    }

    fn core_of(&self, module: &str) -> &Core {
        let detached = self.detached.iter().find(|detached| detached.name == module);
        detached.map_or(&self.core, |detached| &detached.core)
    }

    /// Runs the next cycle. Returns false if there is none.
    ///
    /// # Errors
    /// If the bag cannot be read or modules do not come to rest.
    pub fn step(&mut self) -> Result<bool, ReplayError> {
        if !self.follower.step(&mut self.core)? {
            return Ok(false);
        }
        self.core.run_sinks();
        let cycle = self.about.first_cycle + self.position;
        self.position += 1;
        let others = self.follower.inputs.take_others();
        others.into_iter().for_each(|message| self.comparisons.recorded(message));
        let mut messages = Vec::new();
        let end = self.cycles.end();
        for replayed in self.captured.take() {
            messages.extend(self.shown(&replayed));
            if replayed.time < end {
                self.comparisons.replayed(replayed);
            }
        }
        drop(self.captured.take_events());
        let time = self.follower.clock.now();
        for detached in &mut self.detached {
            let Detached { name, core, follower, captured } = detached;
            let source = |source| ReplayError::Steps { module: name.clone(), source: Box::new(source) };
            while follower.next().is_some_and(|step| step.cycle <= cycle) {
                follower.step(core).map_err(source)?;
                core.run_sinks();
                captured.take().into_iter().for_each(|replayed| self.comparisons.replayed(replayed));
                drop(captured.take_events());
            }
        }
        let standing = Standing { cycle, time, runs: Vec::new(), messages };
        self.before = std::mem::replace(&mut self.last, standing);
        Ok(true)
    }

    /// A captured message as it is shown; `None` if its type is not known.
    fn shown(&mut self, replayed: &Replayed) -> Option<ShownMessage> {
        let message_type = *self.types.get(&replayed.topic)?;
        let count = self.counts.entry(Arc::clone(&replayed.topic)).or_default();
        let number = *count;
        *count += 1;
        let (topic, time) = (Arc::clone(&replayed.topic), Time::from_nanos(replayed.time));
        let message = ShownMessage { topic, number, time, message_type, cdr: replayed.cdr.clone() };
        self.latest.insert(Arc::clone(&message.topic), message.clone());
        Some(message)
    }
}
