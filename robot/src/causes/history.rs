//! The runs of a robot, and the messages between them.

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::ops::Range;
use std::sync::Arc;

use downbeat_executor::{
    CycleRuns, DetachedStep, ModuleEvent, ModuleEventKind, Published, RunCause, RunCauses, SettingsChange,
    Time, WiredModule, Wiring,
};

/// A run of a [`History`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct RunId(pub(super) usize);

/// A message of a [`History`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct MessageId {
    pub(super) topic: usize,
    /// The position among the messages of the topic, from 0.
    pub number: u64,
}

/// What a robot has done: its runs, with what they received and published.
///
/// Accounts are pushed in the order of cycles, and what happened in a cycle (steps, events, settings) after
/// the account of that cycle.
#[derive(Default)]
pub struct History {
    pub(super) topics: Vec<Topic>,
    topic_ids: HashMap<Arc<str>, usize>,
    pub(super) modules: Vec<Instance>,
    pub(super) runs: Vec<Run>,
    pub(super) groups: Vec<Group>,
    pub(super) calls: Vec<Called>,
    pub(super) changes: Vec<Change>,
    /// Events for detached modules that no run has taken yet, by module.
    untaken: HashMap<Arc<str>, VecDeque<Option<usize>>>,
    /// The cycles of requests of modules that have no answer yet.
    unanswered: HashMap<CallOf, u64>,
    wired: Option<Wired>,
    first_cycle: Option<u64>,
}

pub(super) struct Topic {
    pub(super) name: Arc<str>,
    /// Indices of `History::groups`.
    groups: Vec<usize>,
    messages: u64,
}

/// Messages of one topic that were published together.
#[derive(Clone, Copy)]
pub(super) struct Group {
    /// The number of the first message.
    pub(super) first: u64,
    pub(super) count: u32,
    pub(super) cycle: u64,
    pub(super) time: Time,
    /// The run that published them; `None` if they came from outside.
    pub(super) run: Option<RunId>,
}

pub(super) struct Run {
    pub(super) module: usize,
    pub(super) cycle: u64,
    /// The time of the cycle.
    pub(super) time: Time,
    pub(super) causes: RunCauses,
    pub(super) step: Option<u64>,
}

/// A module from its setup to its removal or restart.
pub(super) struct Instance {
    pub(super) name: Arc<str>,
    pub(super) since: u64,
    is_detached: bool,
    pub(super) subscribes: Vec<usize>,
    serves: Vec<Arc<str>>,
    /// In the order of cycles.
    pub(super) runs: Vec<RunId>,
    /// The next message of each topic for a detached module.
    positions: HashMap<usize, u64>,
    /// The input of each run of a detached module.
    pub(super) steps: BTreeMap<u64, Step>,
    /// The runs of a detached module that received messages of a topic, each with the last one.
    received: HashMap<usize, Vec<(u64, u64)>>,
}

pub(super) struct Step {
    /// The time that the module was given.
    pub(super) time: Time,
    inputs: Vec<(usize, Range<u64>)>,
    /// Indices of `History::calls`.
    calls: Vec<usize>,
}

/// A request that went to a server, or an answer that went to a client.
#[derive(Clone)]
pub(super) struct Called {
    pub(super) cycle: u64,
    pub(super) time: Time,
    pub(super) service: Arc<str>,
    /// The caller; `None` for one outside the robot.
    pub(super) client: Option<Arc<str>>,
    pub(super) is_answer: bool,
    /// Of an answer to a module, the cycle of its request, if that was recorded.
    requested: Option<u64>,
}

/// Which call of a client of a service: the two, the port and the number.
type CallOf = (Arc<str>, Arc<str>, u32, u64);

/// Changed settings of a module.
pub(super) struct Change {
    /// The cycle whose sync phase applied them; of no meaning for a detached module.
    cycle: u64,
    module: Arc<str>,
    step: Option<u64>,
    pub(super) settings: Vec<Arc<str>>,
}

/// A wiring, with its modules and topics as those of the history.
struct Wired {
    wiring: Arc<Wiring>,
    topics: Vec<usize>,
    modules: Vec<usize>,
}

/// The reason why a message is not in the history.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unplaced {
    /// No run published on the topic, and nothing came from outside.
    #[error("no module of the robot published on {0}, and no message came from outside")]
    NoTopic(String),
    /// The journal of runs has no message of the topic at this time.
    #[error(
        "the journal of runs has no message on {topic} at this time: it was published by an observer, such as the \
         recorder's own modules, or the journal does not reach to it"
    )]
    NoMessage {
        /// The topic.
        topic: String,
    },
    /// The bag lacks messages of the topic at this time, so that they cannot be told apart.
    #[error(
        "{published} messages were published on {topic} at this time, but the bag has {recorded}: some were lost, so \
         it is not known which one this is"
    )]
    Lost {
        /// The topic.
        topic: String,
        /// How many the journal counts.
        published: u64,
        /// How many the bag has.
        recorded: u64,
    },
}

impl History {
    /// Adds the account of a cycle.
    pub fn push(&mut self, account: &CycleRuns) {
        self.first_cycle.get_or_insert(account.cycle);
        let wired = match self.wired.take() {
            Some(wired) if Arc::ptr_eq(&wired.wiring, &account.wiring) => wired,
            _ => self.wire(&account.wiring),
        };
        for published in &account.from_inlets {
            self.publish(&wired, account, published, None);
        }
        for run in &account.runs {
            let Some(&module) = wired.modules.get(run.module as usize) else { continue };
            let id = RunId(self.runs.len());
            for published in account.published(run) {
                self.publish(&wired, account, published, Some(id));
            }
            self.runs.push(Run {
                module,
                cycle: account.cycle,
                time: account.time,
                causes: run.causes,
                step: run.step,
            });
            self.modules[module].runs.push(id);
        }
        self.wired = Some(wired);
    }

    fn publish(&mut self, wired: &Wired, account: &CycleRuns, published: &Published, run: Option<RunId>) {
        let Some(&topic) = wired.topics.get(published.topic as usize) else { return };
        let Topic { groups, messages, .. } = &mut self.topics[topic];
        groups.push(self.groups.len());
        self.groups.push(Group {
            first: *messages,
            count: published.count,
            cycle: account.cycle,
            time: account.time,
            run,
        });
        *messages += u64::from(published.count);
    }

    fn wire(&mut self, wiring: &Arc<Wiring>) -> Wired {
        let topics: Vec<_> = wiring.topics.iter().map(|topic| self.open_topic(topic)).collect();
        let module = |module: &WiredModule| {
            let is_known = |known: &Instance| (&known.name, known.since) == (&module.name, module.since);
            self.modules.iter().rposition(is_known).unwrap_or_else(|| {
                let subscribes = module.subscribes.iter();
                self.modules.push(Instance {
                    name: Arc::clone(&module.name),
                    since: module.since,
                    is_detached: module.is_detached,
                    subscribes: subscribes.filter_map(|&topic| topics.get(topic as usize).copied()).collect(),
                    serves: module.serves.clone(),
                    runs: Vec::new(),
                    positions: HashMap::new(),
                    steps: BTreeMap::new(),
                    received: HashMap::new(),
                });
                self.modules.len() - 1
            })
        };
        let modules = wiring.modules.iter().map(module).collect();
        Wired { wiring: Arc::clone(wiring), topics, modules }
    }

    fn open_topic(&mut self, name: &Arc<str>) -> usize {
        *self.topic_ids.entry(Arc::clone(name)).or_insert_with(|| {
            self.topics.push(Topic { name: Arc::clone(name), groups: Vec::new(), messages: 0 });
            self.topics.len() - 1
        })
    }

    /// Adds a run of a detached module, whose account has been pushed.
    pub fn push_step(&mut self, step: &DetachedStep) {
        let Some(module) = self.instance(&step.module, step.cycle) else { return };
        let is_from_start = self.first_cycle.is_none_or(|first| first <= self.modules[module].since);
        let mut inputs = Vec::new();
        for input in &step.inputs {
            let Some(&topic) = self.topic_ids.get(&input.topic) else { continue };
            let since = self.modules[module].since;
            let begin = if is_from_start {
                self.first_from(topic, |group| group.cycle < since)
            } else {
                // The journal begins while the module runs: it is assumed to receive the newest first.
                let newest =
                    self.first_from(topic, |group| group.cycle < step.cycle && group.time <= step.time);
                newest.saturating_sub(u64::from(input.skipped) + u64::from(input.received))
            };
            let Instance { positions, received, .. } = &mut self.modules[module];
            let position = positions.entry(topic).or_insert(begin);
            let messages = self.topics[topic].messages;
            let first = (*position + u64::from(input.skipped)).min(messages);
            *position = (first + u64::from(input.received)).min(messages);
            if first < *position {
                received.entry(topic).or_default().push((step.step, *position - 1));
                inputs.push((topic, first..*position));
            }
        }
        let step_of = Step { time: step.time, inputs, calls: Vec::new() };
        self.modules[module].steps.insert(step.step, step_of);
    }

    /// The number of the first message of a topic that is in none of the first groups for which `is_before`
    /// is true.
    fn first_from(&self, topic: usize, is_before: impl Fn(&Group) -> bool) -> u64 {
        let Topic { groups, messages, .. } = &self.topics[topic];
        let position = groups.partition_point(|&group| is_before(&self.groups[group]));
        groups.get(position).map_or(*messages, |&group| self.groups[group].first)
    }

    /// The module of this name in a cycle.
    pub(super) fn instance(&self, name: &str, cycle: u64) -> Option<usize> {
        let is_it = |instance: &Instance| *instance.name == *name && instance.since <= cycle;
        self.modules.iter().rposition(is_it)
    }

    fn server(&self, service: &str, cycle: u64) -> Option<usize> {
        let serves = |instance: &Instance| {
            instance.since <= cycle && instance.serves.iter().any(|its| **its == *service)
        };
        self.modules.iter().rposition(serves)
    }

    /// Adds a request, an answer or what a detached module took of them.
    pub fn push_event(&mut self, event: &ModuleEvent) {
        let (cycle, time) = (event.cycle, event.time);
        let concerned = match &event.kind {
            ModuleEventKind::Request { service, origin, .. } => {
                let (service, client) = (Arc::clone(service), origin.client.clone());
                if let Some(client) = client.clone() {
                    let call = (Arc::clone(&service), client, origin.port, origin.number);
                    self.unanswered.insert(call, cycle);
                }
                self.calls.push(Called { cycle, time, service, client, is_answer: false, requested: None });
                let server = self.server(&self.calls[self.calls.len() - 1].service, cycle);
                server.map(|server| (Arc::clone(&self.modules[server].name), Some(self.calls.len() - 1)))
            }
            ModuleEventKind::Answer { service, origin, .. } => {
                let (service, client) = (Arc::clone(service), origin.client.clone());
                let call = client.clone();
                let call = call.map(|client| (Arc::clone(&service), client, origin.port, origin.number));
                let requested = call.and_then(|call| self.unanswered.remove(&call));
                let answered = client.clone();
                self.calls.push(Called { cycle, time, service, client, is_answer: true, requested });
                answered.map(|client| (client, Some(self.calls.len() - 1)))
            }
            ModuleEventKind::Command { module, .. } | ModuleEventKind::JobResult { module, .. } => {
                Some((Arc::clone(module), None))
            }
            ModuleEventKind::Made { .. } => None,
            ModuleEventKind::Taken { module, step, count } => {
                let untaken = self.untaken.entry(Arc::clone(module)).or_default();
                let taken = untaken.drain(..untaken.len().min(*count as usize)).flatten().collect();
                let module = self.instance(module, cycle);
                if let Some(step) = module.and_then(|module| self.modules[module].steps.get_mut(step)) {
                    step.calls = taken;
                }
                None
            }
        };
        if let Some((module, call)) = concerned
            && self.instance(&module, cycle).is_some_and(|module| self.modules[module].is_detached)
        {
            self.untaken.entry(module).or_default().push_back(call);
        }
    }

    /// Adds changed settings of a module, and the cycle whose sync phase applied them.
    ///
    /// Without one, that is the last cycle of the history at the time of the change.
    pub fn push_settings(&mut self, change: &SettingsChange, cycle: Option<u64>) {
        let last_at_time = || {
            let runs = self.runs.partition_point(|run| run.time <= change.time);
            runs.checked_sub(1).map_or(0, |run| self.runs[run].cycle)
        };
        self.changes.push(Change {
            cycle: cycle.unwrap_or_else(last_at_time),
            module: Arc::clone(&change.module),
            step: change.step,
            settings: change.settings.iter().map(|(name, _)| Arc::from(&**name)).collect(),
        });
    }

    /// True if there is no account of any cycle.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.first_cycle.is_none()
    }

    /// A message of a topic by its number, from 0.
    #[must_use]
    pub fn message(&self, topic: &str, number: u64) -> Option<MessageId> {
        let &topic = self.topic_ids.get(topic)?;
        (number < self.topics[topic].messages).then_some(MessageId { topic, number })
    }

    /// The message of a topic that is the `nth` of the `recorded` messages with this time in a bag.
    ///
    /// # Errors
    /// If the message is not in the journal, or the bag lacks others of the same time.
    pub fn message_at(
        &self,
        topic: &str,
        time: Time,
        nth: u64,
        recorded: u64,
    ) -> Result<MessageId, Unplaced> {
        let name = || topic.to_owned();
        let &topic = self.topic_ids.get(topic).ok_or_else(|| Unplaced::NoTopic(name()))?;
        let first = self.first_from(topic, |group| group.time < time);
        let published = self.first_from(topic, |group| group.time <= time) - first;
        if published > recorded {
            return Err(Unplaced::Lost { topic: name(), published, recorded });
        }
        // Those of observers come first, as those of inlets do.
        match nth.checked_sub(recorded - published) {
            Some(nth) if nth < published => Ok(MessageId { topic, number: first + nth }),
            _ => Err(Unplaced::NoMessage { topic: name() }),
        }
    }

    /// The topic of a message, without a leading slash.
    #[must_use]
    pub fn topic(&self, message: MessageId) -> &str {
        &self.topics[message.topic].name
    }

    /// The run that published a message; `None` if it came from outside.
    #[must_use]
    pub fn publisher(&self, message: MessageId) -> Option<RunId> {
        self.group(message).and_then(|group| group.run)
    }

    pub(super) fn group(&self, message: MessageId) -> Option<&Group> {
        let groups = &self.topics.get(message.topic)?.groups;
        let position = groups.partition_point(|&group| self.groups[group].first <= message.number);
        Some(&self.groups[groups[position.checked_sub(1)?]])
    }

    /// The messages that a run received, in the order of subscription.
    pub fn received(&self, run: RunId) -> impl Iterator<Item = MessageId> {
        let spans = self.received_spans(run).into_iter();
        spans.flat_map(|(topic, span)| span.map(move |number| MessageId { topic, number }))
    }

    /// The messages that a run received, by topic.
    pub(super) fn received_spans(&self, run: RunId) -> Vec<(usize, Range<u64>)> {
        let Run { module, cycle, causes, step, .. } = &self.runs[run.0];
        let instance = &self.modules[*module];
        if !causes.has(RunCause::Messages) {
            return Vec::new();
        }
        match step {
            Some(step) => instance.steps.get(step).map_or_else(Vec::new, |step| step.inputs.clone()),
            None => {
                let Some(before) = cycle.checked_sub(1) else { return Vec::new() };
                let spans = instance.subscribes.iter().map(|&topic| (topic, self.of_cycle(topic, before)));
                spans.filter(|(_, span)| !span.is_empty()).collect()
            }
        }
    }

    /// The messages of a topic that were published in a cycle.
    fn of_cycle(&self, topic: usize, cycle: u64) -> Range<u64> {
        self.first_from(topic, |group| group.cycle < cycle)
            ..self.first_from(topic, |group| group.cycle <= cycle)
    }

    /// The last message of each subscription without messages in this run that the module had received
    /// before: its state may come from them.
    #[must_use]
    pub fn remembered(&self, run: RunId) -> Vec<MessageId> {
        let received = self.received_spans(run);
        let others = self.modules[self.runs[run.0].module].subscribes.iter().copied();
        let others = others.filter(|topic| received.iter().all(|(known, _)| known != topic));
        others.filter_map(|topic| self.last_before(run, topic)).collect()
    }

    /// The last message of a topic that a module had received before a run.
    fn last_before(&self, run: RunId, topic: usize) -> Option<MessageId> {
        let Run { module, cycle, step, .. } = &self.runs[run.0];
        let instance = &self.modules[*module];
        if let Some(step) = step {
            let received = instance.received.get(&topic)?;
            let position = received.partition_point(|(known, _)| known < step);
            let &(_, number) = received.get(position.checked_sub(1)?)?;
            return Some(MessageId { topic, number });
        }
        let groups = &self.topics[topic].groups;
        let before = groups.partition_point(|&group| self.groups[group].cycle.saturating_add(1) < *cycle);
        let candidates = groups[..before].iter().rev().map(|&group| &self.groups[group]);
        let mut candidates = candidates.take_while(|group| group.cycle >= instance.since);
        let last = candidates.find(|group| {
            let next = group.cycle.saturating_add(1);
            let found = instance.runs.binary_search_by_key(&next, |&run| self.runs[run.0].cycle);
            found.is_ok_and(|found| self.runs[instance.runs[found].0].causes.has(RunCause::Messages))
        })?;
        Some(MessageId { topic, number: last.first + u64::from(last.count) - 1 })
    }

    /// The run of the same module before this one.
    fn before(&self, run: RunId) -> Option<&Run> {
        let runs = &self.modules[self.runs[run.0].module].runs;
        let position = runs.partition_point(|known| *known < run);
        Some(&self.runs[runs[position.checked_sub(1)?].0])
    }

    /// The requests and answers for which a module ran.
    pub(super) fn calls_of(&self, run: RunId) -> Vec<&Called> {
        let Run { module, cycle, step, .. } = &self.runs[run.0];
        let instance = &self.modules[*module];
        if let Some(step) = step {
            let calls = instance.steps.get(step).map_or(&[][..], |step| &step.calls);
            return calls.iter().map(|&call| &self.calls[call]).collect();
        }
        // The previous run took what came before its cycle.
        let since = self.before(run).map_or(instance.since, |run| run.cycle);
        let first = self.calls.partition_point(|call| call.cycle < since);
        let end = self.calls.partition_point(|call| call.cycle < *cycle);
        let concerns = |position: &usize| match &self.calls[*position] {
            Called { is_answer: false, service, .. } => instance.serves.contains(service),
            answer => {
                // A module that has started again does not get the answers to what it asked before.
                answer.client.as_ref() == Some(&instance.name)
                    && answer.requested.is_none_or(|cycle| cycle >= instance.since)
            }
        };
        (first..end).filter(concerns).map(|position| &self.calls[position]).collect()
    }

    /// The run in which a request was made, or an answer given; `None` if that happened outside the robot.
    ///
    /// If several runs of a detached module joined in the cycle, the last one is meant.
    pub(super) fn run_behind(&self, call: &Called) -> Option<RunId> {
        let module = match call.is_answer {
            true => self.server(&call.service, call.cycle),
            false => self.instance(call.client.as_deref()?, call.cycle),
        };
        let runs = &self.modules[module?].runs;
        let position = runs.partition_point(|run| self.runs[run.0].cycle <= call.cycle);
        runs.get(position.checked_sub(1)?).copied().filter(|run| self.runs[run.0].cycle == call.cycle)
    }

    /// The settings that a run was the first to have.
    pub(super) fn settings_of(&self, run: RunId) -> impl Iterator<Item = &Arc<str>> {
        let Run { module, cycle, step, .. } = &self.runs[run.0];
        let Instance { name, since, .. } = &self.modules[*module];
        let since = self.before(run).map_or(*since, |run| run.cycle);
        let changes = self.changes.iter().filter(move |change| {
            change.module == *name
                && match step {
                    Some(_) => change.step == *step,
                    // The sync phase of a cycle follows its runs.
                    None => (since..*cycle).contains(&change.cycle),
                }
        });
        let settings: BTreeSet<_> = changes.flat_map(|change| &change.settings).collect();
        settings.into_iter()
    }

    /// The name of the module of a run.
    #[must_use]
    pub fn module(&self, run: RunId) -> &str {
        &self.modules[self.runs[run.0].module].name
    }

    /// The time that the module was given in a run.
    #[must_use]
    pub fn time(&self, run: RunId) -> Time {
        let Run { module, time, step, .. } = &self.runs[run.0];
        let step = step.and_then(|step| self.modules[*module].steps.get(&step));
        step.map_or(*time, |step| step.time)
    }
}
