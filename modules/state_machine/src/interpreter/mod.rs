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

mod content;
mod selection;

use crate::chart::{Chart, StateKind, Transition};
use crate::expressions::{Evaluator, Problem};
use rhai::{Dynamic, Map, Scope};
use selection::Entering;
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
