//! The recorded topics of a robot.

use std::collections::BTreeSet;

use downbeat_bridge::expose::TopicPattern;
use downbeat_executor::TopicInfo;

use super::Robot;
use super::catalog::unregistered;
use super::expose::canonical;
use super::file::{RecordEntry, RobotFile, RobotFileError, suggestion};
use super::survey::Survey;
use crate::recorder;

type Result<T> = std::result::Result<T, RobotFileError>;

impl Robot {
    /// Returns the topics to record according to `[record]` in the file.
    ///
    /// # Errors
    /// Returns an error with path and line if a topic or a module does not exist, or the type of a named
    /// topic is not registered.
    pub fn recorded_topics(&self) -> Result<Vec<TopicInfo>> {
        self.topics_of(&self.file.record)
    }

    /// Returns the topics to record according to `entry`.
    ///
    /// # Errors
    /// Returns an error with path and line if a topic or a module does not exist, or the type of a named
    /// topic is not registered.
    pub fn topics_of(&self, entry: &RecordEntry) -> Result<Vec<TopicInfo>> {
        self.file.recorded_of(entry, &self.survey())
    }
}

impl RobotFile {
    /// The topics of a core to record according to `entry`.
    pub(crate) fn recorded_of(&self, entry: &RecordEntry, survey: &Survey) -> Result<Vec<TopicInfo>> {
        let known = &survey.topics;
        let mut chosen = match &entry.topics {
            None => known.clone(),
            Some(names) => {
                let mut chosen: Vec<TopicInfo> = Vec::new();
                for name in names {
                    let found: Vec<&TopicInfo> = if TopicPattern::is_pattern(name) {
                        known.iter().filter(|topic| matches(name, &topic.name)).collect()
                    } else {
                        let named = self.topic(known, name, entry.line, "record");
                        let named = named.and_then(|topic| self.recordable(topic, entry));
                        survey.admit(named)?.into_iter().collect()
                    };
                    for topic in found {
                        if chosen.iter().all(|other| other.name != topic.name) {
                            chosen.push(topic.clone());
                        }
                    }
                }
                chosen
            }
        };
        chosen.retain(|topic| !entry.except.iter().any(|pattern| matches(pattern, &topic.name)));
        if !entry.types.is_empty() {
            chosen.retain(|topic| {
                let known = self.catalog.interfaces.message_in(topic);
                known.is_some_and(|known| entry.types.iter().any(|name| name == known.name()))
            });
        }
        if !entry.modules.is_empty() {
            let published = self.published_by(entry, survey)?;
            chosen.retain(|topic| published.contains(&*topic.name));
        }
        if let Some(is_wanted) = entry.exposed {
            let exposed = self.exposures_among(&self.expose.topics, survey, &[])?;
            chosen.retain(|topic| exposed.iter().any(|exposure| *exposure.topic == *topic.name) == is_wanted);
        }
        Ok(chosen)
    }

    /// Checks that a named topic can be recorded.
    fn recordable<'a>(&self, topic: &'a TopicInfo, entry: &RecordEntry) -> Result<&'a TopicInfo> {
        if recorder::is_recordable(topic, &self.catalog.interfaces) {
            return Ok(topic);
        }
        let (name, carried) = (&topic.name, topic.message_type);
        let problem = unregistered(carried, "ROS message");
        Err(self.source.error(entry.line, format!("\"{name}\" carries {carried}, {problem}")))
    }

    /// Returns the topics that the named modules publish.
    fn published_by(&self, entry: &RecordEntry, survey: &Survey) -> Result<BTreeSet<String>> {
        let mut published = BTreeSet::new();
        for name in &entry.modules {
            if !survey.modules.contains(name) {
                let hint = suggestion(name, survey.modules.iter().map(String::as_str));
                let problem = format!("there is no module \"{name}\" to record{hint}");
                survey.admit(Err::<(), _>(self.source.error(entry.line, problem)))?;
            }
            published.extend(survey.topics_published_by(name));
        }
        Ok(published)
    }
}

fn matches(pattern: &str, topic: &str) -> bool {
    TopicPattern::new(canonical(pattern)).is_ok_and(|pattern| pattern.matches(topic))
}
