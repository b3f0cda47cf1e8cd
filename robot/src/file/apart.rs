//! A robot file that includes several robots, taken apart: what one of them is alone, and what is left.

use std::collections::BTreeMap;

use downbeat_executor::SettingValue;

use super::expose::{ExposeEntry, ExposeSection, TopicChoice};
use super::module::ModuleEntry;
use super::view::ViewEntry;
use super::{Given, NodeFeatures, Place, ReplaySection, RobotFile, RobotFileError};

impl RobotFile {
    /// Only the robot of the `[[include]]` with this namespace, with a node of this name in that namespace.
    /// Modules and topics keep their names. Of `[expose]` and `[record]` it keeps what is about its topics.
    pub fn only(mut self, namespace: &str, node: &str) -> Self {
        let is_its = |name: &String| is_within(name, namespace);
        self.modules.retain(|module| is_its(&module.name));
        self.expose.topics.retain(|entry| is_its(&entry.topics.to_string()));
        for entry in &mut self.expose.topics {
            entry.name_absolutely();
        }
        let features = NodeFeatures { engine: self.expose.features.engine, ..NodeFeatures::default() };
        let topics = std::mem::take(&mut self.expose.topics);
        self.expose = ExposeSection { topics, features, ..ExposeSection::default() };
        if let Some(topics) = &mut self.record.topics {
            topics.retain(is_its);
        }
        self.record.topics = self.record.topics.filter(|topics| !topics.is_empty());
        self.record.modules.retain(is_its);
        self.namespace = format!("{}/{namespace}", self.namespace.trim_end_matches('/'));
        self.has_namespace = true;
        (self.name, self.node) = (namespace.to_owned(), node.to_owned());
        (self.replay, self.view) = (ReplaySection::default(), ViewEntry::default());
        self
    }

    /// Removes the robot of the `[[include]]` with this namespace, and what the file says of its topics.
    /// Returns its modules.
    pub fn take_out(&mut self, namespace: &str) -> Vec<ModuleEntry> {
        let is_other = |name: &String| !is_within(name, namespace);
        self.expose.topics.retain(|entry| is_other(&entry.topics.to_string()));
        if let Some(topics) = &mut self.record.topics {
            topics.retain(is_other);
        }
        self.record.modules.retain(is_other);
        let modules = std::mem::take(&mut self.modules);
        let (taken, rest) = modules.into_iter().partition(|module| is_within(&module.name, namespace));
        self.modules = rest;
        taken
    }

    /// Gives these settings to the first module of a kind, or adds one, in this namespace.
    ///
    /// # Errors
    /// If the catalog lacks the kind.
    pub fn furnish<const N: usize>(
        &mut self,
        kind: &str,
        namespace: &str,
        settings: [(&str, SettingValue); N],
    ) -> Result<(), RobotFileError> {
        let position = self.modules.iter().position(|module| module.kind.name() == kind);
        let position = match position {
            Some(position) => position,
            None => {
                let missing =
                    || self.source.error(1, format!("this program has no kind of module \"{kind}\""));
                let known = self.catalog.kind(kind).ok_or_else(missing)?;
                self.modules.push(ModuleEntry::of_program(known.clone(), namespace));
                self.modules.len() - 1
            }
        };
        let given = |value| Given { place: Place::Line(1), value, is_wildcard: false };
        let settings: BTreeMap<_, _> =
            settings.into_iter().map(|(name, value)| (name.to_owned(), given(value))).collect();
        self.modules[position].settings.extend(settings);
        Ok(())
    }
}

impl ExposeEntry {
    /// Has the same names in ROS 2 whatever the namespace of the node is.
    fn name_absolutely(&mut self) {
        let own = match &self.topics {
            TopicChoice::Name(name) => name.clone(),
            TopicChoice::Pattern { pattern, .. } => pattern.to_string(),
        };
        let name = self.ros_topic.get_or_insert(own);
        if !name.starts_with(['/', '~']) {
            name.insert(0, '/');
        }
    }
}

/// Whether a name or a pattern begins with a namespace.
fn is_within(name: &str, namespace: &str) -> bool {
    let name = name.strip_prefix('/').unwrap_or(name);
    name.strip_prefix(namespace).is_some_and(|rest| rest.starts_with('/'))
}
