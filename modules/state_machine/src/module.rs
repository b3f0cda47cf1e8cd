//! A chart as a module of a robot.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `NAME/state` | state_machine_interfaces/StateMachineState | at the start and after every step |
//! | `NAME/dot`, `NAME/mermaid` | std_msgs/String | the chart with its active states; expose them latched |
//!
//! and the topics, services and actions that the chart declares.

use crate::chart::{Chart, ChartSetting, Port, SettingDefault};
use crate::expressions::Problem;
use crate::interpreter::{Effect, Event, Interpreter, Memory};
use crate::state_machine_interfaces::msg::StateMachineState;
use crate::values::{to_map, to_message};
use downbeat_edge::foreign::{
    Declarations, Event as PortEvent, Foreign, ForeignContext, SavedState, SettingDeclaration,
};
use downbeat_executor::{Failure, SettingValue, Time, Transition};
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
use downbeat_msgs::{Message, cdr, std_msgs};
use rhai::{Dynamic, Map};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

/// Which chart, and whether its file is watched.
#[derive(Clone, Debug)]
pub struct StateMachineOptions {
    /// The file.
    pub path: PathBuf,
    /// Whether a changed file takes over while the robot runs.
    pub is_reloaded: bool,
}

/// Reads a chart and makes its module.
///
/// # Errors
/// The sentences of a [`ChartError`](crate::ChartError).
pub fn load(options: &StateMachineOptions) -> Result<Box<dyn Foreign>, String> {
    Ok(Box::new(StateMachine::load(options)?))
}

struct StateMachine {
    options: StateMachineOptions,
    chart: Arc<Chart>,
    interpreter: Interpreter,
    /// Of the version before.
    memory: Option<Memory>,
    has_started: bool,
    ports: Ports,
    report: StateMachineState,
    /// Receives and calls since the last step.
    is_due: bool,
    watch: Watch,
    faults: Faults,
}

/// Limits how often the same fault is logged: an expression may fail at every message.
#[derive(Default)]
struct Faults {
    /// When each fault was logged, and how often it has occurred since.
    logged: BTreeMap<Problem, (Time, u64)>,
}

impl Faults {
    /// The least time between two lines of the log about the same fault.
    const PERIOD: Duration = Duration::from_secs(10);
    /// How many different faults are remembered.
    const MOST: usize = 64;

    /// Whether a fault is logged now; then how often it was not since the last time.
    fn allow(&mut self, problem: &Problem, now: Time) -> Option<u64> {
        if let Some((last, left_out)) = self.logged.get_mut(problem) {
            if now.saturating_since(*last) < Self::PERIOD && now >= *last {
                *left_out += 1;
                return None;
            }
            *last = now;
            return Some(std::mem::take(left_out));
        }
        if self.logged.len() >= Self::MOST {
            self.logged.pop_first();
        }
        self.logged.insert(problem.clone(), (now, 0));
        Some(0)
    }
}

/// What the declarations returned, and the types behind.
#[derive(Default)]
struct Ports {
    state: u32,
    pictures: [u32; 2],
    subscriptions: BTreeMap<u32, (Port, DynamicType)>,
    publishers: BTreeMap<String, (u32, DynamicType)>,
    clients: BTreeMap<u32, Client>,
    /// The client of each service, and those of each action: goal, result, cancellation.
    services: BTreeMap<String, u32>,
    actions: BTreeMap<String, [u32; 3]>,
    feedback: BTreeMap<u32, (String, DynamicType)>,
    timers: BTreeMap<u32, String>,
    settings: Vec<(u32, String)>,
    wake: u32,
    /// Calls without an answer: client and call, with the id of their `<send>` and the goal.
    open: BTreeMap<(u32, u64), (Option<String>, Goal)>,
    /// The last goal of each action.
    goals: BTreeMap<String, Goal>,
    count: u64,
}

type Goal = [u8; 16];

struct Client {
    name: String,
    stage: Stage,
    request: DynamicType,
    response: DynamicType,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    Service,
    Goal,
    Result,
    Cancel,
}

/// How long the result of an action may take.
const RESULT_TIMEOUT: Duration = Duration::from_secs(3600);

impl StateMachine {
    fn load(options: &StateMachineOptions) -> Result<Self, String> {
        // Before reading, so that a later change is noticed.
        let watch = Watch::new(&options.path);
        let chart = Arc::new(Chart::read(&options.path).map_err(|error| error.to_string())?);
        for finding in &chart.findings {
            tracing::warn!("{}:{finding}", options.path.display());
        }
        let report = StateMachineState { chart: chart.name.clone(), ..StateMachineState::default() };
        Ok(Self {
            options: options.clone(),
            interpreter: Interpreter::new(Arc::clone(&chart), &chart.name),
            chart,
            memory: None,
            has_started: false,
            ports: Ports::default(),
            report,
            is_due: true,
            watch,
            faults: Faults::default(),
        })
    }

    fn at(&self, line: u32, problem: impl std::fmt::Display) -> String {
        format!("{}:{line}: {problem}", self.options.path.display())
    }

    fn declare_ports(&mut self, declarations: &mut Declarations) -> Result<(), String> {
        let chart = Arc::clone(&self.chart);
        let define = |declarations: &Declarations, port: &Port, suffix: &str| {
            let name = format!("{}{suffix}", port.type_name);
            declarations.definition(&name).map_err(|problem| self.at(port.line, problem))
        };
        let mut ports = Ports::default();
        let mut first_messages = Vec::new();
        for port in &chart.interface.subscriptions {
            let of = define(declarations, port, "")?;
            let first = to_map(DynamicMessage::new(&of).as_message());
            first_messages.push((&port.name, first));
            let number = declarations.subscribe(&port.topic, &port.type_name, None);
            ports.subscriptions.insert(number, (port.clone(), of));
        }
        let unknown = chart.unknown_names(&|name| declarations.definition(name));
        let unknown = unknown.map_err(|problem| self.at(problem.line, &problem.text))?;
        if !unknown.is_empty() {
            let lines: Vec<String> =
                unknown.iter().map(|problem| self.at(problem.line, &problem.text)).collect();
            return Err(lines.join("\n"));
        }
        for port in &chart.interface.publishers {
            let of = define(declarations, port, "")?;
            let number = declarations.publish(&port.topic, &port.type_name, None);
            ports.publishers.insert(port.name.clone(), (number, of));
        }
        let client = |declarations: &mut Declarations, port: &Port, stage: Stage| {
            let (service, type_name, timeout) = match stage {
                Stage::Service => (port.topic.clone(), port.type_name.clone(), port.timeout),
                Stage::Goal => (
                    format!("{}/_action/send_goal", port.topic),
                    format!("{}_SendGoal", port.type_name),
                    port.timeout,
                ),
                Stage::Result => {
                    let type_name = format!("{}_GetResult", port.type_name);
                    (format!("{}/_action/get_result", port.topic), type_name, RESULT_TIMEOUT)
                }
                Stage::Cancel => (
                    format!("{}/_action/cancel_goal", port.topic),
                    "action_msgs/srv/CancelGoal".to_owned(),
                    port.timeout,
                ),
            };
            let part = |part: &str| {
                let name = format!("{type_name}_{part}");
                declarations.definition(&name).map_err(|problem| self.at(port.line, problem))
            };
            let client = Client {
                name: port.name.clone(),
                stage,
                request: part("Request")?,
                response: part("Response")?,
            };
            Ok::<_, String>((declarations.client(&service, &type_name, None, timeout), client))
        };
        for port in &chart.interface.services {
            let (number, client) = client(declarations, port, Stage::Service)?;
            ports.clients.insert(number, client);
            ports.services.insert(port.name.clone(), number);
        }
        for port in &chart.interface.actions {
            let mut numbers = [0; 3];
            for (place, stage) in numbers.iter_mut().zip([Stage::Goal, Stage::Result, Stage::Cancel]) {
                let (number, client) = client(declarations, port, stage)?;
                ports.clients.insert(number, client);
                *place = number;
            }
            ports.actions.insert(port.name.clone(), numbers);
            let type_name = format!("{}_FeedbackMessage", port.type_name);
            let of = define(declarations, port, "_FeedbackMessage")?;
            let number =
                declarations.subscribe(&format!("{}/_action/feedback", port.topic), &type_name, None);
            ports.feedback.insert(number, (port.name.clone(), of));
        }
        for timer in &chart.interface.timers {
            ports.timers.insert(declarations.every(timer.period), timer.event.clone());
        }
        for setting in &chart.interface.settings {
            let declared = declarations.setting(declaration(setting));
            let (number, _) = declared.map_err(|problem| self.at(setting.line, problem))?;
            ports.settings.push((number, setting.name.clone()));
        }
        let module = declarations.module_name().to_owned();
        ports.state = declarations.publish(&format!("{module}/state"), StateMachineState::TYPE_NAME, None);
        ports.pictures = ["dot", "mermaid"].map(|picture| {
            declarations.publish(&format!("{module}/{picture}"), std_msgs::msg::String::TYPE_NAME, None)
        });
        ports.wake = declarations.task();
        for (name, first) in first_messages {
            self.interpreter.provide(name, first.into());
        }
        self.ports = ports;
        Ok(())
    }

    /// Adds the event of a message, an answer or a timer.
    fn add(&mut self, name: &str, data: Dynamic, send_id: Option<String>) {
        self.is_due = true;
        self.interpreter.send(Event::new(name, data).of(send_id));
    }

    fn receive(&mut self, subscription: u32, bytes: &[u8], now: Duration) -> Result<(), String> {
        self.is_due = true;
        if let Some((name, of)) = self.ports.feedback.get(&subscription) {
            let message = DynamicMessage::from_cdr(of, bytes).map_err(|error| error.to_string())?;
            let map = to_map(message.as_message());
            let is_own = self.ports.goals.get(name).is_some_and(|goal| uuid_of(&map) == Some(*goal));
            let event = format!("action.{name}.feedback");
            if is_own {
                self.add(&event, map.get("feedback").cloned().unwrap_or_default(), None);
            }
            return Ok(());
        }
        let Some((port, of)) = self.ports.subscriptions.get(&subscription) else { return Ok(()) };
        let message = DynamicMessage::from_cdr(of, bytes).map_err(|error| error.to_string())?;
        let value: Dynamic = to_map(message.as_message()).into();
        let (name, event) = (port.name.clone(), port.event.clone());
        if let Some(event) = event {
            self.interpreter.receive(&name, value.clone(), now);
            self.add(&event, value, None);
        } else {
            self.interpreter.receive(&name, value, now);
        }
        Ok(())
    }

    fn take_reply(
        &mut self,
        client: u32,
        call: u64,
        result: Result<&[u8], String>,
        context: &mut ForeignContext<'_, '_>,
    ) {
        let Some((send_id, goal)) = self.ports.open.remove(&(client, call)) else { return };
        let Some(Client { name, stage, response, .. }) = self.ports.clients.get(&client) else { return };
        let (name, stage) = (name.clone(), *stage);
        let decoded = result
            .and_then(|bytes| DynamicMessage::from_cdr(response, bytes).map_err(|error| error.to_string()));
        let data = match decoded {
            Ok(message) => to_map(message.as_message()),
            Err(problem) => {
                let event = match stage {
                    Stage::Service => format!("error.call.{name}"),
                    _ => format!("action.{name}.lost"),
                };
                return self.add(&event, problem.into(), send_id);
            }
        };
        match stage {
            Stage::Service => self.add(&format!("done.call.{name}"), data.into(), send_id),
            Stage::Goal if data.get("accepted").is_some_and(|accepted| accepted.as_bool() == Ok(true)) => {
                self.add(&format!("action.{name}.accepted"), Dynamic::UNIT, send_id.clone());
                let result_client = self.ports.actions.get(&name).map(|[_, result, _]| *result);
                let request = Map::from([("goal_id".into(), id_map(goal))]);
                let called =
                    result_client.map(|client| self.call(client, &request.into(), send_id, goal, context));
                if let Some(Err(problem)) = called {
                    self.add(&format!("action.{name}.lost"), problem.into(), None);
                }
            }
            Stage::Goal => self.add(&format!("action.{name}.rejected"), Dynamic::UNIT, send_id),
            Stage::Result => {
                let end = match data.get("status").and_then(|status| status.as_int().ok()) {
                    Some(4) => "succeeded",
                    Some(5) => "canceled",
                    _ => "aborted",
                };
                let result = data.get("result").cloned().unwrap_or_default();
                self.add(&format!("action.{name}.{end}"), result, send_id);
            }
            Stage::Cancel => {}
        }
    }

    fn call(
        &mut self,
        client: u32,
        fields: &Dynamic,
        send_id: Option<String>,
        goal: Goal,
        context: &mut ForeignContext<'_, '_>,
    ) -> Result<(), String> {
        let known = self.ports.clients.get(&client).ok_or("there is no such client")?;
        let request = to_message(&known.request, fields)?;
        let call = context.call(client, &request.to_cdr()).map_err(|error| error.to_string())?;
        self.ports.open.insert((client, call), (send_id, goal));
        Ok(())
    }

    fn send(
        &mut self,
        target: &str,
        event: Option<&str>,
        data: &Dynamic,
        id: Option<String>,
        context: &mut ForeignContext<'_, '_>,
    ) -> Result<(), String> {
        if let Some((number, of)) = self.ports.publishers.get(target) {
            let message = to_message(of, data)?;
            let cdr = message.to_cdr().into();
            return context.publish_shared(*number, &cdr).map_err(|error| error.to_string());
        }
        if let Some(&client) = self.ports.services.get(target) {
            return self.call(client, data, id, Goal::default(), context);
        }
        let Some(&[goals, _, cancels]) = self.ports.actions.get(target) else {
            return Err(format!("there is no port \"{target}\""));
        };
        if event == Some("cancel") {
            let Some(&goal) = self.ports.goals.get(target) else { return Ok(()) };
            let request =
                Map::from([("goal_info".into(), Map::from([("goal_id".into(), id_map(goal))]).into())]);
            return self.call(cancels, &request.into(), id, goal, context);
        }
        self.ports.count += 1;
        let goal = goal_id(context.module_name(), target, context.now(), self.ports.count);
        let mut request = Map::from([("goal_id".into(), id_map(goal))]);
        if !data.is_unit() {
            request.insert("goal".into(), data.clone());
        }
        self.call(goals, &request.into(), id, goal, context)?;
        self.ports.goals.insert(target.to_owned(), goal);
        Ok(())
    }

    fn step(&mut self, context: &mut ForeignContext<'_, '_>) -> Result<(), String> {
        let now = since_epoch(context.now());
        if self.interpreter.next_due().is_some_and(|due| due <= now) {
            self.is_due = true;
        }
        if std::mem::take(&mut self.is_due) {
            self.provide_settings(context)?;
            if !self.has_started {
                let stop = context.stop_request();
                self.interpreter.interrupt_when(move || stop.is_made());
            }
            let mut effects = match (self.memory.take(), self.has_started) {
                (Some(memory), false) => self.interpreter.resume(memory, now),
                (None, false) => self.interpreter.start(now),
                _ => self.interpreter.advance(now),
            };
            let is_first = !std::mem::replace(&mut self.has_started, true);
            let mut has_moved = is_first;
            // Faults of ports become events, whose effects follow.
            for _ in 0..16 {
                let faults = self.apply(effects, &mut has_moved, context);
                if faults.is_empty() {
                    break;
                }
                for text in faults {
                    self.interpreter.send(Event::new("error.communication", text.into()));
                }
                effects = self.interpreter.advance(now);
            }
            if has_moved {
                self.publish_state(context)?;
            }
        }
        context.cancel(self.ports.wake).map_err(|error| error.to_string())?;
        if let Some(due) = self.interpreter.next_due() {
            let delay = due.saturating_sub(now);
            context.schedule_after(self.ports.wake, delay).map_err(|error| error.to_string())?;
        }
        Ok(())
    }

    /// Does what the chart says. Returns what failed.
    fn apply(
        &mut self,
        effects: Vec<Effect>,
        has_moved: &mut bool,
        context: &mut ForeignContext<'_, '_>,
    ) -> Vec<String> {
        let module = context.module_name().to_owned();
        let mut failed = Vec::new();
        for effect in effects {
            match effect {
                Effect::Log { label, text, .. } => {
                    let colon = if label.is_empty() || text.is_empty() { "" } else { ": " };
                    tracing::info!(module, "{label}{colon}{text}");
                }
                Effect::Taken { source, targets, event } => {
                    *has_moved = true;
                    (self.report.source, self.report.targets, self.report.event) = (source, targets, event);
                }
                Effect::Fault(problem) => {
                    *has_moved = true;
                    self.note(&module, &problem, context.now());
                }
                Effect::Send { target, event, data, id, line } => {
                    if let Err(text) = self.send(&target, event.as_deref(), &data, id, context) {
                        *has_moved = true;
                        let problem = Problem { line, text: format!("<send> to \"{target}\": {text}") };
                        self.note(&module, &problem, context.now());
                        failed.push(text);
                    }
                }
            }
        }
        failed
    }

    fn note(&mut self, module: &str, problem: &Problem, now: Time) {
        self.report.fault = problem.to_string();
        if let Some(left_out) = self.faults.allow(problem, now) {
            let more = if left_out > 0 { format!(" (and {left_out} times before)") } else { String::new() };
            tracing::error!(module, "{}{more}", self.at(problem.line, &problem.text));
        }
    }

    fn provide_settings(&mut self, context: &ForeignContext<'_, '_>) -> Result<(), String> {
        let mut settings = Map::new();
        for (number, name) in &self.ports.settings {
            let value = match context.setting(*number).map_err(|error| error.to_string())? {
                SettingValue::Bool(value) => (*value).into(),
                SettingValue::Integer(value) => (*value).into(),
                SettingValue::Double(value) => (*value).into(),
                SettingValue::Text(text) => text.clone().into(),
                _ => Dynamic::UNIT,
            };
            settings.insert(name.as_str().into(), value);
        }
        self.interpreter.provide("setting", settings.into());
        Ok(())
    }

    fn publish_state(&mut self, context: &mut ForeignContext<'_, '_>) -> Result<(), String> {
        let nanos = context.now().as_nanos();
        self.report.stamp = Stamp {
            sec: i32::try_from(nanos.div_euclid(1_000_000_000)).unwrap_or(i32::MAX),
            nanosec: u32::try_from(nanos.rem_euclid(1_000_000_000)).unwrap_or(0),
        };
        self.report.active = self.interpreter.active().map(str::to_owned).collect();
        self.report.is_running = self.interpreter.is_running();
        let publish = |context: &mut ForeignContext<'_, '_>, number, bytes: &[u8]| {
            context.publish(number, bytes).map_err(|error| error.to_string())
        };
        publish(context, self.ports.state, &cdr::to_vec(&self.report))?;
        let active: BTreeSet<&str> = self.interpreter.active().collect();
        let pictures = [self.chart.to_dot(&active), self.chart.to_mermaid(&active)];
        for (number, data) in self.ports.pictures.into_iter().zip(pictures) {
            publish(context, number, &cdr::to_vec(&std_msgs::msg::String { data }))?;
        }
        Ok(())
    }
}

/// Its states, data and messages.
impl fmt::Debug for StateMachine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.interpreter.memory().fmt(f)
    }
}

impl Foreign for StateMachine {
    fn debug(&self) -> Option<&dyn fmt::Debug> {
        Some(self)
    }

    fn setup(&mut self, declarations: &mut Declarations) -> Result<(), String> {
        self.declare_ports(declarations)?;
        declarations.each_run();
        if self.options.is_reloaded {
            declarations.reload();
        }
        Ok(())
    }

    fn handle(&mut self, event: PortEvent, context: &mut ForeignContext<'_, '_>) -> Result<(), Failure> {
        match event {
            PortEvent::Message { subscription, cdr, .. } => {
                let now = since_epoch(context.now());
                if let Err(problem) = self.receive(subscription, &cdr, now) {
                    tracing::warn!(module = context.module_name(), "a message is ignored: {problem}");
                }
            }
            PortEvent::Reply { client, call, result } => {
                let result = result.as_ref().map(|bytes| &bytes[..]).map_err(Clone::clone);
                self.take_reply(client, call, result, context);
            }
            PortEvent::Timer { timer } => {
                if let Some(event) = self.ports.timers.get(&timer).cloned() {
                    self.add(&event, Dynamic::UNIT, None);
                }
            }
            PortEvent::Setting { .. } => self.is_due = true,
            PortEvent::EachRun => self.step(context)?,
            _ => {}
        }
        Ok(())
    }

    fn transition(
        &mut self,
        transition: Transition,
        context: &mut ForeignContext<'_, '_>,
    ) -> Result<(), String> {
        if transition != Transition::Activate {
            return Ok(());
        }
        // The first run, before anything else happens.
        context.schedule_after(self.ports.wake, Duration::ZERO).map_err(|error| error.to_string())
    }

    fn successor(&mut self) -> Result<Option<Box<dyn Foreign>>, String> {
        if !self.watch.has_changed() {
            return Ok(None);
        }
        Ok(Some(Box::new(Self::load(&self.options)?)))
    }

    fn save(&mut self) -> Result<SavedState, String> {
        Ok(Box::new(self.interpreter.memory()))
    }

    fn restore(&mut self, state: SavedState) -> Result<(), String> {
        let memory = state.downcast().map_err(|_| "the state is of another kind of module".to_owned())?;
        self.memory = Some(*memory);
        Ok(())
    }
}

fn declaration(setting: &ChartSetting) -> SettingDeclaration {
    let default = match &setting.default {
        SettingDefault::Bool(value) => SettingValue::Bool(*value),
        SettingDefault::Integer(value) => SettingValue::Integer(*value),
        SettingDefault::Number(value) => SettingValue::Double(*value),
        SettingDefault::Text(text) => SettingValue::Text(text.clone()),
    };
    let range = setting.range.map(|(low, high)| low..=high);
    SettingDeclaration {
        name: setting.name.clone(),
        description: setting.about.clone(),
        default,
        range,
        is_read_only: false,
    }
}

fn since_epoch(time: Time) -> Duration {
    Duration::from_nanos(u64::try_from(time.as_nanos()).unwrap_or(0))
}

/// Distinct for each goal, and the same in a replay: two hashes of FNV-1a over what distinguishes goals.
fn goal_id(module: &str, action: &str, now: Time, count: u64) -> Goal {
    let mut id = Goal::default();
    for (half, seed) in id.chunks_mut(8).zip([0xcbf2_9ce4_8422_2325_u64, 0x9e37_79b9_7f4a_7c15]) {
        let parts =
            [module.as_bytes(), action.as_bytes(), &now.as_nanos().to_le_bytes(), &count.to_le_bytes()];
        let hash = parts
            .concat()
            .iter()
            .fold(seed, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3));
        half.copy_from_slice(&hash.to_le_bytes());
    }
    id
}

fn id_map(goal: Goal) -> Dynamic {
    let bytes: Vec<Dynamic> = goal.iter().map(|byte| i64::from(*byte).into()).collect();
    Map::from([("uuid".into(), bytes.into())]).into()
}

fn uuid_of(feedback: &Map) -> Option<Goal> {
    let id = feedback.get("goal_id")?.as_map_ref().ok()?.get("uuid")?.as_array_ref().ok()?.clone();
    let bytes: Vec<u8> = id.iter().filter_map(|byte| u8::try_from(byte.as_int().ok()?).ok()).collect();
    bytes.try_into().ok()
}

/// Notices that a file has changed and stays as it is.
struct Watch {
    path: PathBuf,
    tried: Option<(SystemTime, u64)>,
    last: Option<(SystemTime, u64)>,
}

impl Watch {
    fn new(path: &Path) -> Self {
        let stamp = stamp(path);
        Self { path: path.to_owned(), tried: stamp, last: stamp }
    }

    /// True once for each change, when the file was the same at two looks.
    fn has_changed(&mut self) -> bool {
        let now = stamp(&self.path);
        let is_at_rest = now == self.last;
        self.last = now;
        let has_changed = is_at_rest && now.is_some() && now != self.tried;
        if has_changed {
            self.tried = now;
        }
        has_changed
    }
}

fn stamp(path: &Path) -> Option<(SystemTime, u64)> {
    let file = std::fs::metadata(path).ok()?;
    Some((file.modified().ok()?, file.len()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_that_repeats_is_logged_once_in_ten_seconds_with_a_count() {
        let mut faults = Faults::default();
        let fault = |line| Problem { line, text: "`ball.w`: no such field".into() };
        let at = |tenths: u64| Time::ZERO + Duration::from_millis(100 * tenths);
        assert_eq!(faults.allow(&fault(3), at(0)), Some(0));
        let logged: Vec<_> = (1..=200).filter_map(|tenths| faults.allow(&fault(3), at(tenths))).collect();
        assert_eq!(logged, [99, 99]);
        assert_eq!(faults.allow(&fault(4), at(200)), Some(0), "another fault has its own line");
        for line in 10..1000 {
            faults.allow(&fault(line), at(201));
        }
        assert!(faults.logged.len() <= Faults::MOST);
    }
}
