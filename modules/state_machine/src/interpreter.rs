//! Runs a chart: events in, effects out.
//!
//! The algorithm is that of appendix D of the recommendation: the smallest steps take all transitions that an
//! event enables and that do not preempt each other, and a macrostep goes on until no transition without
//! event is enabled and no internal event waits. Time is given from outside, and nothing depends on anything
//! but the calls, in their order.
//!
//! # References
//! - State Chart XML (SCXML): State Machine Notation for Control Abstraction, W3C Recommendation 1 September
//!   2015.

use crate::chart::{ASSIGNED, Action, Chart, Data, Given, Payload, Send, StateKind, Transition, duration};
use crate::expressions::{Evaluator, Problem, Program};
use rhai::{Dynamic, Map, Scope};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::Duration;

/// Steps of one macrostep, and events that a chart may send itself between two calls: more are a loop without
/// an end.
const MOST_STEPS: usize = 1000;
/// Delayed events that wait at once, and events in a queue.
const MOST_WAITING: usize = 4096;

/// An event for a chart, or of one.
#[derive(Clone, Debug)]
pub struct Event {
    /// Words separated by dots.
    pub name: String,
    /// What comes with it, `()` if nothing.
    pub data: Dynamic,
    kind: EventKind,
    send_id: Option<String>,
    /// Whether the chart sent it itself.
    is_own: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum EventKind {
    Internal,
    External,
    Platform,
}

/// What a chart does to the world.
#[derive(Clone, Debug)]
pub enum Effect {
    /// A line for the log.
    Log {
        /// Names the line; perhaps empty.
        label: String,
        /// The value as text.
        text: String,
        /// Where the chart says so.
        line: u32,
    },
    /// A message, call or goal for a port of the chart.
    Send {
        /// The name of the port.
        target: String,
        /// The event, if it has one.
        event: Option<String>,
        /// The fields.
        data: Dynamic,
        /// The id, if it has one.
        id: Option<String>,
        /// Where the chart says so.
        line: u32,
    },
    /// A transition was taken.
    Taken {
        /// The id of its source; empty for the first entry.
        source: String,
        /// The ids of its targets.
        targets: Vec<String>,
        /// The name of the event; empty without one.
        event: String,
    },
    /// Something in the chart failed; the event `error.execution` or `error.communication` says so to the
    /// chart.
    Fault(Problem),
}

/// What a chart remembers when another version of it takes over.
#[derive(Debug)]
pub struct Memory {
    active: Vec<String>,
    entered: BTreeMap<String, Duration>,
    history: BTreeMap<String, Vec<String>>,
    /// The values of the data, with the expressions of their first values.
    data: BTreeMap<String, (Option<String>, Dynamic)>,
    delayed: Vec<Delayed>,
    received: BTreeMap<String, (Option<Duration>, Dynamic)>,
    is_running: bool,
    made_up: u64,
}

#[derive(Clone, Debug)]
struct Delayed {
    due: Duration,
    id: Option<String>,
    target: Target,
    event: Event,
    line: u32,
}

#[derive(Clone, Debug)]
enum Target {
    Own,
    Internal,
    Port(String),
}

/// A chart that runs.
#[derive(Debug)]
pub struct Interpreter {
    chart: Arc<Chart>,
    evaluator: Evaluator,
    scope: Scope<'static>,
    /// In document order, all ancestors included.
    active: BTreeSet<usize>,
    /// Active states at the last exit of each history's parent.
    history: BTreeMap<usize, Vec<usize>>,
    internal: VecDeque<Event>,
    external: VecDeque<Event>,
    delayed: Vec<Delayed>,
    /// States whose late data have their values.
    initialised: BTreeSet<usize>,
    is_running: bool,
    effects: Vec<Effect>,
    /// The session, and how many ids were made up.
    session: String,
    made_up: u64,
}

/// The reason an executable content ended early.
struct Failure {
    event: &'static str,
    problem: Problem,
    send_id: Option<String>,
}

impl From<Problem> for Failure {
    fn from(problem: Problem) -> Self {
        Self { event: "error.execution", problem, send_id: None }
    }
}

impl Event {
    /// An event from outside.
    #[must_use]
    pub fn new(name: &str, data: Dynamic) -> Self {
        Self { name: name.to_owned(), data, kind: EventKind::External, send_id: None, is_own: false }
    }

    /// The same in answer to a `<send>` with this id.
    #[must_use]
    pub fn of(self, send_id: Option<String>) -> Self {
        Self { send_id, ..self }
    }

    fn internal(name: &str, data: Dynamic) -> Self {
        Self { kind: EventKind::Internal, ..Self::new(name, data) }
    }

    fn as_map(&self) -> Map {
        let text = |text: Option<&str>| text.map_or(Dynamic::UNIT, |text| text.to_owned().into());
        let kind = match self.kind {
            EventKind::Internal => "internal",
            EventKind::External => "external",
            EventKind::Platform => "platform",
        };
        let (origin, origin_type) =
            if self.is_own { (Some("#_scxml_self"), Some(PROCESSOR)) } else { (None, None) };
        Map::from([
            ("name".into(), self.name.clone().into()),
            ("type".into(), kind.to_owned().into()),
            ("sendid".into(), text(self.send_id.as_deref())),
            ("origin".into(), text(origin)),
            ("origintype".into(), text(origin_type)),
            ("invokeid".into(), Dynamic::UNIT),
            ("data".into(), self.data.clone()),
        ])
    }
}

/// The name of the processor of events that every chart has: its own queue.
const PROCESSOR: &str = "http://www.w3.org/TR/scxml/#SCXMLEventProcessor";

impl Interpreter {
    /// A chart at rest; `session` is its name, for its expressions `_sessionid`.
    #[must_use]
    pub fn new(chart: Arc<Chart>, session: &str) -> Self {
        let mut scope = Scope::new();
        let processor = Map::from([("location".into(), format!("#_scxml_{session}").into())]);
        let processors = [PROCESSOR, "scxml"].map(|name| (name.into(), processor.clone().into()));
        scope.push("_name", chart.name.clone());
        scope.push("_sessionid", session.to_owned());
        scope.push("_ioprocessors", Map::from(processors));
        scope.push_dynamic("_event", Dynamic::UNIT);
        scope.push("setting", Map::new());
        let evaluator = Evaluator::new();
        for port in &chart.interface.subscriptions {
            scope.push_dynamic(port.name.clone(), Dynamic::UNIT);
            evaluator.world.write().received.insert(port.name.clone(), None);
        }
        for data in chart.states.iter().flat_map(|state| &state.data) {
            scope.push_dynamic(data.id.clone(), Dynamic::UNIT);
        }
        Self {
            chart,
            evaluator,
            scope,
            active: BTreeSet::new(),
            history: BTreeMap::new(),
            internal: VecDeque::new(),
            external: VecDeque::new(),
            delayed: Vec::new(),
            initialised: BTreeSet::new(),
            is_running: false,
            effects: Vec::new(),
            session: session.to_owned(),
            made_up: 0,
        }
    }

    /// Interrupts scripts that run for long when `is_stopping`.
    pub fn interrupt_when(&self, is_stopping: impl Fn() -> bool + std::marker::Send + Sync + 'static) {
        self.evaluator.interrupt_when(Box::new(is_stopping));
    }

    /// The chart.
    #[must_use]
    pub fn chart(&self) -> &Chart {
        &self.chart
    }

    /// The ids of the active states, in document order.
    pub fn active(&self) -> impl Iterator<Item = &str> {
        self.active.iter().filter(|&&state| state > 0).map(|&state| self.chart.states[state].id.as_str())
    }

    /// The ids of the innermost active states, in document order.
    pub fn active_leaves(&self) -> impl Iterator<Item = &str> {
        let leaves = self.active.iter().filter(|&&state| self.chart.states[state].is_atomic());
        leaves.map(|&state| self.chart.states[state].id.as_str())
    }

    /// Whether it has started and not reached a final state of the whole chart.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.is_running
    }

    /// When the next delayed event is due.
    #[must_use]
    pub fn next_due(&self) -> Option<Duration> {
        self.delayed.iter().map(|delayed| delayed.due).min()
    }

    /// The value of a variable.
    #[must_use]
    pub fn variable(&self, name: &str) -> Option<&Dynamic> {
        self.scope.get(name)
    }

    /// Gives a variable that expressions cannot change its value: a setting or the latest message.
    pub fn provide(&mut self, name: &str, value: Dynamic) {
        provide(&mut self.scope, name, value);
    }

    /// As [`provide`](Self::provide) for a message that is received now.
    pub fn receive(&mut self, name: &str, message: Dynamic, now: Duration) {
        self.provide(name, message);
        self.evaluator.world.write().received.insert(name.to_owned(), Some(now));
    }

    /// Enters the first states and does what follows without an event.
    pub fn start(&mut self, now: Duration) -> Vec<Effect> {
        self.evaluator.begin(now);
        if self.is_running || !self.active.is_empty() {
            return Vec::new();
        }
        self.is_running = true;
        let chart = Arc::clone(&self.chart);
        for (number, state) in
            chart.states.iter().enumerate().take(if chart.is_late { 1 } else { usize::MAX })
        {
            self.initialise(number, &state.data);
        }
        for script in &chart.scripts {
            let result = self.evaluator.run(script, &mut self.scope);
            self.note(result.map_err(Failure::from));
        }
        let mut enter = Entering::default();
        self.add_default(0, &mut enter);
        let targets = enter.states.iter().filter(|&&state| chart.states[state].is_atomic());
        let targets = targets.map(|&state| chart.states[state].id.clone()).collect();
        self.effects.push(Effect::Taken { source: String::new(), targets, event: String::new() });
        self.enter(&enter);
        self.finish_macrostep();
        self.advance(now)
    }

    /// Adds an event from outside, for the next [`advance`](Self::advance).
    pub fn send(&mut self, event: Event) {
        if self.external.len() < MOST_WAITING {
            self.external.push_back(event);
        } else {
            let text = format!("more than {MOST_WAITING} events wait; \"{}\" is dropped", event.name);
            self.effects.push(Effect::Fault(Problem { line: 1, text }));
        }
    }

    /// Takes all events that wait or are due. Returns what the chart does, in this order. Transitions without
    /// event are looked at in any case, since variables may have changed.
    pub fn advance(&mut self, now: Duration) -> Vec<Effect> {
        self.evaluator.begin(now);
        self.take_due(now);
        if self.is_running {
            self.finish_macrostep();
        }
        for _ in 0..MOST_STEPS + self.external.len() {
            if !self.is_running {
                break;
            }
            let Some(event) = self.external.pop_front() else { return std::mem::take(&mut self.effects) };
            provide(&mut self.scope, "_event", event.as_map().into());
            let enabled = self.enabled(Some(&event));
            self.microstep(&enabled, &event.name);
            self.finish_macrostep();
        }
        if self.is_running {
            let events: BTreeSet<String> = self.external.drain(..).map(|event| event.name).collect();
            let events = events.into_iter().collect::<Vec<_>>().join(", ");
            let text =
                format!("the chart sends itself events without an end: {events}; give the <send> a delay");
            self.effects.push(Effect::Fault(Problem { line: 1, text }));
        }
        self.external.clear();
        std::mem::take(&mut self.effects)
    }

    /// What another version of the chart needs to go on.
    #[must_use]
    pub fn memory(&self) -> Memory {
        let id = |&state: &usize| self.chart.states[state].id.clone();
        let world = self.evaluator.world.read();
        let data = self.chart.states.iter().flat_map(|state| &state.data).map(|data| {
            let value = self.scope.get(&data.id).cloned().unwrap_or_default();
            (data.id.clone(), (data.value.as_ref().map(|value| value.text.clone()), value))
        });
        let message = |(name, at): (&String, &Option<Duration>)| {
            (name.clone(), (*at, self.scope.get(name).cloned().unwrap_or_default()))
        };
        Memory {
            active: self.active.iter().skip(1).map(id).collect(),
            entered: world.entered.clone(),
            history: self
                .history
                .iter()
                .map(|(state, kept)| (id(state), kept.iter().map(id).collect()))
                .collect(),
            data: data.collect(),
            delayed: self.delayed.clone(),
            received: world.received.iter().map(message).collect(),
            is_running: self.is_running,
            made_up: self.made_up,
        }
    }

    /// Starts with the memory of another version instead of with the first states: active states that still
    /// exist stay active without being entered again, and the initial states complete them. Data keep their
    /// values unless the expressions of their first values have changed; messages, histories and delayed
    /// events are kept.
    pub fn resume(&mut self, memory: Memory, now: Duration) -> Vec<Effect> {
        let chart = Arc::clone(&self.chart);
        self.evaluator.begin(now);
        self.is_running = true;
        for (number, state) in chart.states.iter().enumerate() {
            self.initialise(number, &state.data);
            self.initialised.insert(number);
            for data in &state.data {
                let first = data.value.as_ref().map(|value| &value.text);
                if let Some((_, value)) = memory.data.get(&data.id).filter(|(old, _)| old.as_ref() == first) {
                    self.scope.set_value(data.id.clone(), value.clone());
                }
            }
        }
        for (name, (at, message)) in memory.received {
            if self.evaluator.world.read().received.contains_key(&name) && at.is_some() {
                self.provide(&name, message);
                self.evaluator.world.write().received.insert(name, at);
            }
        }
        let found = |ids: &[String]| ids.iter().filter_map(|id| chart.state(id)).collect::<Vec<_>>();
        for (id, kept) in &memory.history {
            let Some(history) = chart.state(id).filter(|&state| chart.states[state].is_history()) else {
                continue;
            };
            let Some(parent) = chart.states[history].parent else { continue };
            let is_fit =
                |state: &usize| chart.is_inside(*state, parent) && !chart.states[*state].is_history();
            let kept: Vec<usize> = found(kept).into_iter().filter(is_fit).collect();
            if !kept.is_empty() && self.can_be_together(parent, &kept) {
                self.history.insert(history, kept);
            }
        }
        self.made_up = memory.made_up;
        self.delayed = memory.delayed;
        let ended = !memory.is_running;
        let mut kept: BTreeSet<usize> =
            found(&memory.active).into_iter().filter(|&state| !chart.states[state].is_history()).collect();
        // A chart that had ended goes on if it no longer ends there.
        if ended
            && kept.iter().any(|&state| {
                chart.states[state].parent == Some(0) && chart.states[state].kind == StateKind::Final
            })
        {
            self.is_running = false;
        }
        let above: Vec<usize> = kept.iter().flat_map(|&state| chart.ancestors(state)).collect();
        let named = kept.clone();
        kept.extend(above);
        let mut enter = Entering::default();
        self.complete(0, &kept, &mut enter);
        for &state in &enter.states {
            if named.contains(&state) {
                self.active.insert(state);
                let id = chart.states[state].id.clone();
                let since = memory.entered.get(&id).copied().unwrap_or(now);
                self.evaluator.world.write().entered.insert(id, since);
            }
        }
        self.active.insert(0);
        enter.states.retain(|state| !self.active.contains(state));
        let was_running = self.is_running;
        self.enter(&enter);
        self.is_running &= was_running;
        if self.is_running { self.advance(now) } else { std::mem::take(&mut self.effects) }
    }

    /// Whether a set of states can be the innermost states of one configuration inside a state.
    fn can_be_together(&self, outer: usize, states: &[usize]) -> bool {
        let chart = &self.chart;
        states.iter().enumerate().all(|(number, &a)| {
            states[number + 1..].iter().all(|&b| {
                let innermost = chart.ancestors(a).find(|&around| chart.is_inside(b, around));
                a != b
                    && innermost.is_some_and(|around| {
                        chart.states[around].kind == StateKind::Parallel
                            && (around == outer || chart.is_inside(around, outer))
                    })
            })
        })
    }

    /// Adds a state, and those inside that were active or else its initial ones.
    fn complete(&self, state: usize, kept: &BTreeSet<usize>, enter: &mut Entering) {
        enter.states.insert(state);
        let chart = &self.chart;
        match chart.states[state].kind {
            StateKind::Compound => {
                match chart.states[state].children.iter().find(|child| kept.contains(child)) {
                    Some(&child) => self.complete(child, kept, enter),
                    None => self.add_default(state, enter),
                }
            }
            StateKind::Parallel => {
                chart.states[state].children.iter().for_each(|&child| self.complete(child, kept, enter));
            }
            _ => {}
        }
    }

    fn take_due(&mut self, now: Duration) {
        // Stable: in the order in which they were sent.
        self.delayed.sort_by_key(|delayed| delayed.due);
        let count = self.delayed.iter().take_while(|delayed| delayed.due <= now).count();
        for Delayed { target, event, id, line, .. } in self.delayed.drain(..count).collect::<Vec<_>>() {
            self.deliver(target, event, id, line);
        }
    }

    fn deliver(&mut self, target: Target, event: Event, id: Option<String>, line: u32) {
        match target {
            Target::Own => self.send(event),
            Target::Internal => self.raise(event),
            Target::Port(target) => {
                let name = (!event.name.is_empty()).then_some(event.name);
                self.effects.push(Effect::Send { target, event: name, data: event.data, id, line });
            }
        }
    }

    fn raise(&mut self, event: Event) {
        if self.internal.len() < MOST_WAITING {
            self.internal.push_back(event);
        }
    }

    /// Takes transitions without event, and internal events, until there are none.
    fn finish_macrostep(&mut self) {
        let mut recent = VecDeque::new();
        for _ in 0..MOST_STEPS {
            if !self.is_running {
                self.internal.clear();
                return;
            }
            let mut name = String::new();
            let mut enabled = self.enabled(None);
            if enabled.is_empty() {
                let Some(event) = self.internal.pop_front() else { return };
                provide(&mut self.scope, "_event", event.as_map().into());
                enabled = self.enabled(Some(&event));
                name = event.name;
            }
            if let Some(&first) = enabled.first() {
                recent.push_back(self.chart.transitions[first].line);
                if recent.len() > 16 {
                    recent.pop_front();
                }
            }
            self.microstep(&enabled, &name);
        }
        self.internal.clear();
        let lines: BTreeSet<u32> = recent.into_iter().collect();
        let line = lines.first().copied().unwrap_or(1);
        let lines = lines.iter().map(u32::to_string).collect::<Vec<_>>().join(", ");
        let text = format!(
            "after {MOST_STEPS} steps the chart has not come to rest: the transitions on lines {lines} follow each other \
             without an event from outside; give one of them a `cond` or an `event`"
        );
        self.effects.push(Effect::Fault(Problem { line, text }));
    }

    /// The transitions that an event enables, or that are enabled without one; of those that would exit the
    /// same states, the ones of inner states.
    fn enabled(&mut self, event: Option<&Event>) -> Vec<usize> {
        let chart = Arc::clone(&self.chart);
        let mut enabled = Vec::new();
        let leaves: Vec<usize> =
            self.active.iter().copied().filter(|&state| chart.states[state].is_atomic()).collect();
        for leaf in leaves {
            'search: for state in std::iter::once(leaf).chain(chart.ancestors(leaf)) {
                for &number in &chart.states[state].transitions {
                    let transition = &chart.transitions[number];
                    let is_meant = match event {
                        None => transition.events.is_empty(),
                        Some(event) => transition.events.iter().any(|wanted| matches(wanted, &event.name)),
                    };
                    if is_meant && (enabled.contains(&number) || self.is_allowed(transition)) {
                        if !enabled.contains(&number) {
                            enabled.push(number);
                        }
                        break 'search;
                    }
                }
            }
        }
        self.without_conflicts(enabled)
    }

    fn is_allowed(&mut self, transition: &Transition) -> bool {
        let Some(condition) = &transition.condition else { return true };
        let held = self.evaluator.holds(condition, &mut self.scope);
        held.unwrap_or_else(|problem| {
            self.note(Err(problem.into()));
            false
        })
    }

    fn without_conflicts(&self, enabled: Vec<usize>) -> Vec<usize> {
        let mut kept: Vec<(usize, BTreeSet<usize>)> = Vec::new();
        for number in enabled {
            let exits = self.exits(number);
            let source = self.chart.transitions[number].source;
            let conflicting = |(_, others): &(usize, BTreeSet<usize>)| !others.is_disjoint(&exits);
            let is_inner = |(other, _): &(usize, BTreeSet<usize>)| {
                self.chart.is_inside(source, self.chart.transitions[*other].source)
            };
            if kept.iter().filter(|other| conflicting(other)).all(is_inner) {
                kept.retain(|other| !conflicting(other));
                kept.push((number, exits));
            }
        }
        kept.into_iter().map(|(number, _)| number).collect()
    }

    /// The states that a transition exits.
    fn exits(&self, transition: usize) -> BTreeSet<usize> {
        match self.domain(transition) {
            Some(domain) => {
                let inside = self.active.range(domain + 1..self.chart.states[domain].end);
                inside.copied().collect()
            }
            None => BTreeSet::new(),
        }
    }

    /// The innermost state that stays active in a transition; `None` without targets.
    fn domain(&self, transition: usize) -> Option<usize> {
        let Transition { source, is_internal, .. } = self.chart.transitions[transition];
        let mut states = self.effective_targets(transition);
        if states.is_empty() {
            return None;
        }
        let is_within = states.iter().all(|&target| self.chart.is_inside(target, source));
        if is_internal && self.chart.states[source].kind == StateKind::Compound && is_within {
            return Some(source);
        }
        states.insert(0, source);
        Some(self.chart.common_ancestor(&states))
    }

    /// The targets, histories replaced by what they stand for.
    fn effective_targets(&self, transition: usize) -> Vec<usize> {
        let mut targets = Vec::new();
        for &target in &self.chart.transitions[transition].targets {
            let state = &self.chart.states[target];
            match (state.is_history(), self.history.get(&target), state.initial) {
                (false, ..) => targets.push(target),
                (true, Some(kept), _) => targets.extend(kept),
                (true, None, Some(default)) => targets.extend(self.effective_targets(default)),
                (true, None, None) => {}
            }
        }
        targets
    }

    fn microstep(&mut self, enabled: &[usize], event: &str) {
        if enabled.is_empty() {
            return;
        }
        let chart = Arc::clone(&self.chart);
        let mut exits = BTreeSet::new();
        for &number in enabled {
            exits.extend(self.exits(number));
        }
        self.exit(&exits);
        for &number in enabled {
            let transition = &chart.transitions[number];
            let name = |&state: &usize| chart.states[state].id.clone();
            self.effects.push(Effect::Taken {
                source: name(&transition.source),
                targets: transition.targets.iter().map(name).collect(),
                event: event.to_owned(),
            });
            self.execute(&transition.actions);
        }
        // After the exit: it has changed histories.
        let mut enter = Entering::default();
        for &number in enabled {
            if let Some(domain) = self.domain(number) {
                self.add_targets(number, domain, &mut enter);
            }
        }
        self.enter(&enter);
    }

    fn exit(&mut self, exits: &BTreeSet<usize>) {
        let chart = Arc::clone(&self.chart);
        for &state in exits {
            for &history in &chart.states[state].histories {
                let is_kept = |&inner: &usize| match chart.states[history].kind {
                    StateKind::Deep => chart.is_inside(inner, state) && chart.states[inner].is_atomic(),
                    _ => chart.states[inner].parent == Some(state),
                };
                self.history.insert(history, self.active.iter().copied().filter(is_kept).collect());
            }
        }
        for &state in exits.iter().rev() {
            for block in &chart.states[state].exit {
                self.execute(block);
            }
            self.active.remove(&state);
            self.evaluator.world.write().entered.remove(&chart.states[state].id);
        }
    }

    fn add_targets(&self, transition: usize, domain: usize, enter: &mut Entering) {
        for &target in &self.chart.transitions[transition].targets {
            self.add_descendants(target, enter);
        }
        for target in self.effective_targets(transition) {
            self.add_ancestors(target, domain, enter);
        }
    }

    fn add_descendants(&self, state: usize, enter: &mut Entering) {
        let of = &self.chart.states[state];
        if of.is_history() {
            let Some(parent) = of.parent else { return };
            match (self.history.get(&state), of.initial) {
                (Some(kept), _) => {
                    kept.iter().for_each(|&kept| self.add_descendants(kept, enter));
                    kept.iter().for_each(|&kept| self.add_ancestors(kept, parent, enter));
                }
                (None, Some(default)) => {
                    enter.history_defaults.insert(parent, default);
                    self.add_targets(default, parent, enter);
                }
                (None, None) => {}
            }
            return;
        }
        enter.states.insert(state);
        match of.kind {
            StateKind::Compound => self.add_default(state, enter),
            StateKind::Parallel => self.add_regions(state, enter),
            _ => {}
        }
    }

    /// Adds the initial states of a state.
    fn add_default(&self, state: usize, enter: &mut Entering) {
        enter.defaults.insert(state);
        match (self.chart.states[state].initial, self.chart.states[state].children.first()) {
            (Some(initial), _) => self.add_targets(initial, state, enter),
            (None, Some(&first)) => self.add_descendants(first, enter),
            (None, None) => {}
        }
    }

    fn add_ancestors(&self, state: usize, below: usize, enter: &mut Entering) {
        // What a history stands for may be beside states that stay active, which appendix D would enter
        // again.
        let is_left =
            |&ancestor: &usize| self.chart.is_inside(ancestor, below) && !self.active.contains(&ancestor);
        for ancestor in self.chart.ancestors(state).take_while(is_left) {
            enter.states.insert(ancestor);
            if self.chart.states[ancestor].kind == StateKind::Parallel {
                self.add_regions(ancestor, enter);
            }
        }
    }

    /// Adds the children of a parallel state in which nothing is entered yet.
    fn add_regions(&self, state: usize, enter: &mut Entering) {
        for &child in &self.chart.states[state].children {
            let end = self.chart.states[child].end;
            if enter.states.range(child..end).next().is_none() {
                self.add_descendants(child, enter);
            }
        }
    }

    fn enter(&mut self, enter: &Entering) {
        let chart = Arc::clone(&self.chart);
        self.active.insert(0);
        for &number in enter.states.iter().filter(|&&number| number > 0) {
            let state = &chart.states[number];
            self.active.insert(number);
            let mut world = self.evaluator.world.write();
            let now = world.now;
            world.entered.insert(state.id.clone(), now);
            drop(world);
            if chart.is_late {
                self.initialise(number, &state.data);
            }
            for block in &state.entry {
                self.execute(block);
            }
            self.execute_default(enter, number);
            if state.kind == StateKind::Final {
                self.reach_end(number);
            }
        }
        self.execute_default(enter, 0);
    }

    fn execute_default(&mut self, enter: &Entering, state: usize) {
        let chart = Arc::clone(&self.chart);
        if enter.defaults.contains(&state)
            && let Some(initial) = chart.states[state].initial
        {
            self.execute(&chart.transitions[initial].actions);
        }
        if let Some(&default) = enter.history_defaults.get(&state) {
            self.execute(&chart.transitions[default].actions);
        }
    }

    fn reach_end(&mut self, state: usize) {
        let chart = Arc::clone(&self.chart);
        let Some(parent) = chart.states[state].parent else { return };
        if parent == 0 {
            self.end();
            return;
        }
        let (data, result) = self.payload(&chart.states[state].done_data);
        self.note(result);
        self.raise(Event::internal(&format!("done.state.{}", chart.states[parent].id), data));
        let Some(outer) =
            chart.states[parent].parent.filter(|&outer| chart.states[outer].kind == StateKind::Parallel)
        else {
            return;
        };
        if chart.states[outer].children.iter().all(|&region| self.is_at_end(region)) {
            self.raise(Event::internal(&format!("done.state.{}", chart.states[outer].id), Dynamic::UNIT));
        }
    }

    fn is_at_end(&self, state: usize) -> bool {
        let children = &self.chart.states[state].children;
        match self.chart.states[state].kind {
            StateKind::Compound => children.iter().any(|child| {
                self.chart.states[*child].kind == StateKind::Final && self.active.contains(child)
            }),
            StateKind::Parallel => children.iter().all(|&child| self.is_at_end(child)),
            _ => false,
        }
    }

    /// The whole chart has come to its end: its states are exited, but stay visible as the active ones.
    fn end(&mut self) {
        self.is_running = false;
        let chart = Arc::clone(&self.chart);
        let active: Vec<usize> = self.active.iter().copied().collect();
        for &state in active.iter().rev() {
            for block in &chart.states[state].exit {
                self.execute(block);
            }
        }
        self.delayed.clear();
        self.internal.clear();
    }

    fn initialise(&mut self, state: usize, data: &[Data]) {
        if !self.initialised.insert(state) {
            return;
        }
        for data in data {
            let Some(value) = &data.value else { continue };
            match self.evaluator.value(value, &mut self.scope) {
                Ok(value) => _ = self.scope.set_value(data.id.clone(), value),
                Err(problem) => self.note(Err(Problem { line: data.line, ..problem }.into())),
            }
        }
    }

    /// Executes a block; an error ends it and becomes an event.
    fn execute(&mut self, block: &[Action]) {
        let result = self.try_execute(block);
        self.note(result);
    }

    fn note(&mut self, result: Result<(), Failure>) {
        if let Err(Failure { event, problem, send_id }) = result {
            let data = Map::from([
                ("line".into(), i64::from(problem.line).into()),
                ("text".into(), problem.text.clone().into()),
            ]);
            let event = Event { kind: EventKind::Platform, ..Event::internal(event, data.into()) };
            self.raise(event.of(send_id));
            self.effects.push(Effect::Fault(problem));
        }
    }

    fn try_execute(&mut self, block: &[Action]) -> Result<(), Failure> {
        for action in block {
            match action {
                Action::Raise { event } => self.raise(Event::internal(event, Dynamic::UNIT)),
                Action::Send(send) => self.try_send(send)?,
                Action::Cancel { id, line } => {
                    let id = self.text(id, *line)?;
                    self.delayed.retain(|delayed| delayed.id.as_deref() != Some(id.as_str()));
                }
                Action::Log { label, value, line } => {
                    let value = value
                        .as_ref()
                        .map(|value| self.evaluator.value(value, &mut self.scope))
                        .transpose()?;
                    let text = value.map_or_else(String::new, |value| value.to_string());
                    self.effects.push(Effect::Log { label: label.clone(), text, line: *line });
                }
                Action::Assign { location, value } => {
                    let value = self.evaluator.value(value, &mut self.scope)?;
                    self.assign(location, value)?;
                }
                Action::Script(script) => self.evaluator.run(script, &mut self.scope)?,
                Action::If { branches } => {
                    for (condition, actions) in branches {
                        let holds = match condition {
                            None => true,
                            // A condition that fails is false, and the rest of the block goes on.
                            Some(condition) => match self.evaluator.holds(condition, &mut self.scope) {
                                Ok(holds) => holds,
                                Err(problem) => {
                                    self.note(Err(problem.into()));
                                    false
                                }
                            },
                        };
                        if holds {
                            self.try_execute(actions)?;
                            break;
                        }
                    }
                }
                Action::ForEach(each) => {
                    let array = self.evaluator.value(&each.array, &mut self.scope)?;
                    let array = array.into_array().map_err(|found| Problem {
                        line: each.array.line,
                        text: format!("`{}` is of type {found}; <foreach> needs an array", each.array.text),
                    })?;
                    for name in each
                        .names
                        .iter()
                        .flatten()
                        .filter(|name| !self.scope.contains(name))
                        .collect::<Vec<_>>()
                    {
                        self.scope.push_dynamic(name.clone(), Dynamic::UNIT);
                    }
                    for (index, item) in array.into_iter().enumerate() {
                        self.assign(&each.item, item)?;
                        if let Some(location) = &each.index {
                            self.assign(location, Dynamic::from_int(index as i64))?;
                        }
                        self.try_execute(&each.body)?;
                    }
                }
            }
        }
        Ok(())
    }

    fn assign(&mut self, location: &Program, value: Dynamic) -> Result<(), Problem> {
        let variable = variable_of(&location.text);
        let is_received = self.chart.interface.subscriptions.iter().any(|port| port.name == variable);
        if is_received || variable == "setting" || variable.starts_with('_') {
            let text = format!("`{}` cannot be assigned: only variables of <data> can", location.text);
            return Err(Problem { line: location.line, text });
        }
        let variables = self.scope.len();
        self.scope.push_constant_dynamic(ASSIGNED, value);
        let result = self.evaluator.run(location, &mut self.scope);
        self.scope.rewind(variables);
        result
    }

    fn text(&mut self, given: &Given, line: u32) -> Result<String, Problem> {
        match given {
            Given::Text(text) => Ok(text.clone()),
            Given::Computed(program) => {
                let value = self.evaluator.value(program, &mut self.scope)?;
                value.into_string().map_err(|found| Problem {
                    line,
                    text: format!("`{}` is of type {found}; a text is needed", program.text),
                })
            }
        }
    }

    /// The data of an event, and the first error in them; fields with errors are left out.
    fn payload(&mut self, payload: &Payload) -> (Dynamic, Result<(), Failure>) {
        let mut result = Ok(());
        let data = match payload {
            Payload::None => Dynamic::UNIT,
            Payload::Content(Given::Text(text)) => self.evaluator.read(text),
            Payload::Content(Given::Computed(value)) => {
                let value = self.evaluator.value(value, &mut self.scope);
                value.unwrap_or_else(|problem| {
                    result = Err(problem.into());
                    Dynamic::UNIT
                })
            }
            Payload::Parameters(parameters) => {
                let mut map = Map::new();
                for (name, value) in parameters {
                    match self.evaluator.value(value, &mut self.scope) {
                        Ok(value) => _ = map.insert(name.as_str().into(), value),
                        Err(problem) if result.is_ok() => result = Err(problem.into()),
                        Err(_) => {}
                    }
                }
                if map.is_empty() { Dynamic::UNIT } else { map.into() }
            }
        };
        (data, result)
    }

    fn try_send(&mut self, send: &Send) -> Result<(), Failure> {
        let id = match (&send.id, &send.id_location) {
            (Some(id), _) => Some(id.clone()),
            (None, Some(location)) => {
                self.made_up += 1;
                let id = format!("send.{}", self.made_up);
                self.assign(location, id.clone().into())?;
                Some(id)
            }
            (None, None) => None,
        };
        let fail =
            |event, text| Failure { event, problem: Problem { line: send.line, text }, send_id: id.clone() };
        let kind = send.kind.as_ref().map(|kind| self.text(kind, send.line)).transpose()?;
        if let Some(kind) = kind.filter(|kind| {
            !["scxml", PROCESSOR, "http://www.w3.org/TR/scxml/"].contains(&kind.trim_end_matches('#'))
        }) {
            return Err(fail(
                "error.execution",
                format!("`type` of <send> is \"scxml\" or missing, not \"{kind}\""),
            ));
        }
        let name =
            send.event.as_ref().map(|event| self.text(event, send.line)).transpose()?.unwrap_or_default();
        let target = send.target.as_ref().map(|target| self.text(target, send.line)).transpose()?;
        let target = match target.as_deref() {
            None => Target::Own,
            Some("#_internal") => Target::Internal,
            Some(own) if own.strip_prefix("#_scxml_") == Some(self.session.as_str()) => Target::Own,
            Some("#_scxml_self") => Target::Own,
            Some(session) if session.starts_with("#_") => {
                return Err(fail("error.communication", format!("<send> cannot reach \"{session}\"")));
            }
            Some(port) => {
                let interface = &self.chart.interface;
                let mut ports =
                    [&interface.publishers, &interface.services, &interface.actions].into_iter().flatten();
                if !ports.any(|known| known.name == port) {
                    let text = format!("<send> has the target \"{port}\", which the chart does not declare");
                    return Err(fail("error.execution", text));
                }
                Target::Port(port.to_owned())
            }
        };
        let delay = match &send.delay {
            None => Duration::ZERO,
            Some(delay) => {
                let text = self.text(delay, send.line)?;
                duration(&text).ok_or_else(|| {
                    fail("error.execution", format!("\"{text}\" is no delay such as \"1.5s\""))
                })?
            }
        };
        if delay > Duration::ZERO && matches!(target, Target::Internal) {
            return Err(fail("error.execution", "an event for \"#_internal\" has no delay".to_owned()));
        }
        let (data, result) = self.payload(&send.payload);
        result?;
        let kind = if matches!(target, Target::Internal) { EventKind::Internal } else { EventKind::External };
        let event = Event { name, data, kind, send_id: send.id.clone().or_else(|| id.clone()), is_own: true };
        if delay == Duration::ZERO {
            self.deliver(target, event, id, send.line);
        } else if self.delayed.len() < MOST_WAITING {
            let due = self.evaluator.world.read().now.saturating_add(delay);
            self.delayed.push(Delayed { due, id, target, event, line: send.line });
        } else {
            let text = format!("more than {MOST_WAITING} delayed events wait");
            return Err(fail("error.execution", text));
        }
        Ok(())
    }
}

/// The states to enter in a step, and those whose initial transitions are executed.
#[derive(Default)]
struct Entering {
    states: BTreeSet<usize>,
    defaults: BTreeSet<usize>,
    /// Defaults of histories, by the parents.
    history_defaults: BTreeMap<usize, usize>,
}

/// Whether a descriptor, of which a trailing `.*` was removed, names an event.
fn matches(wanted: &str, event: &str) -> bool {
    wanted == "*" || event.strip_prefix(wanted).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

/// Replaces the value of a variable that the chart itself does not assign.
fn provide(scope: &mut Scope<'static>, name: &str, value: Dynamic) {
    match scope.get_mut(name) {
        Some(variable) => *variable = value,
        None => _ = scope.push_dynamic(name.to_owned(), value),
    }
}

/// The variable that a location is, or is in.
fn variable_of(location: &str) -> &str {
    let end = location.find(|c: char| c != '_' && !c.is_ascii_alphanumeric()).unwrap_or(location.len());
    &location[..end]
}
