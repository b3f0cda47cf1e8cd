//! How old the newest message of a topic is on which the messages of another topic depend.
//!
//! Each message carries the newest message of the first topic from which it comes (its *origin*), and a
//! module keeps the newest origin of all that it has received, because what it publishes may come from its
//! state. This is the propagation of timestamps by which cause-effect chains are measured.
//!
//! # References
//! N. Feiertag, K. Richter, J. Nordlander, J. Jonsson, "A compositional framework for end-to-end path delay
//! calculation of automotive systems under different path semantics", 2008: the age here is their
//! "last-to-last" delay, and the reaction their "last-to-first" delay.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use downbeat_executor::{
    CallError, CycleRuns, DetachedStep, ModuleEvent, ModuleEventKind, ModuleRun, Published, RunCause, Time,
    WiredModule, Wiring,
};

/// A module on the way of an origin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hop {
    /// The topic, or the service, by which the origin reached the module.
    pub by: Arc<str>,
    /// When the message with it was published.
    pub sent: Time,
    /// The time of the run that received it.
    pub received: Time,
    /// The module.
    pub module: Arc<str>,
    /// The time of the cycle in which the run that passed it on published.
    pub published: Time,
    before: Option<Arc<Hop>>,
}

/// The newest message of the first topic from which something comes.
#[derive(Clone)]
struct Origin {
    time: Time,
    /// Counts the messages of the first topic.
    number: u64,
    last: Option<Arc<Hop>>,
}

/// An origin in a module.
#[derive(Clone)]
struct Held {
    origin: Origin,
    by: Arc<str>,
    sent: Time,
    received: Time,
}

/// Messages of the last topic that one run published.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sample {
    /// When they were published.
    pub time: Time,
    /// How many they are.
    pub count: u32,
    /// The age of their origin.
    pub age: Duration,
    /// True for the first one with this origin: its age is the time of reaction.
    pub is_reaction: bool,
    last: Option<Arc<Hop>>,
}

impl Sample {
    /// The modules between the two topics, in the order in which they received the origin.
    #[must_use]
    pub fn hops(&self) -> Vec<Arc<Hop>> {
        let mut hops: Vec<_> = std::iter::successors(self.last.clone(), |hop| hop.before.clone()).collect();
        hops.reverse();
        hops
    }
}

/// A module, from its setup to its removal or restart.
#[derive(Default)]
struct ModuleState {
    held: Option<Held>,
    /// What requests and answers brought, until the next run: of a detached module that may have begun
    /// before.
    called: Option<Held>,
    /// The batches in the inbox of a detached module, by topic.
    inbox: HashMap<usize, VecDeque<Batch>>,
    /// The runs of a detached module that the next account contains.
    steps: VecDeque<DetachedStep>,
    is_on_way: bool,
}

/// A number of messages in an inbox, with their origin and the time at which they were published.
type Batch = (u32, Option<Origin>, Time);

/// How many batches of an inbox are told apart.
const MOST_BATCHES: usize = 4096;

/// The newest origin among the messages of a topic in one cycle.
#[derive(Clone, Default)]
struct Carried {
    cycle: Option<u64>,
    origin: Option<Origin>,
    time: Time,
}

#[derive(Default)]
struct TopicState {
    /// The detached modules that receive the topic.
    detached: Vec<usize>,
    is_first: bool,
    is_last: bool,
    /// It follows from the first topic, and leads to the last one.
    is_on_way: bool,
    last: Carried,
    before: Carried,
}

/// Measures one chain. What happens is to be passed in the order of cycles: in each cycle, the runs of
/// detached modules that joined in it ([`step`](Self::step)) and the events of earlier ones
/// ([`event`](Self::event)) before its account.
pub struct Latency {
    from: Arc<str>,
    to: Arc<str>,
    wiring: Option<Arc<Wiring>>,
    modules: Vec<ModuleState>,
    topics: Vec<TopicState>,
    /// The messages of the first topic so far.
    origins: u64,
    /// The origin of the newest sample.
    reacted: Option<u64>,
    /// Messages of the last topic that come from no message of the first one.
    without: u64,
    samples: Vec<Sample>,
}

impl Latency {
    /// Measures from messages on `from` to messages on `to`, names without a leading slash.
    #[must_use]
    pub fn new(from: &str, to: &str) -> Self {
        Self {
            from: from.into(),
            to: to.into(),
            wiring: None,
            modules: Vec::new(),
            topics: Vec::new(),
            origins: 0,
            reacted: None,
            without: 0,
            samples: Vec::new(),
        }
    }

    /// Takes the samples since the last call.
    pub fn take_samples(&mut self) -> impl Iterator<Item = Sample> {
        self.samples.drain(..)
    }

    /// How many messages of the last topic come from no message of the first one.
    #[must_use]
    pub fn without_origin(&self) -> u64 {
        self.without
    }

    /// How many messages of the first topic there were.
    #[must_use]
    pub fn origins(&self) -> u64 {
        self.origins
    }

    /// Notes a run of a detached module.
    pub fn step(&mut self, step: &DetachedStep) {
        if let Some(module) = self.module(&step.module).filter(|&module| self.modules[module].is_on_way) {
            self.modules[module].steps.push_back(step.clone());
        }
    }

    /// Takes what a run of a detached module received out of its inbox, and what earlier runs did that called
    /// no callback.
    fn receive_detached(&mut self, wiring: &Wiring, module: usize, run: Option<&ModuleRun>) {
        let ModuleState { held, called, inbox, steps, .. } = &mut self.modules[module];
        while let Some(step) = steps.pop_front() {
            let run = run.filter(|run| run.step == Some(step.step));
            let is_received = run.is_some_and(|run| run.causes.has(RunCause::Messages));
            for (&topic, waiting) in &mut *inbox {
                let Some(name) = wiring.topics.get(topic) else { continue };
                let Some(input) = step.inputs.iter().find(|input| input.topic == *name) else { continue };
                take_batches(waiting, input.skipped, |_, _| ());
                take_batches(waiting, input.received, |origin, sent| {
                    if is_received {
                        let by = Arc::clone(name);
                        take_newer(held, Some(Held { origin, by, sent, received: step.time }), step.time);
                    }
                });
            }
            if run.is_some() {
                return take_newer(held, called.take(), step.time);
            }
        }
    }

    /// Notes a request or an answer.
    pub fn event(&mut self, event: &ModuleEvent) {
        let Some(wiring) = self.wiring.clone() else { return };
        let server =
            |service: &Arc<str>| wiring.modules.iter().position(|module| module.serves.contains(service));
        let client = |client: &Option<Arc<str>>| client.as_ref().and_then(|client| self.module(client));
        let (service, from, to) = match &event.kind {
            ModuleEventKind::Request { service, origin, .. } => {
                (service, client(&origin.client), server(service))
            }
            // No run has answered.
            ModuleEventKind::Answer {
                result: Err(CallError::NoServer { .. } | CallError::ServerGone { .. }),
                ..
            } => return,
            ModuleEventKind::Answer { service, origin, .. } => {
                (service, server(service), client(&origin.client))
            }
            _ => return,
        };
        let (Some(from), Some(to)) = (from, to) else { return };
        if let Some(origin) = self.pass_on(&wiring, from, event.time) {
            let held = Held { origin, by: Arc::clone(service), sent: event.time, received: event.time };
            take_newer(&mut self.modules[to].called, Some(held), event.time);
        }
    }

    /// Notes the runs of a cycle.
    pub fn account(&mut self, account: &CycleRuns) {
        let wiring = &account.wiring;
        if !self.wiring.as_ref().is_some_and(|known| Arc::ptr_eq(known, wiring)) {
            self.wire(wiring);
        }
        for published in &account.from_inlets {
            self.publish(wiring, account, published, None);
        }
        for run in &account.runs {
            let module = run.module as usize;
            let on_way = self.modules.get_mut(module).filter(|module| module.is_on_way);
            let is_on_way = on_way.is_some();
            match on_way {
                Some(_) if run.step.is_some() => self.receive_detached(wiring, module, Some(run)),
                Some(ModuleState { held, called, .. }) => {
                    take_newer(held, called.take(), account.time);
                    if run.causes.has(RunCause::Messages) {
                        self.receive(wiring, module, account);
                    }
                }
                None => {}
            }
            for published in account.published(run) {
                self.publish(wiring, account, published, is_on_way.then_some(module));
            }
        }
        for module in 0..self.modules.len() {
            if !self.modules[module].steps.is_empty() {
                self.receive_detached(wiring, module, None);
            }
        }
    }

    /// Takes the newest origin among the messages of the cycle before.
    fn receive(&mut self, wiring: &Wiring, module: usize, account: &CycleRuns) {
        for &topic in &wiring.modules[module].subscribes {
            let Some(state) = self.topics.get(topic as usize).filter(|topic| topic.is_on_way) else {
                continue;
            };
            let carried = [&state.last, &state.before].into_iter();
            let before = account.cycle.checked_sub(1);
            if let Some(Carried { origin: Some(origin), time, .. }) =
                carried.into_iter().find(|carried| carried.cycle.is_some() && carried.cycle == before)
            {
                let by = Arc::clone(&wiring.topics[topic as usize]);
                let held = Held { origin: origin.clone(), by, sent: *time, received: account.time };
                take_newer(&mut self.modules[module].held, Some(held), account.time);
            }
        }
    }

    fn publish(
        &mut self,
        wiring: &Wiring,
        account: &CycleRuns,
        published: &Published,
        module: Option<usize>,
    ) {
        let topic = published.topic as usize;
        let Some(&TopicState { is_first, is_last, is_on_way, .. }) = self.topics.get(topic) else { return };
        if !(is_first || is_last || is_on_way) {
            return;
        }
        let mut origin = module.and_then(|module| self.pass_on(wiring, module, account.time));
        if is_last {
            self.sample(origin.as_ref(), published.count, account.time);
        }
        if is_first {
            self.origins += u64::from(published.count);
            origin = Some(Origin { time: account.time, number: self.origins, last: None });
        }
        let TopicState { detached, last, before, .. } = &mut self.topics[topic];
        for &module in &*detached {
            let inbox = self.modules[module].inbox.entry(topic).or_default();
            // Of a module that stands still for long, the inbox is known less exactly.
            let is_full = inbox.len() >= MOST_BATCHES;
            match inbox.back_mut().filter(|_| is_full) {
                Some((count, newest, _)) => {
                    *count = count.saturating_add(published.count);
                    *newest = origin.clone().or(newest.take());
                }
                None => inbox.push_back((published.count, origin.clone(), account.time)),
            }
        }
        if last.cycle != Some(account.cycle) {
            *before = std::mem::replace(
                last,
                Carried { cycle: Some(account.cycle), origin: None, time: account.time },
            );
        }
        if let Some(origin) = origin
            && last.origin.as_ref().is_none_or(|known| known.number < origin.number)
        {
            last.origin = Some(origin);
        }
    }

    /// The origin of what a module publishes.
    fn pass_on(&self, wiring: &Wiring, module: usize, published: Time) -> Option<Origin> {
        let Held { origin, by, sent, received } = self.modules.get(module)?.held.as_ref()?;
        let hop = Hop {
            by: Arc::clone(by),
            sent: *sent,
            received: *received,
            module: Arc::clone(&wiring.modules[module].name),
            published,
            before: origin.last.clone(),
        };
        Some(Origin { last: Some(Arc::new(hop)), ..*origin })
    }

    fn sample(&mut self, origin: Option<&Origin>, count: u32, time: Time) {
        let Some(origin) = origin else {
            self.without += u64::from(count);
            return;
        };
        let is_reaction = self.reacted != Some(origin.number);
        self.reacted = Some(origin.number);
        let (age, last) = (time.saturating_since(origin.time), origin.last.clone());
        self.samples.push(Sample { time, count, age, is_reaction, last });
    }

    fn module(&self, name: &Arc<str>) -> Option<usize> {
        self.wiring.as_ref()?.modules.iter().position(|module| module.name == *name)
    }

    /// Follows a change of the modules and topics. A module that started again has forgotten what it
    /// received.
    fn wire(&mut self, wiring: &Arc<Wiring>) {
        let known = self.wiring.replace(Arc::clone(wiring)).unwrap_or_default();
        let mut topics: HashMap<_, _> = known.topics.iter().zip(std::mem::take(&mut self.topics)).collect();
        self.topics = wiring.topics.iter().map(|topic| topics.remove(topic).unwrap_or_default()).collect();
        let ids = known.modules.iter().map(|module| (Arc::clone(&module.name), module.since));
        let mut modules: HashMap<_, _> = ids.zip(std::mem::take(&mut self.modules)).collect();
        let module = |module: &WiredModule| {
            let mut state = modules.remove(&(Arc::clone(&module.name), module.since)).unwrap_or_default();
            let inbox = std::mem::take(&mut state.inbox).into_iter();
            let moved = inbox.filter_map(|(topic, batches)| {
                let topic = wiring.topics.iter().position(|name| Some(name) == known.topics.get(topic))?;
                Some((topic, batches))
            });
            state.inbox = moved.collect();
            state
        };
        self.modules = wiring.modules.iter().map(module).collect();
        self.find_way(wiring);
    }

    /// Marks the modules and topics between the two ends.
    fn find_way(&mut self, wiring: &Wiring) {
        let position = |name: &Arc<str>| wiring.topics.iter().position(|topic| topic == name);
        let (from, to) = (position(&self.from), position(&self.to));
        let (after, before) = (reached(wiring, from, true), reached(wiring, to, false));
        for (topic, state) in self.topics.iter_mut().enumerate() {
            (state.is_first, state.is_last) = (Some(topic) == from, Some(topic) == to);
            let is_after = after.topics[topic] || state.is_first;
            state.is_on_way = is_after && (before.topics[topic] || state.is_last);
            state.detached.clear();
        }
        for (module, (state, wired)) in self.modules.iter_mut().zip(&wiring.modules).enumerate() {
            state.is_on_way = after.modules[module] && before.modules[module];
            if state.is_on_way && wired.is_detached {
                for &topic in &wired.subscribes {
                    if let Some(topic) = self.topics.get_mut(topic as usize) {
                        topic.detached.push(module);
                    }
                }
            }
        }
    }
}

/// The modules and topics that can be reached.
struct Reached {
    modules: Vec<bool>,
    topics: Vec<bool>,
}

/// What follows from a topic, or what leads to it. Services lead both ways.
fn reached(wiring: &Wiring, topic: Option<usize>, is_forward: bool) -> Reached {
    let mut reached =
        Reached { modules: vec![false; wiring.modules.len()], topics: vec![false; wiring.topics.len()] };
    let mut topics: Vec<usize> = topic.into_iter().collect();
    let mut modules = Vec::new();
    loop {
        for (number, module) in wiring.modules.iter().enumerate() {
            let ends = if is_forward { &module.subscribes } else { &module.publishes };
            let touches = |topic: &u32| topics.contains(&(*topic as usize));
            let shares = |other: &usize| {
                let other = &wiring.modules[*other];
                other.calls.iter().any(|service| module.serves.contains(service))
                    || other.serves.iter().any(|service| module.calls.contains(service))
            };
            if !reached.modules[number] && (ends.iter().any(touches) || modules.iter().any(shares)) {
                reached.modules[number] = true;
            }
        }
        let new: Vec<usize> = (0..wiring.modules.len())
            .filter(|number| reached.modules[*number] && !modules.contains(number))
            .collect();
        if new.is_empty() {
            return reached;
        }
        for &number in &new {
            let module = &wiring.modules[number];
            let ends = if is_forward { &module.publishes } else { &module.subscribes };
            for &topic in ends {
                if let Some(known) = reached.topics.get_mut(topic as usize)
                    && !std::mem::replace(known, true)
                {
                    topics.push(topic as usize);
                }
            }
        }
        modules.extend(new);
    }
}

/// Takes messages out of an inbox, and passes the origins of their batches to `receive`.
fn take_batches(waiting: &mut VecDeque<Batch>, mut messages: u32, mut receive: impl FnMut(Origin, Time)) {
    while messages > 0
        && let Some((count, origin, sent)) = waiting.front_mut()
    {
        let taken = messages.min(*count);
        (messages, *count) = (messages - taken, *count - taken);
        if let Some(origin) = origin.clone() {
            receive(origin, *sent);
        }
        if *count == 0 {
            waiting.pop_front();
        }
    }
}

/// Keeps the first arrival of each origin: in a loop of modules, its way would grow with each round.
fn take_newer(held: &mut Option<Held>, other: Option<Held>, now: Time) {
    if let Some(other) = other
        && held.as_ref().is_none_or(|held| held.origin.number < other.origin.number)
    {
        *held = Some(Held { received: now, ..other });
    }
}

/// A distribution of ages.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ages {
    sorted: Vec<(Duration, u32)>,
    count: u64,
}

impl Ages {
    /// The distribution of these ages, each with the number of messages that have it.
    #[must_use]
    pub fn new(ages: impl IntoIterator<Item = (Duration, u32)>) -> Self {
        let mut sorted: Vec<_> = ages.into_iter().collect();
        sorted.sort_unstable();
        let count = sorted.iter().map(|&(_, count)| u64::from(count)).sum();
        Self { sorted, count }
    }

    /// The number of messages.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The smallest age that at least this share of the messages do not exceed; `None` without messages.
    #[must_use]
    pub fn quantile(&self, share: f64) -> Option<Duration> {
        let rank = (share.clamp(0.0, 1.0) * self.count as f64).ceil().max(1.0) as u64;
        let mut passed = 0;
        let age = self.sorted.iter().find(|&&(_, count)| {
            passed += u64::from(count);
            passed >= rank
        });
        age.or(self.sorted.last()).map(|&(age, _)| age)
    }

    /// The ages in ascending order, each with the number of messages that have it.
    pub fn iter(&self) -> impl Iterator<Item = (Duration, u32)> {
        self.sorted.iter().copied()
    }
}
