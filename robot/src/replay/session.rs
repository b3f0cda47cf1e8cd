//! A replay that stands at a cycle.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use bytes::Bytes;
use downbeat_bags::Reader;
use downbeat_edge::{KnownService, KnownType};
use downbeat_executor::{
    Clock, Core, Graph, GraphEdge, GraphModule, ManualClock, ModuleStatistics, RunCause, RunCauses,
    SettingInfo, Snapshot, Time,
};
use downbeat_msgs::downbeat_interfaces::msg::{ModuleEvent, ModuleStep};
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType, YamlStyle};

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
    /// The types of the services, and the modules that serve them.
    services: BTreeMap<String, KnownService>,
    servers: BTreeMap<String, String>,
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
    /// How many messages of each topic its runs were given or missed.
    counts: BTreeMap<String, u64>,
    /// The topics that it publishes, each with how many messages it has published on it in this session.
    publishes: BTreeMap<Arc<str>, (KnownType, u64)>,
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
    /// The messages that no run in this session published: they come from the bag.
    pub given: Vec<MessageRange>,
    /// All messages that were published in it, those of a topic in order.
    pub messages: Vec<ShownMessage>,
    /// What else took effect in it: requests, answers, commands and results of jobs, in their order.
    /// [`ReplaySession::sentence`] says it in words.
    pub events: Vec<ModuleEvent>,
}

/// A run of a module.
#[derive(Clone, Debug)]
pub struct SessionRun {
    /// The module.
    pub module: Arc<str>,
    /// Why it ran.
    pub causes: RunCauses,
    /// The number of the run of a detached module.
    pub step: Option<u64>,
    /// The messages that it received.
    pub received: Vec<MessageRange>,
    /// The messages that it published; of a detached module, those of the bag, which others received.
    pub published: Vec<MessageRange>,
    /// What a detached module published in this session.
    pub replayed: Vec<ShownMessage>,
}

/// Messages of a topic that follow each other.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MessageRange {
    /// The topic, without the leading slash.
    pub topic: Arc<str>,
    /// The number of the first on the topic, from 0.
    pub first: u64,
    /// How many there are.
    pub count: u64,
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
            let published = plan.published_by(|module| module == name);
            let captured = Captured::add(&mut core, published.iter().cloned())?;
            let services = Some(plan.services());
            let follower =
                StepFollower::new(&mut core, &clock, reader, &mut extract, name, &plan.reached, services);
            let follower = follower
                .map_err(|source| ReplayError::Steps { module: name.clone(), source: Box::new(source) })?;
            captured.add_runs(&mut core)?;
            let (name, counts) = (name.clone(), BTreeMap::new());
            let publishes = published.into_iter().map(|(topic, of)| (topic, (of, 0))).collect();
            detached.push(Detached { name, core, follower, captured, counts, publishes });
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
        captured.add_runs(&mut core)?;
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
            services: plan.service_types,
            servers: plan.servers,
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

    /// Whether detached modules publish on a topic. What others received on it are the messages of the bag.
    #[must_use]
    pub fn is_published_detached(&self, topic: &str) -> bool {
        self.detached.iter().any(|detached| detached.publishes.contains_key(topic))
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

    /// The module from which an event comes, and the one that gets it; empty for somebody outside.
    #[must_use]
    pub fn parties<'a>(&'a self, event: &'a ModuleEvent) -> [&'a str; 2] {
        let server = self.servers.get(&event.service).map_or("", String::as_str);
        match event.kind {
            ModuleEvent::REQUEST => [&event.module, server],
            ModuleEvent::ANSWER => [server, &event.module],
            ModuleEvent::COMMAND => [&event.by, &event.module],
            _ => [&event.module, &event.module],
        }
    }

    /// An event in words: who asked whom for what. Of what a request or an answer holds, the beginning.
    #[must_use]
    pub fn sentence(&self, event: &ModuleEvent) -> String {
        let ModuleEvent { kind, module, by, service, number, command, outcome, reason, .. } = event;
        let or_outside =
            |name: &str| if name.is_empty() { "a client outside".to_owned() } else { name.to_owned() };
        let server = || self.servers.get(service).map_or("its server", String::as_str);
        let of = self.services.get(service);
        match (*kind, *outcome) {
            (ModuleEvent::REQUEST, _) => {
                let holds = beginning(of.and_then(|of| of.request_type()), &event.data);
                format!("{} asks {} for {service}: {holds}", or_outside(module), server())
            }
            (ModuleEvent::ANSWER, ModuleEvent::ANSWERED) => {
                let holds = beginning(of.and_then(|of| of.response_type()), &event.data);
                format!("{} answers {} about {service}: {holds}", server(), or_outside(module))
            }
            (ModuleEvent::ANSWER, ModuleEvent::REFUSED) => {
                format!("{} refuses {} the call of {service}: {reason}", server(), or_outside(module))
            }
            (ModuleEvent::ANSWER, ModuleEvent::NO_SERVER) => {
                format!("nobody serves {service}, which {} called", or_outside(module))
            }
            (ModuleEvent::ANSWER, ModuleEvent::SERVER_GONE) => {
                format!("{reason}, which {} called for {service}, is gone", or_outside(module))
            }
            (ModuleEvent::ANSWER, _) => {
                format!("{by} failed while it served {service} to {}: {reason}", or_outside(module))
            }
            (ModuleEvent::COMMAND, _) => {
                let by = if by.is_empty() { "somebody outside" } else { by };
                format!("{by} asks for {command} of {module}")
            }
            (ModuleEvent::RESULT, _) => format!("{module} gets result {number} of a job"),
            (kind, _) => format!("an event of kind {kind} of {module}"),
        }
    }

    /// The settings of a module; `None` if it does not run.
    #[must_use]
    pub fn settings(&self, module: &str) -> Option<Vec<SettingInfo>> {
        self.core_of(module).settings(module)
    }

    /// The graph of the modules that run. What the replay itself takes out of the cores is left out.
    #[must_use]
    pub fn graph(&self) -> Graph {
        let mut graph = self.core.graph();
        graph.outlets.clear();
        graph.edges.retain(|edge| !matches!(edge, GraphEdge::Leaves { .. }));
        for Detached { name, core, .. } in &self.detached {
            add_module(&mut graph, &core.graph(), name);
        }
        graph
    }

    /// The counters of the modules so far: for each detached module those of its own core.
    pub fn snapshot(&mut self) -> Snapshot {
        let mut snapshot = self.core.snapshot();
        snapshot.outlets.clear();
        for Detached { name, core, .. } in &mut self.detached {
            let statistics = core.snapshot().modules.into_iter().find(|module| module.name == *name);
            snapshot
                .modules
                .extend(statistics.map(|module| ModuleStatistics { is_detached: true, ..module }));
        }
        snapshot
    }

    /// The topics that each module receives, without the leading slash.
    #[must_use]
    pub fn subscriptions(&self) -> BTreeMap<String, Vec<String>> {
        let mut subscriptions = BTreeMap::<String, Vec<String>>::new();
        for core in self.detached.iter().map(|detached| &detached.core).chain([&self.core]) {
            let Graph { modules, topics, edges, .. } = core.graph();
            for edge in edges {
                if let GraphEdge::Subscribes { module, topic } = edge
                    && let (Some(module), Some(topic)) = (modules.get(module), topics.get(topic))
                {
                    subscriptions.entry(module.name.clone()).or_default().push(topic.name.clone());
                }
            }
        }
        subscriptions
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
        let mut events = self.captured.take_events_of(&self.core);
        let mut published = Published::of(&messages);
        let time = self.follower.clock.now();
        let mut runs = self.run_detached(cycle, time, &mut published, &mut events)?;
        // That a detached module took something over says nothing new.
        events.retain(|event| ![ModuleEvent::TAKEN, ModuleEvent::MADE].contains(&event.kind));
        if let Some(account) = self.captured.take_runs() {
            // Those inside the cycle published last.
            let inside = account.runs.iter().rev().map(|run| {
                let name = |topic: u32| account.wiring.topics.get(topic as usize);
                let messages = account.published(run).iter().rev();
                let messages =
                    messages.filter_map(|messages| published.last(name(messages.topic)?, messages.count));
                let mut messages: Vec<_> = messages.collect();
                messages.reverse();
                let module = account.wiring.modules.get(run.module as usize);
                let subscribes = module.into_iter().flat_map(|module| &module.subscribes);
                let has_messages = run.causes.has(RunCause::Messages);
                let topics = subscribes.filter_map(|topic| name(*topic)).filter(|_| has_messages);
                SessionRun {
                    module: module.map_or_else(|| "?".into(), |module| Arc::clone(&module.name)),
                    causes: run.causes,
                    step: None,
                    received: topics.filter_map(|topic| self.last.range(topic)).collect(),
                    published: messages,
                    replayed: Vec::new(),
                }
            });
            let mut inside: Vec<_> = inside.collect();
            inside.reverse();
            runs.append(&mut inside);
        }
        let given = published.rest();
        let standing = Standing { cycle, time, runs, given, messages, events };
        self.before = std::mem::replace(&mut self.last, standing);
        Ok(true)
    }

    /// Makes the runs of detached modules that joined in a cycle. What they publish is compared; what others
    /// receive of them are the messages of the bag.
    fn run_detached(
        &mut self,
        cycle: u64,
        time: Time,
        published: &mut Published,
        events: &mut Vec<ModuleEvent>,
    ) -> Result<Vec<SessionRun>, ReplayError> {
        let has_cycles = self.cycles.is_recorded();
        let has_joined = |step: &&ModuleStep| match has_cycles {
            true => step.cycle <= cycle,
            false => step.stamp.as_nanos() <= time.as_nanos(),
        };
        let mut runs = Vec::new();
        for detached in &mut self.detached {
            let Detached { name, core, follower, captured, counts, publishes } = detached;
            let source = |source| ReplayError::Steps { module: name.clone(), source: Box::new(source) };
            while let Some(step) = follower.next().filter(has_joined) {
                let number = step.step;
                let given = step.topics.iter().zip(&step.skipped).zip(&step.counts);
                let received = given.map(|((topic, skipped), count)| {
                    let next = counts.entry(topic.clone()).or_default();
                    let first = *next + u64::from(*skipped);
                    *next = first + u64::from(*count);
                    MessageRange { topic: topic.as_str().into(), first, count: u64::from(*count) }
                });
                let received = received.filter(|messages| messages.count > 0).collect();
                follower.step(core).map_err(source)?;
                core.run_sinks();
                let mut shown = Vec::new();
                for replayed in captured.take() {
                    if let Some((of, count)) = publishes.get_mut(&replayed.topic) {
                        shown.push(replayed.shown(*of, count));
                    }
                    self.comparisons.replayed(replayed);
                }
                events.extend(captured.take_events_of(core));
                let Some(account) = captured.take_runs() else { continue };
                let own = account.runs.iter().find(|run| {
                    account
                        .wiring
                        .modules
                        .get(run.module as usize)
                        .is_some_and(|module| *module.name == **name)
                });
                let Some(run) = own else { continue };
                let messages = account.published(run).iter();
                let messages = messages.filter_map(|messages| {
                    published.first(account.wiring.topics.get(messages.topic as usize)?, messages.count)
                });
                runs.push(SessionRun {
                    module: name.as_str().into(),
                    causes: run.causes,
                    step: Some(number),
                    received,
                    published: messages.collect(),
                    replayed: shown,
                });
            }
        }
        Ok(runs)
    }

    /// A captured message as it is shown; `None` if its type is not known.
    fn shown(&mut self, replayed: &Replayed) -> Option<ShownMessage> {
        let message_type = *self.types.get(&replayed.topic)?;
        let message =
            replayed.shown(message_type, self.counts.entry(Arc::clone(&replayed.topic)).or_default());
        self.latest.insert(Arc::clone(&message.topic), message.clone());
        Some(message)
    }
}

impl Replayed {
    /// As it is shown; `count` is how many messages there were on the topic before.
    fn shown(&self, message_type: KnownType, count: &mut u64) -> ShownMessage {
        let number = *count;
        *count += 1;
        let Self { topic, time, cdr } = self;
        let (topic, time) = (Arc::clone(topic), Time::from_nanos(*time));
        ShownMessage { topic, number, time, message_type, cdr: cdr.clone() }
    }
}

impl Standing {
    /// The messages of a topic.
    fn range(&self, topic: &Arc<str>) -> Option<MessageRange> {
        let mut messages = self.messages.iter().filter(|message| message.topic == *topic);
        let first = messages.next()?.number;
        Some(MessageRange { topic: Arc::clone(topic), first, count: 1 + messages.count() as u64 })
    }
}

/// The messages of a cycle whose publishers are not known yet, by topic.
struct Published(BTreeMap<Arc<str>, Range<u64>>);

impl Published {
    fn of(messages: &[ShownMessage]) -> Self {
        let mut ranges = BTreeMap::<Arc<str>, Range<u64>>::new();
        for ShownMessage { topic, number, .. } in messages {
            let range = ranges.entry(Arc::clone(topic)).or_insert(*number..*number);
            range.end = number + 1;
        }
        Self(ranges)
    }

    /// Takes the first messages of a topic.
    fn first(&mut self, topic: &Arc<str>, count: u32) -> Option<MessageRange> {
        let range = self.0.get_mut(topic)?;
        let first = range.start;
        range.start = (first + u64::from(count)).min(range.end);
        MessageRange::of(topic, first..range.start)
    }

    /// Takes the last messages of a topic.
    fn last(&mut self, topic: &Arc<str>, count: u32) -> Option<MessageRange> {
        let range = self.0.get_mut(topic)?;
        let end = range.end;
        range.end = end.saturating_sub(u64::from(count)).max(range.start);
        MessageRange::of(topic, range.end..end)
    }

    fn rest(self) -> Vec<MessageRange> {
        self.0.into_iter().filter_map(|(topic, range)| MessageRange::of(&topic, range)).collect()
    }
}

impl MessageRange {
    /// `None` if the range is empty.
    fn of(topic: &Arc<str>, range: Range<u64>) -> Option<Self> {
        let count = range.end.checked_sub(range.start).filter(|count| *count > 0)?;
        Some(Self { topic: Arc::clone(topic), first: range.start, count })
    }
}

/// The beginning of a message as YAML in one line.
fn beginning(of: Option<DynamicType>, cdr: &[u8]) -> String {
    let style = YamlStyle { flow_style: true, truncate_length: Some(16), ..YamlStyle::default() };
    let message = of.and_then(|of| DynamicMessage::from_cdr(&of, cdr).ok());
    match message {
        Some(message) => {
            let yaml = message.as_message().to_yaml(&style);
            yaml.lines().map(str::trim).collect::<Vec<_>>().join(" ")
        }
        None => format!("{} bytes", cdr.len()),
    }
}

/// Adds a module of another core, with what it publishes, subscribes, serves and calls.
fn add_module(graph: &mut Graph, other: &Graph, name: &str) {
    let Some(of_other) = other.modules.iter().position(|module| module.name == name) else { return };
    let module = graph.modules.len();
    graph.modules.push(GraphModule { name: name.to_owned(), is_detached: true });
    let Graph { topics, services, edges, .. } = graph;
    let mut topic = |topic| place(topics, &other.topics, topic, |a, b| a.name == b.name);
    let mut service = |service| place(services, &other.services, service, |a, b| a.name == b.name);
    for edge in &other.edges {
        edges.extend(match *edge {
            GraphEdge::Publishes { module: of, topic: to } if of == of_other => {
                topic(to).map(|topic| GraphEdge::Publishes { module, topic })
            }
            GraphEdge::Subscribes { module: of, topic: to } if of == of_other => {
                topic(to).map(|topic| GraphEdge::Subscribes { module, topic })
            }
            GraphEdge::Serves { module: of, service: to } if of == of_other => {
                service(to).map(|service| GraphEdge::Serves { module, service })
            }
            GraphEdge::Calls { module: of, service: to } if of == of_other => {
                service(to).map(|service| GraphEdge::Calls { module, service })
            }
            _ => None,
        });
    }
}

/// Where one of other nodes is among these, to which it is added if it is new.
fn place<N: Clone>(
    nodes: &mut Vec<N>,
    others: &[N],
    other: usize,
    is_same: fn(&N, &N) -> bool,
) -> Option<usize> {
    let other = others.get(other)?;
    Some(nodes.iter().position(|node| is_same(node, other)).unwrap_or_else(|| {
        nodes.push(other.clone());
        nodes.len() - 1
    }))
}
