//! One of the two runs, in a bag.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::{Path, PathBuf};

use downbeat_bags::{Reader, TopicDescription, TopicId, Writer, WriterOptions};
use downbeat_msgs::encoding::Encoding;
use downbeat_robot::encoding::topic_info;
use downbeat_robot::replay::{ReplaySession, ShownMessage, Standing};

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
                if !session.is_published_detached(&message.topic) || is_published_inside(standing, message) {
                    let publishers = publishers_in(standing, &message.topic);
                    side.write(&mut writer, standing.cycle, message, publishers)?;
                }
            }
            for run in &standing.runs {
                for message in &run.replayed {
                    side.write(&mut writer, standing.cycle, message, vec![run.module.to_string()])?;
                }
            }
        }
        writer.finish()?;
        Ok(side)
    }

    fn write(
        &mut self,
        writer: &mut Writer,
        cycle: u64,
        message: &ShownMessage,
        publishers: Vec<String>,
    ) -> anyhow::Result<()> {
        let publishers = self.publishers.iter().position(|known| *known == publishers).unwrap_or_else(|| {
            self.publishers.push(publishers);
            self.publishers.len() - 1
        });
        let topic = match self.topics.entry(format!("/{}", message.topic)) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(new) => {
                let (info, _) =
                    topic_info(new.key().clone(), message.message_type(), Vec::new(), Encoding::Cdr)?;
                let id = writer.add_topic(info.clone())?;
                new.insert(OfTopic { id, info, origins: Vec::new() })
            }
        };
        topic.origins.push((cycle, publishers));
        let time = message.time.as_nanos();
        Ok(writer.write(topic.id, time, time, message.cdr())?)
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

/// The modules that published on a topic in a cycle.
fn publishers_in(standing: &Standing, topic: &str) -> Vec<String> {
    let published = standing.runs.iter().filter(|run| run.published.iter().any(|of| *of.topic == *topic));
    published.map(|run| run.module.to_string()).collect()
}

/// Whether a module inside the cycle published a message in this session.
fn is_published_inside(standing: &Standing, message: &ShownMessage) -> bool {
    let inside = standing.runs.iter().filter(|run| run.step.is_none());
    inside.flat_map(|run| &run.published).any(|of| {
        of.topic == message.topic && (of.first..of.first.saturating_add(of.count)).contains(&message.number)
    })
}
