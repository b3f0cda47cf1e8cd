//! From the entries of `[expose]` to exposures of topics of a core.

use std::collections::BTreeSet;
use std::time::Duration;

use downbeat_bridge::expose::{BridgeStatus, ExposedEndpoint, Exposure, QOS_EVENTS_TOPIC, TopicPattern};
use downbeat_bridge::middleware::Direction;
use downbeat_bridge::ros::{NameError, NodeName, TopicName};
use downbeat_edge::{Interfaces, KnownType};
use downbeat_executor::{CoreHandle, TopicInfo};
use downbeat_files::toml::Error as FileError;

use super::catalog::unregistered;
use super::file::{ExposeEntry, RobotFile, RobotFileError, TopicChoice, suggestion};
use super::survey::Survey;
use crate::journal;

type Result<T> = std::result::Result<T, RobotFileError>;

/// Topics that every node of ROS 2 has under the same name, whatever its namespace: `diagnostic_updater` and
/// `tf2_ros` make them absolute.
const ABSOLUTE: [&str; 3] = ["diagnostics", "tf", "tf_static"];

/// The name of a topic of the core in ROS 2, before it is expanded and remapped.
fn ros_name(topic: &str) -> String {
    if ABSOLUTE.contains(&topic) { format!("/{topic}") } else { topic.to_owned() }
}

/// How long a running core may take to list its topics.
const PATIENCE: Duration = Duration::from_secs(5);

impl RobotFile {
    /// The robot's node in ROS 2 before remapping rules apply.
    ///
    /// # Errors
    /// If ROS 2 does not accept its name or namespace.
    pub fn given_node_name(&self) -> Result<NodeName> {
        NodeName::new(&self.namespace, &self.node).map_err(|error| self.source.error(1, error.to_string()))
    }

    /// The robot's node in ROS 2.
    ///
    /// # Errors
    /// If ROS 2 does not accept its name or namespace, or those that remapping rules put in their place.
    pub fn node_name(&self) -> Result<NodeName> {
        self.remapped(&self.given_node_name()?)
    }

    /// The exposures of these topics; those named `taken` are exposed already. Patterns match the topics
    /// that carry ROS messages, go their way, and are not named or matched before; never those of the
    /// executor.
    ///
    /// # Errors
    /// If a topic is not there, nobody publishes what is to go out, the type is another, or a pattern matches
    /// nothing; with path and line.
    pub(crate) fn exposures_of(
        &self,
        entries: &[ExposeEntry],
        topics: &[TopicInfo],
        taken: &[String],
    ) -> Result<Vec<Exposure>> {
        self.exposures_among(entries, &Survey::of_topics(topics), taken)
    }

    /// The exposures of the topics of a core.
    pub(super) fn exposures_among(
        &self,
        entries: &[ExposeEntry],
        survey: &Survey,
        taken: &[String],
    ) -> Result<Vec<Exposure>> {
        let topics = survey.topics.as_slice();
        let mut selection =
            Selection { file: self, survey, topics, claimed: claimed(entries), found: Vec::new() };
        for direction in [Direction::Out, Direction::In] {
            let taken = taken.iter().map(|name| (None, direction, canonical(name).to_owned()));
            selection.claimed.extend(taken);
        }
        for entry in entries {
            survey.admit(selection.select(entry))?;
        }
        let Selection { found, .. } = selection;
        survey.admit(self.refuse_the_same_name_twice(&found))?;
        survey.admit(self.refuse_unmeant_relays(&found))?;
        Ok(found.into_iter().map(|(_, exposure)| exposure).collect())
    }

    /// The topics that a pattern of the file matches and does not expose, since they carry no registered
    /// message: a sentence for each.
    pub(super) fn passed_over(&self, topics: &[TopicInfo]) -> Vec<String> {
        let mut sentences = Vec::new();
        for entry in self.expose.topics.iter().filter(|entry| entry.type_name.is_none()) {
            let TopicChoice::Pattern { pattern, except } = &entry.topics else { continue };
            let is_told = |topic: &&TopicInfo| {
                self.is_passed_over(entry, pattern, topic)
                    && !except.iter().any(|(_, excepted)| excepted.matches(&topic.name))
            };
            for TopicInfo { name, message_type, .. } in topics.iter().filter(is_told) {
                let problem = unregistered(message_type, "ROS message");
                sentences.push(format!(
                    "\"{pattern}\" does not expose \"{name}\": it carries {message_type}, {problem}"
                ));
            }
        }
        sentences
    }

    fn is_passed_over(&self, entry: &ExposeEntry, pattern: &TopicPattern, topic: &TopicInfo) -> bool {
        pattern.matches(&topic.name)
            && can_be_meant(entry, topic)
            && self.catalog.interfaces.message_in(topic).is_none()
    }

    /// The endpoints of these exposures, with all names as remapping rules make them.
    ///
    /// # Errors
    /// If ROS 2 does not accept a name.
    pub fn exposed(&self, exposures: &[Exposure]) -> Result<Vec<ExposedEndpoint>> {
        exposures.iter().map(|exposure| self.exposed_endpoint(exposure, 1)).collect()
    }

    /// Reads the keys `out` and `in` of `[expose]`, to expose more of a running robot. Patterns do not match
    /// what is exposed already.
    ///
    /// # Errors
    /// If the text is not valid, its topics cannot be exposed, or the core does not answer.
    pub fn exposures_while_running(
        &self,
        text: &str,
        core: &CoreHandle,
        status: &BridgeStatus,
    ) -> Result<Vec<Exposure>> {
        let entries = Self::parse_entries(text, &self.catalog.interfaces, self.expose.features.engine)?;
        let topics = core.topics().wait(PATIENCE).ok_or_else(|| {
            self.source
                .error(1, "the core does not answer: it has stopped or is held, or a module does not return")
        })?;
        let endpoints = status.endpoints().into_iter().map(|report| report.endpoint);
        let taken: Vec<_> =
            endpoints.filter(|endpoint| endpoint.network.is_none()).map(|endpoint| endpoint.topic).collect();
        // The lines are those of this text, not of the robot file.
        self.exposures_of(&entries, &topics, &taken).map_err(|error| match error {
            RobotFileError::File(FileError::Line { line, problem, .. }) => {
                FileError::Line { path: "expose".into(), line, problem }.into()
            }
            other => other,
        })
    }

    fn refuse_the_same_name_twice(&self, found: &[(usize, Exposure)]) -> Result<()> {
        // The node is exposed even if no topic is.
        self.node_name()?;
        let mut names = BTreeSet::new();
        for (line, exposure) in found {
            let ExposedEndpoint { direction, ros_topic, node, network, .. } =
                self.exposed_endpoint(exposure, *line)?;
            if !names.insert((direction, ros_topic.clone(), node, network)) {
                return Err(self.source.error(*line, format!("{ros_topic} is exposed twice")));
            }
        }
        Ok(())
    }

    /// What comes in from one network goes out to another only if the file says so.
    fn refuse_unmeant_relays(&self, found: &[(usize, Exposure)]) -> Result<()> {
        for (line, out) in found.iter().filter(|(_, exposure)| !exposure.relays) {
            if let Some((_, other)) = found.iter().find(|(_, other)| out.relays_from(other)) {
                let problem = format!(
                    "\"{}\" comes in from {} and would go out to {}: add relay = true here if that is meant",
                    out.topic,
                    network_name(other.network.as_deref()),
                    network_name(out.network.as_deref())
                );
                return Err(self.source.error(*line, problem));
            }
        }
        Ok(())
    }

    fn exposed_endpoint(&self, exposure: &Exposure, line: usize) -> Result<ExposedEndpoint> {
        let refuse = |error: NameError| self.source.error(line, error.to_string());
        let given = exposure.node.clone().map_or_else(|| self.given_node_name(), Ok)?;
        let node = self.remapped(&given)?;
        let topic = TopicName::expand(exposure.ros_topic(), &node).map_err(refuse)?;
        let topic = self.remaps.topic(topic, &node).map_err(refuse)?;
        Ok(ExposedEndpoint::new(exposure, &node, &topic, exposure.qos))
    }

    fn remapped(&self, node: &NodeName) -> Result<NodeName> {
        self.remaps
            .node(node)
            .map_err(|error| self.source.error(1, format!("remapping the node {node}: {error}")))
    }

    /// A node beside the robot's: absolute, or relative to the robot's namespace.
    pub(super) fn node_beside(&self, name: &str, line: usize) -> Result<NodeName> {
        let (namespace, name) = match name.rsplit_once('/') {
            None => (self.namespace.clone(), name),
            Some((namespace, name)) if name.is_empty() || namespace.starts_with('/') => {
                (namespace.to_owned(), name)
            }
            Some(("", name)) => ("/".to_owned(), name),
            Some((namespace, name)) => {
                (format!("{}/{namespace}", self.namespace.trim_end_matches('/')), name)
            }
        };
        NodeName::new(&namespace, name).map_err(|error| self.source.error(line, error.to_string()))
    }
}

/// A topic in a network.
type Claim = (Option<String>, Direction, String);

/// The topics that are named, by network and direction: patterns leave them alone.
fn claimed(entries: &[ExposeEntry]) -> BTreeSet<Claim> {
    let named = entries.iter().filter_map(|entry| match &entry.topics {
        TopicChoice::Name(name) => Some((entry.network.clone(), entry.direction, canonical(name).to_owned())),
        TopicChoice::Pattern { .. } => None,
    });
    named.collect()
}

struct Selection<'a> {
    file: &'a RobotFile,
    survey: &'a Survey,
    topics: &'a [TopicInfo],
    claimed: BTreeSet<Claim>,
    found: Vec<(usize, Exposure)>,
}

impl<'a> Selection<'a> {
    fn interfaces(&self) -> &'a Interfaces {
        &self.file.catalog.interfaces
    }

    /// A topic that a pattern may mean, with its type.
    fn candidate(&self, entry: &ExposeEntry, topic: &'a TopicInfo) -> Option<(&'a TopicInfo, KnownType)> {
        let message_type = self.interfaces().message_in(topic)?;
        let has_type = entry.type_name.as_deref().is_none_or(|name| name == message_type.name());
        // Also what this pattern has exposed already: the file is read again for recordings and viewers.
        let is_exposed = entry.direction == Direction::In && self.survey.comes_from_outside(topic);
        (has_type && (can_be_meant(entry, topic) || is_exposed)).then_some((topic, message_type))
    }

    fn select(&mut self, entry: &ExposeEntry) -> Result<()> {
        match &entry.topics {
            TopicChoice::Name(name) => self.select_named(entry, name),
            TopicChoice::Pattern { pattern, except } => self.select_matching(entry, pattern, except),
        }
    }

    fn select_named(&mut self, entry: &ExposeEntry, name: &str) -> Result<()> {
        let refuse = |problem: String| Err(self.file.source.error(entry.line, problem));
        if entry.is_raw {
            return self.select_raw(entry, canonical(name));
        }
        let topic = self.file.topic(self.topics, name, entry.line, "expose")?;
        let is_relayed = entry.relays && self.comes_in(canonical(name));
        if entry.direction == Direction::Out && !topic.is_published && !is_relayed {
            return refuse(format!("no module publishes \"{}\"; does it belong under \"in\"?", topic.name));
        }
        let Some(message_type) = self.interfaces().message_in(topic) else {
            let (name, carried) = (&topic.name, topic.message_type);
            return refuse(format!("\"{name}\" carries {carried}, {}", unregistered(carried, "ROS message")));
        };
        let actual = message_type.name();
        if let Some(said) = entry.type_name.as_deref().filter(|said| *said != actual) {
            return refuse(format!("\"{}\" is of type \"{actual}\", not \"{said}\"", topic.name));
        }
        let ros_topic = entry.ros_topic.clone().unwrap_or_else(|| ros_name(name));
        let exposure = self.exposure(entry, &topic.name, message_type, ros_topic)?;
        self.found.push((entry.line, exposure));
        Ok(())
    }

    /// Whether a topic that is named comes in from a network.
    fn comes_in(&self, name: &str) -> bool {
        self.claimed.iter().any(|(_, direction, topic)| *direction == Direction::In && topic == name)
    }

    /// A topic of bytes, which no module need have: what comes in may go out again under another name, or
    /// into a bag.
    fn select_raw(&mut self, entry: &ExposeEntry, name: &str) -> Result<()> {
        let refuse = |problem: String| self.file.source.error(entry.line, problem);
        let type_name = entry.type_name.as_deref().unwrap_or_default();
        let message_type = KnownType::raw(type_name, &self.interfaces().definitions())
            .map_err(|error| refuse(error.to_string()))?;
        let topic = self.topics.iter().find(|topic| *topic.name == *name);
        if let Some(topic) = topic.filter(|topic| topic.message_type_id != message_type.rust_type()) {
            let carried = topic.message_type;
            let problem = match self.interfaces().message_in(topic) {
                Some(_) => "; only what modules take or give as bytes can be raw".to_owned(),
                None => format!(", {}", unregistered(carried, "ROS message")),
            };
            return Err(refuse(format!("\"{name}\" carries {carried}{problem}")));
        }
        let comes_in = self.comes_in(name);
        if entry.direction == Direction::Out && !comes_in && !topic.is_some_and(|topic| topic.is_published) {
            return Err(refuse(format!("no module publishes \"{name}\", and it is not under \"in\" either")));
        }
        let ros_topic = entry.ros_topic.clone().unwrap_or_else(|| ros_name(name));
        let exposure = self.exposure(entry, name, message_type, ros_topic)?;
        self.found.push((entry.line, exposure));
        Ok(())
    }

    fn select_matching(
        &mut self,
        entry: &ExposeEntry,
        pattern: &TopicPattern,
        except: &[(usize, TopicPattern)],
    ) -> Result<()> {
        let candidates: Vec<_> =
            self.topics.iter().filter_map(|topic| self.candidate(entry, topic)).collect();
        let matching: Vec<_> = candidates.iter().filter(|(topic, _)| pattern.matches(&topic.name)).collect();
        let names = || candidates.iter().map(|(topic, _)| &*topic.name);
        let refuse = |line, problem: String| Err(self.file.source.error(line, problem));
        if matching.is_empty() {
            let of_type =
                entry.type_name.as_deref().map(|name| format!(" of type \"{name}\"")).unwrap_or_default();
            let (hint, way) = (suggestion(&pattern.to_string(), names()), way(entry.direction));
            return refuse(entry.line, format!("\"{pattern}\" matches no topic{of_type} {way}{hint}"));
        }
        for (line, excepted) in except {
            // Topics that are skipped for their type too, so that no message is printed for them.
            let is_meant = |topic: &TopicInfo| {
                excepted.matches(&topic.name) && self.file.is_passed_over(entry, pattern, topic)
            };
            if !matching.iter().any(|(topic, _)| excepted.matches(&topic.name))
                && !self.topics.iter().any(is_meant)
            {
                let matched = matching.iter().map(|(topic, _)| &*topic.name);
                let hint = suggestion(&excepted.to_string(), matched);
                let problem = format!("\"{excepted}\" is none of what \"{pattern}\" matches{hint}");
                self.survey.admit(refuse(*line, problem))?;
            }
        }
        let is_excepted = |topic: &TopicInfo| except.iter().any(|(_, pattern)| pattern.matches(&topic.name));
        let mut exposures = Vec::new();
        for &&(topic, message_type) in matching.iter().filter(|(topic, _)| !is_excepted(topic)) {
            if self.claimed.insert((entry.network.clone(), entry.direction, topic.name.to_string())) {
                let renamed = entry.ros_topic.as_ref().and_then(|to| pattern.rename(&topic.name, to));
                let ros_topic = renamed.unwrap_or_else(|| ros_name(&topic.name));
                exposures.push((entry.line, self.exposure(entry, &topic.name, message_type, ros_topic)?));
            }
        }
        self.found.extend(exposures);
        Ok(())
    }

    fn exposure(
        &self,
        entry: &ExposeEntry,
        topic: &str,
        message_type: KnownType,
        ros_topic: String,
    ) -> Result<Exposure> {
        let node = entry.node.as_deref().map(|name| self.file.node_beside(name, entry.line)).transpose()?;
        Ok(Exposure {
            topic: topic.to_owned(),
            ros_topic: Some(ros_topic),
            message_type,
            direction: entry.direction,
            qos: entry.qos,
            limits: entry.limits,
            send: entry.send,
            node,
            network: entry.network.clone(),
            relays: entry.relays,
        })
    }
}

/// Whether a pattern may match a topic, by its name and direction.
fn can_be_meant(entry: &ExposeEntry, topic: &TopicInfo) -> bool {
    let is_internal = topic.name.starts_with("executor/")
        || journal::TOPICS.contains(&&*topic.name)
        || *topic.name == *QOS_EVENTS_TOPIC
        // An action is exposed as a whole.
        || topic.name.contains("/_action/");
    !is_internal && topic.is_published == (entry.direction == Direction::Out)
}

fn way(direction: Direction) -> &'static str {
    match direction {
        Direction::Out => "that a module publishes",
        Direction::In => "that modules receive and none publishes",
    }
}

pub(super) fn network_name(network: Option<&str>) -> String {
    network.map_or_else(|| "the robot's own network".to_owned(), |name| format!("network \"{name}\""))
}

pub(super) fn canonical(name: &str) -> &str {
    name.strip_prefix('/').unwrap_or(name)
}

#[cfg(test)]
mod tests;
