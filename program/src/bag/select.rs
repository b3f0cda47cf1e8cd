//! Selection of a bag's topics: the options of `ros2 bag play`.

use anyhow::{Context, bail};
use clap::Args;
use regex_lite::Regex;

use super::output::Progress;
use downbeat_bags::{BagMessage, Reader, RecordedTopic, Selection, TopicDescription, TopicId};
use downbeat_msgs::printable;
use downbeat_robot::table::DecodeError;

#[derive(Args, Clone, Default, PartialEq)]
pub(crate) struct TopicArguments {
    /// Only these topics.
    #[arg(long, num_args = 1.., value_name = "TOPIC")]
    pub(crate) topics: Vec<String>,
    /// Only topics of these types: sensor_msgs/msg/Imu.
    #[arg(long, num_args = 1.., value_name = "TYPE")]
    pub(crate) topic_types: Vec<String>,
    /// Only the events of these services.
    #[arg(long, num_args = 1.., value_name = "SERVICE")]
    pub(crate) services: Vec<String>,
    /// Only topics whose whole name matches this regular expression, in addition to named ones.
    #[arg(long, short = 'e', value_name = "REGEX")]
    pub(crate) regex: Option<String>,
    /// Exclude topics whose whole name matches this regular expression.
    #[arg(long, short = 'x', value_name = "REGEX")]
    pub(crate) exclude_regex: Option<String>,
    /// Exclude these topics.
    #[arg(long, num_args = 1.., value_name = "TOPIC")]
    pub(crate) exclude_topics: Vec<String>,
    /// Exclude topics of these types.
    #[arg(long, num_args = 1.., value_name = "TYPE")]
    pub(crate) exclude_topic_types: Vec<String>,
    /// Exclude these services.
    #[arg(long, num_args = 1.., value_name = "SERVICE")]
    pub(crate) exclude_services: Vec<String>,
}

/// Parsed [`TopicArguments`].
pub(crate) struct ChosenTopics {
    names: Vec<String>,
    types: Vec<String>,
    regex: Option<Regex>,
    excluded_names: Vec<String>,
    excluded_types: Vec<String>,
    excluded_regex: Option<Regex>,
}

impl TopicArguments {
    pub(crate) fn filter(&self) -> anyhow::Result<ChosenTopics> {
        Ok(ChosenTopics {
            names: names(&self.topics, &self.services),
            types: self.topic_types.clone(),
            regex: self.regex.as_deref().map(whole).transpose()?,
            excluded_names: names(&self.exclude_topics, &self.exclude_services),
            excluded_types: self.exclude_topic_types.clone(),
            excluded_regex: self.exclude_regex.as_deref().map(whole).transpose()?,
        })
    }

    /// Whether no topic was asked for, and none excluded.
    #[cfg(feature = "tables")]
    pub(crate) fn is_everything(&self) -> bool {
        *self == Self::default()
    }

    /// The absolute names of the topics that were asked for, and of the events of the services.
    pub(crate) fn names(&self) -> Vec<String> {
        names(&self.topics, &self.services)
    }

    /// Checks that every named topic exists: a wrong name would silently have no effect.
    pub(crate) fn check<'a>(
        &self,
        topics: impl Iterator<Item = &'a TopicDescription> + Clone,
    ) -> anyhow::Result<()> {
        for name in names(&self.topics, &self.services) {
            if !topics.clone().any(|topic| topic.name == name) {
                let known: Vec<_> = topics.map(|topic| printable(&topic.name)).collect();
                anyhow::bail!("the bag has no topic {name}; it has {}", known.join(", "));
            }
        }
        Ok(())
    }
}

impl ChosenTopics {
    pub(crate) fn is_wanted(&self, topic: &TopicDescription) -> bool {
        let TopicDescription { name, type_name, .. } = topic;
        let is_anything_named = !self.names.is_empty() || !self.types.is_empty() || self.regex.is_some();
        let is_named = self.names.contains(name)
            || self.types.contains(type_name)
            || self.regex.as_ref().is_some_and(|regex| regex.is_match(name));
        let is_excluded = self.excluded_names.contains(name)
            || self.excluded_types.contains(type_name)
            || self.excluded_regex.as_ref().is_some_and(|regex| regex.is_match(name));
        (is_named || !is_anything_named) && !is_excluded
    }
}

/// Absolute names of the topics, and of the event topics of services.
fn names(topics: &[String], services: &[String]) -> Vec<String> {
    let events = services.iter().map(|service| format!("{}/_service_event", absolute(service)));
    topics.iter().map(|topic| absolute(topic)).chain(events).collect()
}

/// The absolute name: the leading slash may be omitted on the command line.
pub(super) fn absolute(name: &str) -> String {
    format!("/{}", name.trim_start_matches('/'))
}

fn whole(regex: &str) -> anyhow::Result<Regex> {
    Regex::new(&format!("^(?:{regex})$")).with_context(|| format!("\"{regex}\" is not a regular expression"))
}

/// How many messages of a topic were seen.
#[derive(Default)]
pub(super) struct Tally {
    pub(super) readable: u64,
    pub(super) broken: usize,
}

impl Tally {
    /// Counts a message, and logs the first that is unreadable.
    pub(super) fn readable<T>(
        &mut self,
        topic: &RecordedTopic,
        decoded: Result<T, DecodeError>,
    ) -> Option<T> {
        let number = self.readable + self.broken as u64 + 1;
        match decoded {
            Ok(content) => {
                self.readable += 1;
                return Some(content);
            }
            Err(error) if self.broken == 0 => {
                tracing::warn!("{}: message {number}: {error}", printable(&topic.info.name));
            }
            Err(_) => {}
        }
        self.broken += 1;
        None
    }

    /// Logs how many were unreadable, if the first was not the only one.
    pub(super) fn warn(&self, topic: &RecordedTopic) {
        if self.broken > 1 {
            tracing::warn!("{}: {} messages cannot be read", printable(&topic.info.name), self.broken);
        }
    }
}

/// Calls a function with each message of the topics, reading the bag once. Parts of the bag that cannot be
/// read are logged; returns their number.
pub(super) fn each_message(
    bag: &Reader,
    topics: impl IntoIterator<Item = TopicId> + Clone,
    doing: &'static str,
    mut act: impl FnMut(BagMessage) -> anyhow::Result<()>,
) -> anyhow::Result<usize> {
    let total = topics.clone().into_iter().map(|id| bag.topics()[id.index()].message_count).sum();
    let mut progress = Progress::new(doing, total);
    let (mut seen, mut damaged) = (0, 0);
    for message in bag.messages(Selection::all().topics(topics))? {
        match message {
            Ok(message) => {
                seen += 1;
                progress.at(seen);
                act(message)?;
            }
            Err(error) => {
                tracing::warn!("{error}");
                damaged += 1;
            }
        }
    }
    Ok(damaged)
}

/// Fails if the metadata of a bag declares more messages than its files have. (It declares fewer in an
/// interrupted recording.)
fn has_declared_messages(bag: &Reader) -> anyhow::Result<()> {
    let (found, declared) =
        (bag.message_count(), bag.metadata().map_or(0, |metadata| metadata.message_count));
    if found < declared {
        bail!(
            "incomplete: the metadata of {} declares {declared} messages, its files have {found}",
            bag.path().display()
        );
    }
    Ok(())
}

/// Fails if parts of the bags were lost: missing or damaged parts of the files, and `unreadable` parts and
/// messages found by the command. Readable parts have been written before.
pub(super) fn carried_over(bags: &[Reader], unreadable: usize) -> anyhow::Result<()> {
    let is_lost = |bag: &&Reader| bag.truncation().any(|truncation| truncation.loses_messages());
    let damaged: Vec<_> = bags.iter().filter(is_lost).collect();
    let truncations = damaged.iter().flat_map(|bag| bag.truncation());
    let parts = truncations.filter(|truncation| truncation.loses_messages()).count() + unreadable;
    if parts == 0 {
        return bags.iter().try_for_each(has_declared_messages);
    }
    let shown = damaged.first().copied().or(bags.first()).map(|bag| bag.path().display().to_string());
    bail!(
        "incomplete: {parts} {} cannot be read; see above, and `downbeat bag check {1}`; `downbeat bag repair \
         {1}` creates a complete bag from what can be read",
        if parts == 1 { "part" } else { "parts" },
        shown.unwrap_or_default()
    )
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn wanted(arguments: &TopicArguments) -> Vec<&'static str> {
        let topics = [
            ("/imu/data", "sensor_msgs/msg/Imu"),
            ("/imu/raw", "sensor_msgs/msg/Imu"),
            ("/camera/image", "sensor_msgs/msg/Image"),
            ("/reset/_service_event", "std_srvs/srv/Empty_Event"),
        ];
        let filter = arguments.filter().unwrap();
        let info = |(name, type_name): (&str, &str)| TopicDescription {
            name: name.to_owned(),
            type_name: type_name.to_owned(),
            ..TopicDescription::default()
        };
        let wanted = topics.into_iter().filter(|topic| filter.is_wanted(&info(*topic)));
        wanted.map(|(name, _)| name).collect()
    }

    fn texts(texts: &[&str]) -> Vec<String> {
        texts.iter().map(|text| (*text).to_owned()).collect()
    }

    #[test]
    fn topics_are_selected_like_in_ros2_bag_play() {
        let all = TopicArguments::default();
        assert_eq!(wanted(&all).len(), 4);
        let named = TopicArguments { topics: texts(&["imu/data"]), ..all.clone() };
        assert_eq!(wanted(&named), ["/imu/data"]);
        let also = TopicArguments { regex: Some("/cam.*".into()), ..named.clone() };
        assert_eq!(wanted(&also), ["/imu/data", "/camera/image"]);
        let part = TopicArguments { regex: Some("cam".into()), ..all.clone() };
        assert!(wanted(&part).is_empty(), "the whole name must match");
        let types = TopicArguments {
            topic_types: texts(&["sensor_msgs/msg/Imu"]),
            exclude_topics: texts(&["/imu/raw"]),
            ..all.clone()
        };
        assert_eq!(wanted(&types), ["/imu/data"]);
        let without = TopicArguments {
            exclude_regex: Some("/imu/.*".into()),
            exclude_services: texts(&["reset"]),
            ..all.clone()
        };
        assert_eq!(wanted(&without), ["/camera/image"]);
        let services = TopicArguments { services: texts(&["/reset"]), ..all };
        assert_eq!(wanted(&services), ["/reset/_service_event"]);
    }
}
