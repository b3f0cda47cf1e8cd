//! One of the two runs, in a bag.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use downbeat_bags::{Reader, TopicDescription, TopicId, WriterOptions};
use downbeat_msgs::encoding::Encoding;
use downbeat_robot::encoding::topic_info;
use downbeat_robot::replay::{ReplaySession, Standing};

/// A run that was recorded.
pub(super) struct Side {
    bag: PathBuf,
    pub(super) start_ns: i64,
    pub(super) cycles: u64,
    pub(super) topics: BTreeMap<String, OfTopic>,
    /// Modules that published together on a topic in a cycle.
    publishers: Vec<Vec<String>>,
}

/// A topic of a run.
pub(super) struct OfTopic {
    id: TopicId,
    pub(super) info: TopicDescription,
    /// The cycle of each message, and who published in it, as a number.
    origins: Vec<(u64, usize)>,
}

impl Side {
    /// Runs a session to its end, and records all of its messages into a new bag.
    pub(super) fn record(mut session: ReplaySession, bag: &Path) -> anyhow::Result<Self> {
        let mut writer = WriterOptions::new().create(bag)?;
        let mut side = Self {
            bag: bag.to_owned(),
            start_ns: session.about().start.as_nanos(),
            cycles: 0,
            topics: BTreeMap::new(),
            publishers: Vec::new(),
        };
        while session.step()? {
            side.cycles += 1;
            let standing = session.standing();
            for message in &standing.messages {
                let name = format!("/{}", message.topic);
                if !side.topics.contains_key(&name) {
                    let (info, _) =
                        topic_info(name.clone(), message.message_type(), Vec::new(), Encoding::Cdr)?;
                    let id = writer.add_topic(info.clone())?;
                    side.topics.insert(name.clone(), OfTopic { id, info, origins: Vec::new() });
                }
                let publishers = side.publishers_in(standing, &message.topic);
                let Some(topic) = side.topics.get_mut(&name) else { continue };
                topic.origins.push((standing.cycle, publishers));
                let time = message.time.as_nanos();
                writer.write(topic.id, time, time, message.cdr())?;
            }
        }
        writer.finish()?;
        Ok(side)
    }

    fn publishers_in(&mut self, standing: &Standing, topic: &str) -> usize {
        let published = standing.runs.iter().filter(|run| run.published.iter().any(|of| *of.topic == *topic));
        let names: Vec<String> = published.map(|run| run.module.to_string()).collect();
        self.publishers.iter().position(|known| *known == names).unwrap_or_else(|| {
            self.publishers.push(names);
            self.publishers.len() - 1
        })
    }

    /// The cycle of a message, and the modules that published on its topic in it.
    pub(super) fn origin(&self, topic: &str, number: usize) -> Option<(u64, &[String])> {
        let (cycle, publishers) = self.topics.get(topic)?.origins.get(number)?;
        Some((*cycle, self.publishers.get(*publishers)?))
    }

    /// The bag of the run.
    pub(super) fn reader(&self) -> anyhow::Result<Reader> {
        Ok(Reader::open(&self.bag)?)
    }
}
