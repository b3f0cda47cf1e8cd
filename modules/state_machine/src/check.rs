//! What a chart names that does not exist: variables, settings, functions, and fields of messages.

use crate::chart::{Action, Chart, Given, Interface, Payload, Send};
use crate::expressions::{Path, Problem, Program, functions};
use downbeat_files::suggestion;
use downbeat_msgs::definitions::Shape;
use downbeat_msgs::dynamic::DynamicType;
use std::collections::{BTreeMap, BTreeSet};

/// Variables that every chart has.
const OWN: [&str; 5] = ["_event", "_name", "_sessionid", "_ioprocessors", "setting"];

/// The fields of `_event`.
const OF_EVENT: [&str; 7] = ["name", "type", "sendid", "origin", "origintype", "invokeid", "data"];

/// The types of the messages in a chart.
#[derive(Default)]
struct Types {
    /// Of subscriptions, by their variables.
    variables: BTreeMap<String, DynamicType>,
    /// Of the data of events, by their names.
    events: BTreeMap<String, DynamicType>,
    /// Of what is sent, by target.
    targets: BTreeMap<String, DynamicType>,
}

impl Types {
    /// Finds the types of the ports of a chart.
    ///
    /// # Errors
    /// The line of a port and what `define` says about its type.
    fn of(
        interface: &Interface,
        define: &dyn Fn(&str) -> Result<DynamicType, String>,
    ) -> Result<Self, Problem> {
        let mut types = Self::default();
        let find = |line: u32, name: &str, part: &str| {
            define(&format!("{name}{part}")).map_err(|text| Problem { line, text })
        };
        for port in &interface.subscriptions {
            let of = find(port.line, &port.type_name, "")?;
            types.events.extend(port.event.iter().map(|event| (event.clone(), of.clone())));
            types.variables.insert(port.name.clone(), of);
        }
        for port in &interface.publishers {
            types.targets.insert(port.name.clone(), find(port.line, &port.type_name, "")?);
        }
        for port in &interface.services {
            let [request, response] =
                ["_Request", "_Response"].map(|part| find(port.line, &port.type_name, part));
            types.targets.insert(port.name.clone(), request?);
            types.events.insert(format!("done.call.{}", port.name), response?);
        }
        for port in &interface.actions {
            let [goal, result, feedback] =
                ["_Goal", "_Result", "_Feedback"].map(|part| find(port.line, &port.type_name, part));
            types.targets.insert(port.name.clone(), goal?);
            types.events.insert(format!("action.{}.feedback", port.name), feedback?);
            let result = result?;
            for end in ["succeeded", "aborted", "canceled"] {
                types.events.insert(format!("action.{}.{end}", port.name), result.clone());
            }
        }
        Ok(types)
    }
}

impl Chart {
    /// Returns what its expressions name that does not exist: variables, settings, functions and fields of
    /// messages. `define` returns the definition of a message, request, response, goal, result or feedback.
    ///
    /// # Errors
    /// The line of a port whose type `define` does not know.
    pub fn unknown_names(
        &self,
        define: &dyn Fn(&str) -> Result<DynamicType, String>,
    ) -> Result<Vec<Problem>, Problem> {
        Ok(unknown_names(self, &Types::of(&self.interface, define)?))
    }
}

fn unknown_names(chart: &Chart, types: &Types) -> Vec<Problem> {
    let settings: Vec<&str> = chart.interface.settings.iter().map(|setting| setting.name.as_str()).collect();
    let messages = &types.variables;
    let mut variables: BTreeSet<&str> = OWN.into_iter().chain(messages.keys().map(String::as_str)).collect();
    variables.extend(chart.states.iter().flat_map(|state| &state.data).map(|data| data.id.as_str()));
    let actions = all_actions(chart);
    variables.extend(actions.iter().flat_map(|action| match action {
        Action::ForEach(each) => each.names.iter().flatten().map(String::as_str).collect(),
        _ => Vec::new(),
    }));
    // Scripts make variables.
    let are_all_known =
        chart.scripts.is_empty() && !actions.iter().any(|action| matches!(action, Action::Script(_)));
    let mut problems = Vec::new();
    for Used { program, event } in programs(chart, types) {
        let declared = program.declared();
        for Path { line, names } in program.paths() {
            let (Some(root), fields) = (names.first(), &names[1.min(names.len())..]) else { continue };
            if declared.contains(root) {
                continue;
            }
            let unknown = match (root.as_str(), fields.first()) {
                ("setting", Some(name)) if !settings.contains(&name.as_str()) => Some(format!(
                    "there is no setting \"{name}\"{}",
                    suggestion(name, settings.iter().copied())
                )),
                ("_event", Some(name)) if !OF_EVENT.contains(&name.as_str()) => {
                    Some(format!("`_event` has no \"{name}\"{}", suggestion(name, OF_EVENT)))
                }
                ("_event", Some(name)) if name == "data" => {
                    event.and_then(|event| unknown_field(event, &fields[1..]))
                }
                (root, _) if messages.contains_key(root) => unknown_field(&messages[root], fields),
                (root, _) if are_all_known && !variables.contains(root) => Some(format!(
                    "there is no variable \"{root}\"{}",
                    suggestion(root, variables.iter().copied())
                )),
                _ => None,
            };
            problems.extend(
                unknown.map(|text| Problem { line, text: format!("`{}`: {text}", program.text.trim()) }),
            );
        }
        for (line, name) in program.unknown_calls() {
            let hint = suggestion(&name, functions().iter().map(String::as_str));
            let text = format!("`{}`: there is no function \"{name}\"{hint}", shown(&program.text));
            problems.push(Problem { line, text });
        }
    }
    for action in &actions {
        if let Action::Send(send) = action {
            problems.extend(unknown_parameters(send, types));
        }
    }
    problems.sort_by(|a, b| (a.line, &a.text).cmp(&(b.line, &b.text)));
    problems.dedup();
    problems
}

/// A script may be long.
fn shown(text: &str) -> &str {
    text.trim().lines().next().unwrap_or_default()
}

/// Checks the names of `<param>`, which set fields of the message that is sent.
fn unknown_parameters(send: &Send, types: &Types) -> Vec<Problem> {
    let Some(Given::Text(target)) = &send.target else { return Vec::new() };
    let (Some(of), Payload::Parameters(parameters)) = (types.targets.get(target), &send.payload) else {
        return Vec::new();
    };
    if matches!(&send.event, Some(Given::Text(event)) if event == "cancel") {
        return Vec::new();
    }
    let fields = |path: &str| -> Vec<String> {
        path.split('.').map(|name| name.split('[').next().unwrap_or_default().to_owned()).collect()
    };
    let unknown = parameters.iter().filter_map(|(path, value)| {
        let text = unknown_field(of, &fields(path))?;
        Some(Problem { line: value.line, text: format!("<param name=\"{path}\">: {text}") })
    });
    unknown.collect()
}

/// What is wrong with the names of fields of a type.
pub(crate) fn unknown_field(of: &DynamicType, names: &[String]) -> Option<String> {
    let (name, rest) = names.split_first()?;
    let Some(field) = of.fields().find(|field| field.name == name) else {
        let known: Vec<&str> = of.fields().map(|field| field.name).collect();
        return Some(format!("{} has no field \"{name}\"{}", of.name(), suggestion(name, known)));
    };
    match field.message {
        // Functions of arrays are called like fields.
        Some(message) if field.field_type.shape == Shape::Single => unknown_field(&message, rest),
        _ => None,
    }
}

/// An expression or script, and the type of `_event.data` in it, if that is known.
struct Used<'a> {
    program: &'a Program,
    event: Option<&'a DynamicType>,
}

fn programs<'a>(chart: &'a Chart, types: &'a Types) -> Vec<Used<'a>> {
    let mut used = Vec::new();
    let mut add = |programs: Vec<&'a Program>, event: Option<&'a DynamicType>| {
        used.extend(programs.into_iter().map(|program| Used { program, event }));
    };
    add(chart.scripts.iter().collect(), None);
    for transition in &chart.transitions {
        let event = match &transition.events[..] {
            [event] => types.events.get(event),
            _ => None,
        };
        add(transition.condition.iter().collect(), event);
        add(of_actions(&transition.actions), event);
    }
    for state in &chart.states {
        add(state.data.iter().filter_map(|data| data.value.as_ref()).collect(), None);
        add(of_payload(&state.done_data), None);
        state.entry.iter().chain(&state.exit).for_each(|actions| add(of_actions(actions), None));
    }
    used
}

/// The programs of actions, and of those in them.
fn of_actions(actions: &[Action]) -> Vec<&Program> {
    let mut programs = Vec::new();
    for action in each_action(actions) {
        match action {
            Action::Raise { .. } => {}
            Action::Script(script) => programs.push(script),
            Action::Cancel { id, .. } => programs.extend(computed(Some(id))),
            Action::Log { value, .. } => programs.extend(value),
            Action::Assign { value, .. } => programs.push(value),
            Action::If { branches } => {
                programs.extend(branches.iter().filter_map(|(condition, _)| condition.as_ref()))
            }
            Action::ForEach(each) => programs.push(&each.array),
            Action::Send(send) => {
                for given in [&send.event, &send.target, &send.kind, &send.delay] {
                    programs.extend(computed(given.as_ref()));
                }
                programs.extend(of_payload(&send.payload));
            }
        }
    }
    programs
}

fn computed(given: Option<&Given>) -> Option<&Program> {
    match given {
        Some(Given::Computed(program)) => Some(program),
        _ => None,
    }
}

fn of_payload(payload: &Payload) -> Vec<&Program> {
    match payload {
        Payload::None => Vec::new(),
        Payload::Content(given) => computed(Some(given)).into_iter().collect(),
        Payload::Parameters(parameters) => parameters.iter().map(|(_, value)| value).collect(),
    }
}

/// All actions of a chart.
fn all_actions(chart: &Chart) -> Vec<&Action> {
    let blocks = chart.states.iter().flat_map(|state| state.entry.iter().chain(&state.exit));
    let blocks = blocks.chain(chart.transitions.iter().map(|transition| &transition.actions));
    blocks.flat_map(|actions| each_action(actions)).collect()
}

/// The actions and those in them.
fn each_action(actions: &[Action]) -> Vec<&Action> {
    let mut open: Vec<&Action> = actions.iter().collect();
    let mut all = Vec::new();
    while let Some(action) = open.pop() {
        all.push(action);
        match action {
            Action::If { branches } => open.extend(branches.iter().flat_map(|(_, actions)| actions)),
            Action::ForEach(each) => open.extend(&each.body),
            _ => {}
        }
    }
    all
}
