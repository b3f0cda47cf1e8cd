//! Which topics are recorded: the rules of `rosbag2_transport/topic_filter.cpp`, branch jazzy.

use std::collections::BTreeSet;

use regex_lite::Regex;

/// Which topics to record.
///
/// ```
/// use downbeat_robot::ros_recorder::{SeenTopic, TopicFilter};
///
/// let filter = TopicFilter { all_topics: true, exclude_regex: Some("^/camera".parse()?), ..TopicFilter::default() };
/// let topic = |name| SeenTopic { name, type_name: "std_msgs/msg/String", has_publisher: true, has_subscription: false };
/// assert!(filter.takes(&topic("/chatter")));
/// assert!(!filter.takes(&topic("/camera/image")));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct TopicFilter {
    /// All topics but hidden ones: `--all-topics`.
    pub all_topics: bool,
    /// The events of all services: `--all-services`.
    pub all_services: bool,
    /// Topics by absolute name: `--topics`.
    pub topics: Vec<String>,
    /// Topics by type: `--topic-types`.
    pub topic_types: Vec<String>,
    /// Services by absolute name, whose events are recorded: `--services`.
    pub services: Vec<String>,
    /// Topics and services by what their name contains: `--regex`.
    pub regex: Option<Regex>,
    /// Not what contains this: `--exclude-regex`.
    pub exclude_regex: Option<Regex>,
    /// Not these topics: `--exclude-topics`.
    pub exclude_topics: Vec<String>,
    /// Not topics of these types: `--exclude-topic-types`.
    pub exclude_topic_types: Vec<String>,
    /// Not the events of these services: `--exclude-services`.
    pub exclude_services: Vec<String>,
    /// Hidden topics too, a part of whose name begins with `_`: `--include-hidden-topics`.
    pub includes_hidden: bool,
    /// Topics that nobody publishes too: `--include-unpublished-topics`.
    pub includes_unpublished: bool,
    /// Not topics to which nobody subscribes: `--ignore-leaf-topics`.
    pub ignores_leaves: bool,
}

/// A topic that there is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SeenTopic<'a> {
    /// Its absolute name.
    pub name: &'a str,
    /// Its type.
    pub type_name: &'a str,
    /// Whether somebody publishes it.
    pub has_publisher: bool,
    /// Whether somebody subscribes to it.
    pub has_subscription: bool,
}

impl TopicFilter {
    /// Whether the topic is recorded.
    #[must_use]
    pub fn takes(&self, topic: &SeenTopic<'_>) -> bool {
        let is_chosen = match service_of(topic) {
            Some(service) => self.takes_service(service),
            None => self.takes_name_and_type(topic.name, topic.type_name),
        };
        is_chosen
            && (topic.has_publisher || self.includes_unpublished)
            && (topic.has_subscription || !self.ignores_leaves)
    }

    /// Whether a topic that carries no events of a service is recorded, by its name and type alone.
    #[must_use]
    pub fn takes_name_and_type(&self, name: &str, type_name: &str) -> bool {
        let is_included = self.all_topics
            || contains(&self.topics, name)
            || contains(&self.topic_types, type_name)
            || self.regex.as_ref().is_some_and(|regex| regex.is_match(name));
        let is_excluded = contains(&self.exclude_topic_types, type_name)
            || contains(&self.exclude_topics, name)
            || self.exclude_regex.as_ref().is_some_and(|regex| regex.is_match(name));
        is_included && !is_excluded && (self.includes_hidden || !is_hidden(name))
    }

    /// Whether every topic that is asked for is among these: then there is nothing left to look for.
    #[must_use]
    pub fn is_complete_with(&self, recorded: &BTreeSet<&str>) -> bool {
        // As rosbag2, which counts; but names that are asked for twice do not keep it looking.
        let only_topics = !self.all_topics
            && !self.all_services
            && self.topic_types.is_empty()
            && self.services.is_empty()
            && self.regex.is_none();
        only_topics && self.topics.iter().all(|topic| recorded.contains(topic.as_str()))
    }

    fn takes_service(&self, service: &str) -> bool {
        let is_included = self.all_services
            || contains(&self.services, service)
            || self.regex.as_ref().is_some_and(|regex| regex.is_match(service));
        let is_excluded = contains(&self.exclude_services, service)
            || self.exclude_regex.as_ref().is_some_and(|regex| regex.is_match(service));
        is_included && !is_excluded
    }
}

/// The service whose events the topic carries.
fn service_of<'a>(topic: &SeenTopic<'a>) -> Option<&'a str> {
    let service = topic.name.strip_suffix("/_service_event").filter(|service| !service.is_empty())?;
    let is_event = topic.type_name.contains("/srv/") && topic.type_name.ends_with("_Event");
    is_event.then_some(service)
}

fn contains(names: &[String], name: &str) -> bool {
    names.iter().any(|known| known == name)
}

fn is_hidden(name: &str) -> bool {
    name.split('/').any(|part| part.starts_with('_'))
}

#[cfg(test)]
mod tests {
    use super::*;

    const STRING: &str = "std_msgs/msg/String";
    const EVENT: &str = "std_srvs/srv/SetBool_Event";

    fn takes(filter: &TopicFilter, name: &str, type_name: &str) -> bool {
        filter.takes(&SeenTopic { name, type_name, has_publisher: true, has_subscription: true })
    }

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    fn regex(text: &str) -> Option<Regex> {
        Regex::new(text).ok()
    }

    // The cases are those of rosbag2_transport/test/rosbag2_transport/test_topic_filter.cpp in spirit: what
    // is asked for in one way is not asked for in another.
    #[test]
    fn topics_are_chosen_by_name_type_and_regex() {
        let by_name = TopicFilter { topics: names(&["/a"]), ..TopicFilter::default() };
        assert!(takes(&by_name, "/a", STRING) && !takes(&by_name, "/ab", STRING));
        let by_type = TopicFilter { topic_types: names(&[STRING]), ..TopicFilter::default() };
        assert!(takes(&by_type, "/x", STRING) && !takes(&by_type, "/x", "std_msgs/msg/Bool"));
        let by_regex = TopicFilter { regex: regex("still_.*"), ..TopicFilter::default() };
        assert!(takes(&by_regex, "/still_nice_topic", STRING) && !takes(&by_regex, "/topic", STRING));
        assert!(!takes(&TopicFilter::default(), "/a", STRING));
    }

    #[test]
    fn what_is_excluded_stays_out_even_where_all_is_asked_for() {
        let filter = TopicFilter {
            all_topics: true,
            exclude_topics: names(&["/a"]),
            exclude_topic_types: names(&["std_msgs/msg/Bool"]),
            exclude_regex: regex("/inv.*"),
            ..TopicFilter::default()
        };
        assert!(takes(&filter, "/b", STRING));
        for (name, type_name) in [("/a", STRING), ("/b", "std_msgs/msg/Bool"), ("/invalid", STRING)] {
            assert!(!takes(&filter, name, type_name), "{name}");
        }
    }

    #[test]
    fn hidden_unpublished_and_leaf_topics_follow_their_options() {
        let all = TopicFilter { all_topics: true, ..TopicFilter::default() };
        assert!(!takes(&all, "/a/_hidden/b", STRING));
        assert!(takes(&TopicFilter { includes_hidden: true, ..all.clone() }, "/a/_hidden/b", STRING));
        let unpublished =
            SeenTopic { name: "/a", type_name: STRING, has_publisher: false, has_subscription: true };
        assert!(!all.takes(&unpublished));
        assert!(TopicFilter { includes_unpublished: true, ..all.clone() }.takes(&unpublished));
        let leaf = SeenTopic { has_publisher: true, has_subscription: false, ..unpublished };
        assert!(all.takes(&leaf));
        assert!(!TopicFilter { ignores_leaves: true, ..all }.takes(&leaf));
    }

    #[test]
    fn events_of_services_are_chosen_as_services() {
        let event = "/stand_up/_service_event";
        let all_topics = TopicFilter { all_topics: true, includes_hidden: true, ..TopicFilter::default() };
        assert!(!takes(&all_topics, event, EVENT), "no topic");
        let all_services = TopicFilter { all_services: true, ..TopicFilter::default() };
        assert!(takes(&all_services, event, EVENT) && !takes(&all_services, "/a", STRING));
        let by_name = TopicFilter { services: names(&["/stand_up"]), ..TopicFilter::default() };
        assert!(takes(&by_name, event, EVENT) && !takes(&by_name, "/sit/_service_event", EVENT));
        let excluded = TopicFilter { exclude_services: names(&["/stand_up"]), ..all_services };
        assert!(!takes(&excluded, event, EVENT));
        let by_regex = TopicFilter { regex: regex("^/stand"), ..TopicFilter::default() };
        assert!(takes(&by_regex, event, EVENT));
    }
}
