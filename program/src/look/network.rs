//! The node with which commands inspect the network, and how long it waits.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use crate::network::NetworkArguments;
use crate::stop::Stop;
use clap::Args;
use downbeat_bridge::edge::Interfaces;
use downbeat_bridge::ros::{EndpointKind, Found, Node, Participant};
use downbeat_robot::{Catalog, RosArgs};

use super::values::seconds;

/// The environment of a command.
#[derive(Clone, Copy)]
pub(crate) struct Environment<'a> {
    /// The program's registrations, including interfaces.
    pub(crate) catalog: &'a Catalog,
    pub(crate) ros: &'a RosArgs,
}

/// Arguments of every command that inspects the network.
#[derive(Args)]
pub(crate) struct LookArguments {
    #[command(flatten)]
    pub(super) network: NetworkArguments,
    /// The maximum time to wait for discovery: seconds, or with a unit.
    #[arg(long, value_name = "SECONDS", value_parser = seconds, default_value = "8")]
    pub(super) spin_time: Duration,
    /// Take the time from /clock.
    #[arg(short = 's', long)]
    pub(super) use_sim_time: bool,
    /// Accepted for compatibility with `ros2`: there is no daemon.
    #[arg(long)]
    no_daemon: bool,
}

/// A node with a hidden name, like those of ROS 2 tools.
pub(crate) struct Look {
    pub(super) participant: Participant,
    pub(super) node: Node,
    pub(super) stop: Stop,
    /// The interfaces of the program.
    pub(super) interfaces: Interfaces,
    /// The maximum time to wait for discovery.
    longest: Duration,
}

/// When a list is considered complete.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Patience {
    /// When nothing new is discovered.
    Endpoints,
    /// When the node of each endpoint is also known, which takes some seconds.
    Nodes,
}

const POLL: Duration = Duration::from_millis(20);

/// Participants answer the first announcement within this time, with some margin for slow ones.
const AT_LEAST: Duration = Duration::from_secs(2);

/// The same where everything that was discovered has answered completely: most answer within some
/// milliseconds.
const AT_LEAST_ANSWERED: Duration = Duration::from_millis(450);

/// How long nothing new must be discovered before a list is considered complete.
const QUIET: Duration = Duration::from_secs(1);

/// The endpoints of one participant are discovered one after another: this long after the last one, all are
/// known.
const TOGETHER: Duration = Duration::from_millis(300);

impl Look {
    pub(super) fn join(
        command: &str,
        arguments: &LookArguments,
        environment: &Environment<'_>,
    ) -> anyhow::Result<Self> {
        // Only used by clap.
        let _ = arguments.no_daemon;
        let name = format!("_downbeat_{command}_{}", std::process::id());
        Self::join_as(&name, &arguments.network, arguments.spin_time, environment)
    }

    pub(crate) fn join_as(
        name: &str,
        network: &NetworkArguments,
        longest: Duration,
        environment: &Environment<'_>,
    ) -> anyhow::Result<Self> {
        let stop = Stop::new()?.at_end_of_output();
        let Environment { catalog, ros } = *environment;
        let (participant, node) = network.node(name, catalog, ros)?;
        Ok(Self { participant, node, stop, interfaces: catalog.interfaces.clone(), longest })
    }

    /// Sets another maximum time to wait, if given.
    pub(super) fn no_longer_than(self, longest: Option<Duration>) -> Self {
        Self { longest: longest.unwrap_or(self.longest), ..self }
    }

    /// Everything, for lists.
    pub(crate) fn all(&self, patience: Patience) -> Found {
        self.all_with(patience, |_| true)
    }

    /// The same, but waits until the condition holds or the time-out expires.
    pub(super) fn all_with(&self, patience: Patience, has: impl Fn(&Found) -> bool) -> Found {
        let has_nodes = |found: &Found| found.endpoints.iter().all(|endpoint| endpoint.node.is_some());
        self.watch(AT_LEAST, QUIET, |found| {
            (patience == Patience::Endpoints || has_nodes(found)) && has(found)
        })
    }

    /// What is discovered as soon as the condition holds, with related endpoints, or when the time-out
    /// expires.
    pub(super) fn found_with(&self, has: impl Fn(&Found) -> bool) -> Found {
        self.watch(Duration::ZERO, TOGETHER, has)
    }

    /// Waits until a condition holds, at most for `longest` if given; returns whether it holds.
    pub(super) fn wait_for(&self, longest: Option<Duration>, mut holds: impl FnMut() -> bool) -> bool {
        let begin = Instant::now();
        while !self.stop.is_due() {
            if holds() {
                return true;
            }
            if longest.is_some_and(|longest| begin.elapsed() >= longest) {
                return false;
            }
            self.stop.sleep(POLL);
        }
        false
    }

    fn watch(&self, at_least: Duration, quiet: Duration, is_enough: impl Fn(&Found) -> bool) -> Found {
        let begin = Instant::now();
        let mut found = self.participant.found();
        let mut changed = begin;
        while begin.elapsed() < self.longest && !self.stop.is_due() {
            let is_complete = |at_least: Duration, quiet: Duration| {
                begin.elapsed() >= at_least && changed.elapsed() >= quiet && is_enough(&found)
            };
            // Where answers came late, others may come later still.
            let answered_in = changed.saturating_duration_since(begin);
            if is_complete(at_least, quiet)
                || is_complete(at_least.min(AT_LEAST_ANSWERED), quiet.min(TOGETHER.max(answered_in)))
                    && self.participant.has_heard_all()
            {
                break;
            }
            self.stop.sleep(POLL);
            let now = self.participant.found();
            if now != found {
                (found, changed) = (now, Instant::now());
            }
        }
        found
    }
}

/// Names and their types, sorted by name.
pub(super) type NamesAndTypes = BTreeMap<String, BTreeSet<String>>;

/// The names with endpoints of one of the kinds, optionally of one node only.
pub(super) fn names_and_types(found: &Found, kinds: &[EndpointKind], node: Option<&str>) -> NamesAndTypes {
    let mut names = NamesAndTypes::new();
    let is_of_node = |of: &Option<String>| node.is_none_or(|node| of.as_deref() == Some(node));
    for endpoint in &found.endpoints {
        if kinds.contains(&endpoint.kind) && is_of_node(&endpoint.node) {
            names.entry(endpoint.name.clone()).or_default().insert(endpoint.type_name.clone());
        }
    }
    names
}

pub(super) const OF_TOPICS: &[EndpointKind] = &[EndpointKind::Publisher, EndpointKind::Subscription];
pub(super) const OF_SERVICES: &[EndpointKind] = &[EndpointKind::Server, EndpointKind::Client];

/// Actions, which are recognised by their feedback topic, which the server publishes.
pub(super) fn actions(found: &Found, kinds: &[EndpointKind], node: Option<&str>) -> NamesAndTypes {
    let mut actions = NamesAndTypes::new();
    for (topic, types) in names_and_types(found, kinds, node) {
        let Some(action) = topic.strip_suffix("/_action/feedback") else { continue };
        let types = types.iter().filter_map(|name| name.strip_suffix("_FeedbackMessage")).map(str::to_owned);
        let types: BTreeSet<_> = types.collect();
        if !types.is_empty() {
            actions.insert(action.to_owned(), types);
        }
    }
    actions
}

/// The number of endpoints of one kind with a name.
pub(super) fn count(found: &Found, name: &str, kind: EndpointKind) -> usize {
    found.endpoints.iter().filter(|endpoint| endpoint.kind == kind && endpoint.name == name).count()
}

/// Returns whether tools hide a name by default: a part of it starts with an underscore.
pub(super) fn is_hidden(name: &str) -> bool {
    name.split('/').any(|part| part.starts_with('_'))
}

/// Returns whether tools hide a node by default, by its name without the namespace.
pub(super) fn is_hidden_node(name: &str) -> bool {
    name.rsplit('/').next().is_some_and(|name| name.is_empty() || name.starts_with('_'))
}

/// The sorted names of nodes; names used by several nodes are repeated.
pub(super) fn node_names(found: &Found, with_hidden: bool) -> Vec<&str> {
    let names = found.nodes.iter().map(|node| node.name.as_str());
    names.filter(|name| with_hidden || !is_hidden_node(name)).collect()
}

/// Adds the leading slash, which may be omitted.
pub(super) fn absolute(name: &str) -> String {
    if name.starts_with('/') { name.to_owned() } else { format!("/{name}") }
}

/// Types as shown in lists after a name.
pub(super) fn joined(types: &BTreeSet<String>) -> String {
    types.iter().map(String::as_str).collect::<Vec<_>>().join(", ")
}

/// A type, or a list of types in Python's format.
pub(super) fn type_or_types(types: &BTreeSet<String>) -> String {
    match types.iter().next() {
        Some(only) if types.len() == 1 => only.clone(),
        _ => format!("[{}]", types.iter().map(|name| format!("'{name}'")).collect::<Vec<_>>().join(", ")),
    }
}

/// Prints names for `list -t` and `list -c`.
pub(super) fn print_list(names: &NamesAndTypes, with_types: bool, only_count: bool) {
    if only_count {
        return println!("{}", names.len());
    }
    for (name, types) in names {
        match with_types {
            true => println!("{name} [{}]", joined(types)),
            false => println!("{name}"),
        }
    }
}

/// Prints the types once they are discovered; `None` if they are not.
pub(super) fn print_types(look: &Look, types: impl Fn(&Found) -> Option<BTreeSet<String>>) -> Option<()> {
    let found = look.found_with(|found| types(found).is_some());
    types(&found)?.iter().for_each(|name| println!("{name}"));
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_hidden_by_an_underscore() {
        for (name, topic, node) in [
            ("/a/b", false, false),
            ("/_a/b", true, false),
            ("/a/_action/status", true, false),
            ("/a/_ros2cli_1", true, true),
            ("/a_b", false, false),
        ] {
            assert_eq!((is_hidden(name), is_hidden_node(name)), (topic, node), "{name}");
        }
    }

    #[test]
    fn several_types_are_shown_as_a_python_list() {
        let types = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        assert_eq!(type_or_types(&types(&["a/msg/A"])), "a/msg/A");
        assert_eq!(type_or_types(&types(&["a/msg/A", "b/msg/B"])), "['a/msg/A', 'b/msg/B']");
    }
}
