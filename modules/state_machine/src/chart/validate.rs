//! What a chart must keep to so that every configuration of it is legal, and what is probably a mistake.

use super::*;
use std::collections::{BTreeMap, BTreeSet};

pub(super) fn validate(chart: &mut Chart) -> Result<(), Vec<Problem>> {
    let mut problems = Vec::new();
    let mut fail = |line: u32, text: String| problems.push(Problem { line, text });
    let mut lines = BTreeMap::new();
    for state in chart.states.iter().skip(1) {
        if let Some(first) = lines.insert(&state.id, state.line) {
            fail(
                state.line,
                format!("there is another state \"{}\" on line {first}; ids are unique", state.id),
            );
        }
    }
    if chart.states[0].children.is_empty() {
        fail(1, "the chart has no state".to_owned());
    }
    for (number, state) in chart.states.iter().enumerate() {
        validate_state(chart, number, state, &mut fail);
    }
    for transition in &chart.transitions {
        validate_targets(chart, transition, &mut fail);
    }
    validate_names(chart, &mut fail);
    if !problems.is_empty() {
        problems.sort_by_key(|problem| problem.line);
        return Err(problems);
    }
    chart.findings = unreachable(chart);
    Ok(())
}

fn validate_state(chart: &Chart, number: usize, state: &State, fail: &mut impl FnMut(u32, String)) {
    let default = state.initial.map(|initial| &chart.transitions[initial]);
    if state.is_history() {
        let Some(parent) = state.parent else { return };
        let Some(default) = default else {
            let text =
                format!("the history \"{}\" needs a <transition> to the states it has at first", state.id);
            return fail(state.line, text);
        };
        let is_fit = |&target: &usize| match state.kind {
            StateKind::Deep => chart.is_inside(target, parent),
            _ => chart.states[target].parent == Some(parent),
        };
        if default.targets.is_empty() || !default.targets.iter().all(is_fit) {
            fail(
                default.line,
                format!("the default of the history \"{}\" is a state of its parent", state.id),
            );
        }
    } else if let Some(default) = default {
        if matches!(state.kind, StateKind::Atomic | StateKind::Parallel | StateKind::Final) {
            fail(state.line, format!("\"{}\" has an initial state, but none to choose from", state.id));
        }
        if default.targets.is_empty()
            || !default.targets.iter().all(|&target| chart.is_inside(target, number))
        {
            fail(default.line, format!("the initial states of \"{}\" are states in it", state.id));
        }
    }
    if let Some(default) = default.filter(|default| !default.events.is_empty() || default.condition.is_some())
    {
        fail(default.line, "an initial or default transition has neither `event` nor `cond`".to_owned());
    }
}

/// States can be active together if the innermost state that contains two of them is parallel, or one
/// contains the other.
fn validate_targets(chart: &Chart, transition: &Transition, fail: &mut impl FnMut(u32, String)) {
    for (number, &a) in transition.targets.iter().enumerate() {
        for &b in &transition.targets[number + 1..] {
            let is_one_in_other = a == b || chart.is_inside(a, b) || chart.is_inside(b, a);
            let innermost = chart.ancestors(a).find(|&outer| chart.is_inside(b, outer));
            let is_parallel = innermost.is_some_and(|outer| chart.states[outer].kind == StateKind::Parallel);
            if !is_one_in_other && !is_parallel {
                let (a, b) = (&chart.states[a].id, &chart.states[b].id);
                let text =
                    format!("\"{a}\" and \"{b}\" cannot be active together: they are in no <parallel>");
                return fail(transition.line, text);
            }
        }
    }
}

fn validate_names(chart: &Chart, fail: &mut impl FnMut(u32, String)) {
    let Interface { subscriptions, publishers, services, actions, settings, .. } = &chart.interface;
    let variables = chart.states.iter().flat_map(|state| &state.data).map(|data| (&data.id, data.line));
    let topics = subscriptions.iter().map(|port| (&port.name, port.line));
    let targets = [publishers, services, actions].into_iter().flatten().map(|port| (&port.name, port.line));
    let settings = settings.iter().map(|setting| (&setting.name, setting.line));
    let mut once = |names: &mut dyn Iterator<Item = (&String, u32)>| {
        let mut lines = BTreeMap::new();
        for (name, line) in names {
            if name.starts_with('_') || name == "setting" {
                fail(
                    line,
                    format!("\"{name}\" is the name of a variable that every chart has; choose another"),
                );
            }
            if let Some(first) = lines.insert(name, line) {
                fail(line, format!("\"{name}\" is on line {first} already; choose another name"));
            }
        }
    };
    once(&mut variables.chain(topics));
    once(&mut targets.into_iter());
    once(&mut settings.into_iter());
}

/// The states that no path of transitions enters, whatever events come.
fn unreachable(chart: &Chart) -> Vec<Problem> {
    let mut reached = BTreeSet::new();
    let mut open = vec![0];
    while let Some(number) = open.pop() {
        if !reached.insert(number) {
            continue;
        }
        let state = &chart.states[number];
        open.extend(state.parent);
        // Being in it includes being in a default child, even where a target inside is named: that may not be
        // the whole of it.
        match (state.kind, state.initial) {
            (StateKind::Parallel, _) => open.extend(&state.children),
            (_, Some(initial)) => open.extend(&chart.transitions[initial].targets),
            (StateKind::Compound, None) => open.extend(state.children.first()),
            _ => {}
        }
        for &transition in &state.transitions {
            open.extend(&chart.transitions[transition].targets);
        }
    }
    let is_missed = |(number, state): &(usize, &State)| {
        let is_first = state.parent.is_none_or(|parent| reached.contains(&parent));
        !reached.contains(number) && is_first
    };
    let missed = chart.states.iter().enumerate().filter(is_missed);
    missed
        .map(|(_, state)| {
            let text = format!("the state \"{}\" is never entered: no transition leads to it", state.id);
            Problem { line: state.line, text }
        })
        .collect()
}
