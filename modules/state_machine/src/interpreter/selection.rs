//! The transitions of a step that do not conflict, and the states that it exits and enters.

use super::Interpreter;
use crate::chart::{StateKind, Transition};
use std::collections::{BTreeMap, BTreeSet};

/// The states to enter in a step, and those whose initial transitions are executed.
#[derive(Default)]
pub(super) struct Entering {
    pub(super) states: BTreeSet<usize>,
    pub(super) defaults: BTreeSet<usize>,
    /// Defaults of histories, by the parents.
    pub(super) history_defaults: BTreeMap<usize, usize>,
}

impl Interpreter {
    /// Whether a set of states can be the innermost states of one configuration inside a state.
    pub(super) fn can_be_together(&self, outer: usize, states: &[usize]) -> bool {
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
    pub(super) fn complete(&self, state: usize, kept: &BTreeSet<usize>, enter: &mut Entering) {
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

    pub(super) fn without_conflicts(&self, enabled: Vec<usize>) -> Vec<usize> {
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
    pub(super) fn exits(&self, transition: usize) -> BTreeSet<usize> {
        match self.domain(transition) {
            Some(domain) => {
                let inside = self.active.range(domain + 1..self.chart.states[domain].end);
                inside.copied().collect()
            }
            None => BTreeSet::new(),
        }
    }

    /// The innermost state that stays active in a transition; `None` without targets.
    pub(super) fn domain(&self, transition: usize) -> Option<usize> {
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

    pub(super) fn add_targets(&self, transition: usize, domain: usize, enter: &mut Entering) {
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
    pub(super) fn add_default(&self, state: usize, enter: &mut Entering) {
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
}
