//! What expressions name that does not exist: variables, settings, and fields of messages.

use crate::chart::{Action, Chart, Given, Payload, hint};
use crate::expressions::{Path, Problem, Program};
use downbeat_msgs::definitions::Shape;
use downbeat_msgs::dynamic::DynamicType;
use std::collections::{BTreeMap, BTreeSet};

/// Variables that every chart has.
const OWN: [&str; 5] = ["_event", "_name", "_sessionid", "_ioprocessors", "setting"];

/// Checks the expressions of a chart; `messages` are the types of its subscriptions, by their variables.
pub(crate) fn unknown_names(chart: &Chart, messages: &BTreeMap<String, DynamicType>) -> Vec<Problem> {
    let programs = programs(chart);
    let settings: Vec<&str> = chart.interface.settings.iter().map(|setting| setting.name.as_str()).collect();
    let mut variables: BTreeSet<&str> = OWN.into_iter().chain(messages.keys().map(String::as_str)).collect();
    variables.extend(chart.states.iter().flat_map(|state| &state.data).map(|data| data.id.as_str()));
    variables.extend(each_action(chart).into_iter().flat_map(|action| match action {
        Action::ForEach(each) => each.names.iter().flatten().map(String::as_str).collect(),
        _ => Vec::new(),
    }));
    // Scripts make variables.
    let are_all_known = chart.scripts.is_empty()
        && !each_action(chart).iter().any(|action| matches!(action, Action::Script(_)));
    let mut problems = Vec::new();
    for program in programs {
        for Path { line, names } in program.paths() {
            let (Some(root), fields) = (names.first(), &names[1.min(names.len())..]) else { continue };
            let unknown = match (root.as_str(), fields.first()) {
                ("setting", Some(name)) if !settings.contains(&name.as_str()) => {
                    Some(format!("there is no setting \"{name}\"{}", hint(name, settings.iter().copied())))
                }
                (root, _) if messages.contains_key(root) => unknown_field(&messages[root], fields),
                (root, _) if are_all_known && !variables.contains(root) => {
                    Some(format!("there is no variable \"{root}\"{}", hint(root, variables.iter().copied())))
                }
                _ => None,
            };
            problems.extend(
                unknown.map(|text| Problem { line, text: format!("`{}`: {text}", program.text.trim()) }),
            );
        }
    }
    problems.sort_by_key(|problem| problem.line);
    problems.dedup();
    problems
}

fn unknown_field(of: &DynamicType, names: &[String]) -> Option<String> {
    let (name, rest) = names.split_first()?;
    let Some(field) = of.fields().find(|field| field.name == name) else {
        let known: Vec<&str> = of.fields().map(|field| field.name).collect();
        return Some(format!("{} has no field \"{name}\"{}", of.name(), hint(name, known)));
    };
    match field.message {
        // Functions of arrays are called like fields.
        Some(message) if field.field_type.shape == Shape::Single => unknown_field(&message, rest),
        _ => None,
    }
}

fn programs(chart: &Chart) -> Vec<&Program> {
    let mut programs: Vec<&Program> =
        chart.transitions.iter().filter_map(|transition| transition.condition.as_ref()).collect();
    for state in &chart.states {
        programs.extend(state.data.iter().filter_map(|data| data.value.as_ref()));
        programs.extend(of_payload(&state.done_data));
    }
    for action in each_action(chart) {
        match action {
            Action::Raise { .. } | Action::Script(_) => {}
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

/// All actions, those in others included.
fn each_action(chart: &Chart) -> Vec<&Action> {
    let blocks = chart.states.iter().flat_map(|state| state.entry.iter().chain(&state.exit));
    let mut open: Vec<&Action> =
        blocks.chain(chart.transitions.iter().map(|transition| &transition.actions)).flatten().collect();
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
