//! Random charts: every configuration is legal, the same events give the same run, and reloads keep both.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_state_machine::{Chart, Dynamic, Effect, Event, Interpreter};
use fuzzing::Random;
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// A chart as a tree, beside the code that is tested.
#[derive(Clone, Debug)]
enum Tree {
    Atomic,
    Final,
    Compound(Vec<Tree>, bool),
    Parallel(Vec<Tree>),
}

fn tree() -> impl Strategy<Value = Tree> {
    let leaf = prop_oneof![6 => Just(Tree::Atomic), 1 => Just(Tree::Final)];
    let state = leaf.prop_recursive(3, 24, 4, |inner| {
        prop_oneof![
            (prop::collection::vec(inner.clone(), 1..4), any::<bool>())
                .prop_map(|(states, history)| Tree::Compound(states, history)),
            prop::collection::vec(inner.prop_filter("no final", |tree| !matches!(tree, Tree::Final)), 1..4)
                .prop_map(Tree::Parallel),
        ]
    });
    prop::collection::vec(state, 1..4).prop_map(|states| Tree::Compound(states, false))
}

/// What a configuration is checked against.
#[derive(Default)]
struct Shape {
    parents: BTreeMap<String, String>,
    children: BTreeMap<String, Vec<String>>,
    parallel: BTreeSet<String>,
    targets: Vec<String>,
}

fn shape(tree: &Tree, id: &str, shape: &mut Shape) {
    let (children, is_parallel) = match tree {
        Tree::Atomic | Tree::Final => return,
        Tree::Compound(children, has_history) => {
            if *has_history {
                shape.targets.push(format!("{id}h"));
            }
            (children, false)
        }
        Tree::Parallel(children) => (children, true),
    };
    if is_parallel {
        shape.parallel.insert(id.to_owned());
    }
    for (number, child) in children.iter().enumerate() {
        let name = format!("{id}_{number}");
        shape.parents.insert(name.clone(), id.to_owned());
        shape.children.entry(id.to_owned()).or_default().push(name.clone());
        shape.targets.push(name.clone());
        self::shape(child, &name, shape);
    }
}

const EVENTS: [&str; 4] = ["a", "b", "c.d", "c"];

fn write(tree: &Tree, id: &str, targets: &[String], random: &mut Random, text: &mut String) {
    let (name, children, history) = match tree {
        Tree::Final => return writeln!(text, r#"<final id="{id}"/>"#).unwrap(),
        Tree::Atomic => ("state", &[][..], false),
        Tree::Compound(children, history) => ("state", &children[..], *history),
        Tree::Parallel(children) => ("parallel", &children[..], false),
    };
    writeln!(text, r#"<{name} id="{id}"><onentry><log label="in" expr="'{id}'"/></onentry>"#).unwrap();
    writeln!(text, r#"<onexit><log label="out" expr="'{id}'"/></onexit>"#).unwrap();
    if history {
        let kind = ["deep", "shallow"][random.below(2)];
        writeln!(text, r#"<history id="{id}h" type="{kind}"><transition target="{id}_0"/></history>"#)
            .unwrap();
    }
    for _ in 0..random.below(3) {
        let event = EVENTS[random.below(4)];
        let kind = ["internal", "external"][random.below(2)];
        let target = &targets[random.below(targets.len())];
        let action =
            ["<raise event='a'/>", "<send event='b' delay='1s'/>", "<assign location='n' expr='n + 1'/>", ""];
        let action = action[random.below(4)];
        let condition = ["", r#" cond="n &lt; 9""#, r#" cond="n % 2 == 0""#][random.below(3)];
        writeln!(
            text,
            r#"<transition event="{event}" type="{kind}" target="{target}"{condition}>{action}</transition>"#
        )
        .unwrap();
    }
    for (number, child) in children.iter().enumerate() {
        write(child, &format!("{id}_{number}"), targets, random, text);
    }
    writeln!(text, "</{name}>").unwrap();
}

fn chart_of(tree: &Tree, seed: u64) -> (Chart, Shape, String) {
    let Tree::Compound(states, _) = tree else { unreachable!("the whole is compound") };
    let mut of = Shape::default();
    shape(tree, "s", &mut of);
    let mut random = Random::new(seed);
    let mut text = r#"<scxml xmlns="http://www.w3.org/2005/07/scxml" version="1.0">"#.to_owned();
    text.push_str(r#"<datamodel><data id="n" expr="0"/></datamodel>"#);
    for (number, state) in states.iter().enumerate() {
        write(state, &format!("s_{number}"), &of.targets, &mut random, &mut text);
    }
    text.push_str("</scxml>");
    (
        Chart::parse(Path::new("random.scxml"), &text).unwrap_or_else(|error| panic!("{error}\n{text}")),
        of,
        text,
    )
}

fn assert_legal(machine: &Interpreter, of: &Shape) {
    let active: BTreeSet<&str> = machine.active().collect();
    let children = |id: &str| of.children.get(id).map_or(&[][..], Vec::as_slice);
    for &state in active.iter().chain(&["s"]) {
        let inside = children(state).iter().filter(|child| active.contains(child.as_str())).count();
        let wanted =
            if of.parallel.contains(state) { children(state).len() } else { children(state).len().min(1) };
        assert_eq!(inside, wanted, "{state} in {active:?}");
        if let Some(parent) = of.parents.get(state) {
            assert!(parent == "s" || active.contains(parent.as_str()), "{state} without {parent}");
        }
    }
}

/// The log tells that each state is entered once, then exited once.
fn assert_balanced(effects: &[Effect], inside: &mut BTreeSet<String>) {
    for effect in effects {
        match effect {
            Effect::Log { label, text, .. } if label == "in" => {
                assert!(inside.insert(text.clone()), "{text} twice")
            }
            Effect::Log { label, text, .. } if label == "out" => {
                assert!(inside.remove(text), "{text} was not in")
            }
            _ => {}
        }
    }
}

fn run(tree: &Tree, seed: u64, events: &[u8]) -> String {
    let (chart, of, _) = chart_of(tree, seed);
    let mut machine = Interpreter::new(Arc::new(chart), "random");
    let mut inside = BTreeSet::new();
    let mut told = String::new();
    let effects = machine.start(Duration::ZERO);
    assert_balanced(&effects, &mut inside);
    assert_legal(&machine, &of);
    for (number, event) in events.iter().enumerate() {
        machine.send(Event::new(EVENTS[usize::from(event % 4)], Dynamic::UNIT));
        let effects = machine.advance(Duration::from_millis(400 * number as u64));
        write!(told, "{effects:?}{:?}", machine.active().collect::<Vec<_>>()).unwrap();
        assert_balanced(&effects, &mut inside);
        assert_legal(&machine, &of);
    }
    told
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn configurations_are_legal_and_runs_repeat(tree in tree(), seed: u64, events in prop::collection::vec(any::<u8>(), 0..30)) {
        prop_assert_eq!(run(&tree, seed, &events), run(&tree, seed, &events));
    }

    #[test]
    fn another_chart_takes_over_in_a_legal_configuration(old in tree(), new in tree(), seed: u64, events in prop::collection::vec(any::<u8>(), 0..10)) {
        let (chart, _, _) = chart_of(&old, seed);
        let mut machine = Interpreter::new(Arc::new(chart), "random");
        machine.start(Duration::ZERO);
        for event in &events {
            machine.send(Event::new(EVENTS[usize::from(event % 4)], Dynamic::UNIT));
            machine.advance(Duration::ZERO);
        }
        let (chart, of, _) = chart_of(&new, seed ^ 1);
        let mut next = Interpreter::new(Arc::new(chart), "random");
        next.resume(machine.memory(), Duration::from_secs(5));
        assert_legal(&next, &of);
        for event in &events {
            next.send(Event::new(EVENTS[usize::from(event % 4)], Dynamic::UNIT));
            next.advance(Duration::from_secs(6));
            assert_legal(&next, &of);
        }
    }

    #[test]
    fn the_same_chart_goes_on_where_it_was(tree in tree(), seed: u64, events in prop::collection::vec(any::<u8>(), 0..10)) {
        let (chart, _, _) = chart_of(&tree, seed);
        let chart = Arc::new(chart);
        let mut machine = Interpreter::new(Arc::clone(&chart), "random");
        machine.start(Duration::ZERO);
        for event in &events {
            machine.send(Event::new(EVENTS[usize::from(event % 4)], Dynamic::UNIT));
            machine.advance(Duration::ZERO);
        }
        let before: Vec<String> = machine.active().map(str::to_owned).collect();
        for _ in 0..10 {
            let mut next = Interpreter::new(Arc::clone(&chart), "random");
            let effects = next.resume(machine.memory(), Duration::ZERO);
            prop_assert!(effects.is_empty(), "{:?}", effects);
            prop_assert_eq!(&next.active().map(str::to_owned).collect::<Vec<_>>(), &before);
            machine = next;
        }
    }

    #[test]
    fn no_text_breaks_the_parser(tree in tree(), seed: u64, cuts in prop::collection::vec((any::<u16>(), any::<u8>()), 1..20)) {
        let (_, _, text) = chart_of(&tree, seed);
        let mut bytes = text.into_bytes();
        for (place, byte) in cuts {
            let place = usize::from(place) % bytes.len();
            match byte % 3 {
                0 => bytes[place] = byte,
                1 => _ = bytes.remove(place),
                _ => bytes.insert(place, b"<>\"'/&{}"[usize::from(byte / 3) % 8]),
            }
        }
        if let Err(error) = Chart::parse(Path::new("broken.scxml"), &String::from_utf8_lossy(&bytes)) {
            prop_assert!(!error.problems.is_empty());
        }
    }
}

#[test]
fn deep_and_endless_texts_are_refused() {
    for text in [
        "<state>".repeat(100_000),
        format!("<scxml xmlns='http://www.w3.org/2005/07/scxml'>{}", "<state>".repeat(200)),
        "x".repeat(2 << 20),
        String::new(),
    ] {
        assert!(Chart::parse(Path::new("deep.scxml"), &text).is_err());
    }
}
