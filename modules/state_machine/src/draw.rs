//! Charts as pictures: DOT for Graphviz, and Mermaid.

use crate::chart::{Chart, StateKind, Transition};
use std::collections::BTreeSet;
use std::fmt::Write;

impl Chart {
    /// The chart in DOT; the active states are filled.
    #[must_use]
    pub fn to_dot(&self, active: &BTreeSet<&str>) -> String {
        let mut dot = format!(
            "digraph {} {{\n    compound=true; node [shape=box style=rounded];\n",
            quoted(&self.name)
        );
        self.children_in_dot(0, active, 1, &mut dot);
        for transition in self.drawn_transitions() {
            let text = quoted(&label(transition));
            let source = transition.source;
            for &target in transition.targets.iter().chain(transition.targets.is_empty().then_some(&source)) {
                let (tail, head) = (self.leaf_of(source), self.leaf_of(target));
                let cluster = |state: usize, end: &str| match self.states[state].children.is_empty() {
                    true => String::new(),
                    false => format!(" {end}=cluster_{state}"),
                };
                let (tail_cluster, head_cluster) = (cluster(source, "ltail"), cluster(target, "lhead"));
                let _ = writeln!(dot, "    s{tail} -> s{head} [label={text}{tail_cluster}{head_cluster}];");
            }
        }
        dot.push_str("}\n");
        dot
    }

    /// The chart as a Mermaid `stateDiagram-v2`; the active states have the class `active`.
    #[must_use]
    pub fn to_mermaid(&self, active: &BTreeSet<&str>) -> String {
        let mut text = "stateDiagram-v2\n    classDef active fill:#fc6,stroke:#333\n".to_owned();
        self.children_in_mermaid(0, 1, &mut text);
        for transition in self.drawn_transitions() {
            let source = transition.source;
            let label = plain(&label(transition));
            for &target in transition.targets.iter().chain(transition.targets.is_empty().then_some(&source)) {
                let colon = if label.is_empty() { "" } else { " : " };
                let _ = writeln!(text, "    s{source} --> s{target}{colon}{label}");
            }
        }
        for (number, _) in
            self.states.iter().enumerate().filter(|(_, state)| active.contains(state.id.as_str()))
        {
            let _ = writeln!(text, "    class s{number} active");
        }
        text
    }

    /// Those of states: first states are drawn otherwise.
    fn drawn_transitions(&self) -> impl Iterator<Item = &Transition> {
        let of_states = self.states.iter().flat_map(|state| {
            state
                .transitions
                .iter()
                .chain(state.initial.filter(|_| state.is_history()).as_ref())
                .copied()
                .collect::<Vec<_>>()
        });
        of_states.map(|transition| &self.transitions[transition])
    }

    fn first_states(&self, state: usize) -> Vec<usize> {
        match (self.states[state].kind, self.states[state].initial) {
            (StateKind::Compound, Some(initial)) => self.transitions[initial].targets.clone(),
            (StateKind::Compound, None) => self.states[state].children.first().copied().into_iter().collect(),
            _ => Vec::new(),
        }
    }

    /// An edge of DOT ends at nodes, not at clusters.
    fn leaf_of(&self, state: usize) -> usize {
        self.states[state].children.first().map_or(state, |&child| self.leaf_of(child))
    }

    fn children_in_dot(&self, state: usize, active: &BTreeSet<&str>, depth: usize, dot: &mut String) {
        let indent = "    ".repeat(depth);
        for first in self.first_states(state) {
            let cluster = if self.states[first].children.is_empty() {
                String::new()
            } else {
                format!(" [lhead=cluster_{first}]")
            };
            let _ = writeln!(dot, "{indent}i{state}_{first} [shape=point label=\"\"];");
            let _ = writeln!(dot, "{indent}i{state}_{first} -> s{}{cluster};", self.leaf_of(first));
        }
        for &child in self.states[state].children.iter().chain(&self.states[state].histories) {
            let of = &self.states[child];
            let name = quoted(&of.id);
            let fill = if active.contains(of.id.as_str()) { " fillcolor=\"#ffcc66\"" } else { "" };
            if of.children.is_empty() {
                let shape = match of.kind {
                    StateKind::Final => " peripheries=2",
                    StateKind::Shallow | StateKind::Deep => " shape=circle",
                    _ => "",
                };
                let style = if fill.is_empty() { "" } else { " style=\"rounded,filled\"" };
                let _ = writeln!(dot, "{indent}s{child} [label={name}{shape}{style}{fill}];");
                continue;
            }
            let line = if of.kind == StateKind::Parallel { "dashed" } else { "rounded" };
            let filled =
                if fill.is_empty() { String::new() } else { ",filled\"; fillcolor=\"#fff0cc".to_owned() };
            let _ = writeln!(
                dot,
                "{indent}subgraph cluster_{child} {{\n{indent}    label={name}; style=\"{line}{filled}\";"
            );
            self.children_in_dot(child, active, depth + 1, dot);
            let _ = writeln!(dot, "{indent}}}");
        }
    }

    fn children_in_mermaid(&self, state: usize, depth: usize, text: &mut String) {
        let indent = "    ".repeat(depth);
        for first in self.first_states(state) {
            let _ = writeln!(text, "{indent}[*] --> s{first}");
        }
        let is_parallel = self.states[state].kind == StateKind::Parallel;
        for (number, &child) in self.states[state].children.iter().enumerate() {
            if is_parallel && number > 0 {
                let _ = writeln!(text, "{indent}--");
            }
            let _ = writeln!(text, "{indent}state \"{}\" as s{child}", plain(&self.states[child].id));
            if !self.states[child].children.is_empty() {
                let _ = writeln!(text, "{indent}state s{child} {{");
                self.children_in_mermaid(child, depth + 1, text);
                let _ = writeln!(text, "{indent}}}");
            }
        }
        for &history in &self.states[state].histories {
            let star = if self.states[history].kind == StateKind::Deep { "H*" } else { "H" };
            let _ =
                writeln!(text, "{indent}state \"{star} {}\" as s{history}", plain(&self.states[history].id));
        }
    }
}

fn label(transition: &Transition) -> String {
    let condition = transition.condition.as_ref().map(|condition| format!("[{}]", condition.text.trim()));
    [transition.events.join(" "), condition.unwrap_or_default()].join(" ").trim().to_owned()
}

fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\"").replace(['\n', '\r'], " "))
}

/// Without what ends a label in Mermaid.
fn plain(text: &str) -> String {
    text.chars()
        .map(|c| if matches!(c, ';' | ':' | '"' | '\n' | '\r' | '#' | '{' | '}') { ' ' } else { c })
        .collect()
}
