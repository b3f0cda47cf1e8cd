//! Names that a user changes without changing the program: the remapping rules of ROS 2.
//!
//! # References
//! `rcl/src/rcl/remap.c` and `rcl_node_init` (branch jazzy).

mod lexer;
mod rule;

pub use rule::{Named, ParameterRule, Remap, RemapRule, RuleError};

use super::{NameError, NodeName, ServiceName, TopicName};
use std::sync::Arc;

/// Remapping rules in their order: of several that apply to a name, the first one does.
///
/// ```
/// use downbeat_bridge::ros::{NodeName, RemapRules, TopicName};
///
/// let rules = ["__ns:=/robot1", "chatter:=/news"].map(|rule| rule.parse());
/// let rules: RemapRules = rules.into_iter().collect::<Result<_, _>>()?;
/// let node = rules.node(&NodeName::new("/", "talker")?)?;
/// assert_eq!(node.to_string(), "/robot1/talker");
/// let topic = TopicName::expand("chatter", &node)?;
/// assert_eq!(rules.topic(topic, &node)?.as_str(), "/news");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RemapRules {
    rules: Arc<[RemapRule]>,
}

impl FromIterator<RemapRule> for RemapRules {
    fn from_iter<I: IntoIterator<Item = RemapRule>>(rules: I) -> Self {
        Self { rules: rules.into_iter().collect() }
    }
}

impl RemapRules {
    /// The rules, in their order.
    #[must_use]
    pub fn rules(&self) -> &[RemapRule] {
        &self.rules
    }

    /// The name of a node after remapping. A rule for one node refers to it by its original name where it
    /// changes the name, and by the new one in all other cases.
    ///
    /// # Errors
    /// [`NameError`] when ROS 2 does not accept the new name.
    pub fn node(&self, node: &NodeName) -> Result<NodeName, NameError> {
        let name = self.first(node.name(), |remap| match remap {
            Remap::Node(name) => Some(name.as_str()),
            _ => None,
        });
        let name = name.unwrap_or(node.name());
        let namespace = self.first(name, |remap| match remap {
            Remap::Namespace(namespace) => Some(namespace.as_str()),
            _ => None,
        });
        NodeName::new(namespace.unwrap_or(node.namespace()), name)
    }

    /// The topic that `node` means where it says `topic`.
    ///
    /// # Errors
    /// [`NameError`] when ROS 2 does not accept the new name.
    pub fn topic(&self, topic: TopicName, node: &NodeName) -> Result<TopicName, NameError> {
        self.name(topic, node, Named::Topic)
    }

    /// The service that `node` means where it says `service`.
    ///
    /// # Errors
    /// [`NameError`] when ROS 2 does not accept the new name.
    pub fn service(&self, service: ServiceName, node: &NodeName) -> Result<ServiceName, NameError> {
        self.name(service.0, node, Named::Service).map(ServiceName)
    }

    fn name(&self, name: TopicName, node: &NodeName, kind: Named) -> Result<TopicName, NameError> {
        let new_name = self.first(node.name(), |remap| match remap {
            Remap::Name { of, from, to } if *of == kind || *of == Named::Either => {
                // A name that does not expand matches nothing, as in rcl.
                TopicName::expand(from, node).is_ok_and(|from| from == name).then_some(to.as_str())
            }
            _ => None,
        });
        new_name.map_or(Ok(name), |new_name| TopicName::expand(new_name, node))
    }

    fn first<'a>(&'a self, node: &str, says: impl Fn(&'a Remap) -> Option<&'a str>) -> Option<&'a str> {
        let mut rules = self.rules.iter().filter(|rule| rule.node.as_deref().is_none_or(|only| only == node));
        rules.find_map(|rule| says(&rule.remap))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn rules(texts: &[&str]) -> RemapRules {
        texts.iter().map(|text| text.parse::<RemapRule>().unwrap()).collect()
    }

    fn node(rules: &RemapRules, namespace: &str, name: &str) -> String {
        rules.node(&NodeName::new(namespace, name).unwrap()).unwrap().to_string()
    }

    fn remapped(rules: &RemapRules, name: &str, node: (&str, &str)) -> (String, String) {
        let node = NodeName::new(node.0, node.1).unwrap();
        let name = TopicName::expand(name, &node).unwrap();
        let topic = rules.topic(name.clone(), &node).unwrap();
        (topic.to_string(), rules.service(ServiceName(name), &node).unwrap().to_string())
    }

    fn both(name: &str) -> (String, String) {
        (name.to_owned(), name.to_owned())
    }

    /// These four from `rcl/test/rcl/test_remap.cpp`.
    #[test]
    fn a_namespace_and_a_name_are_replaced_for_all_nodes_or_for_one() {
        assert_eq!(node(&rules(&["__ns:=/foo/bar"]), "/", "NodeName"), "/foo/bar/NodeName");
        let of_nodes = rules(&["Node1:__ns:=/foo/bar", "Node2:__ns:=/this_one", "Node3:__node:=other"]);
        assert_eq!(node(&of_nodes, "/", "Node1"), "/foo/bar/Node1");
        assert_eq!(node(&of_nodes, "/a", "Node2"), "/this_one/Node2");
        assert_eq!(node(&of_nodes, "/a", "Node3"), "/a/other");
        assert_eq!(node(&of_nodes, "/a", "Node4"), "/a/Node4");
        assert_eq!(node(&rules(&["/foobar:=/foo", "__node:=first", "__node:=second"]), "/", "N"), "/first");
    }

    #[test]
    fn topics_and_services_are_replaced_where_the_whole_name_is_the_same() {
        let global = rules(&["/bar/foo:=/foo/bar"]);
        assert_eq!(remapped(&global, "/bar/foo", ("/", "NodeName")), both("/foo/bar"));
        assert_eq!(remapped(&global, "/foo/bar", ("/", "NodeName")), both("/foo/bar"));
        assert_eq!(remapped(&global, "/foobar", ("/", "NodeName")), both("/foobar"));
        assert_eq!(remapped(&rules(&["foo:=bar"]), "foo", ("/ns", "NodeName")), both("/ns/bar"));
        assert_eq!(remapped(&rules(&["~/foo:=~/bar"]), "~/foo", ("/ns", "n")), both("/ns/n/bar"));
        let first = rules(&["a:=b", "a:=c", "b:=d"]);
        assert_eq!(remapped(&first, "a", ("/", "n")), both("/b"), "the first, and once");
    }

    #[test]
    fn a_rule_for_a_node_leaves_others_alone() {
        let of_nodes = rules(&["Node1:/foo:=/foo/bar", "Node2:/foo:=/this_one", "Node3:/foo:=/bar/foo"]);
        assert_eq!(remapped(&of_nodes, "/foo", ("/", "Node2")), both("/this_one"));
        assert_eq!(remapped(&of_nodes, "/foo", ("/", "Node4")), both("/foo"));
    }

    #[test]
    fn a_scheme_restricts_a_rule_to_topics_or_to_services() {
        let services = rules(&["rosservice://foo:=bar"]);
        assert_eq!(remapped(&services, "foo", ("/ns", "n")), ("/ns/foo".into(), "/ns/bar".into()));
        let topics = rules(&["rostopic://foo:=bar"]);
        assert_eq!(remapped(&topics, "foo", ("/ns", "n")), ("/ns/bar".into(), "/ns/foo".into()));
    }

    #[test]
    fn a_namespace_is_that_of_the_new_name_and_has_to_be_valid() {
        let renamed = rules(&["a:__node:=b", "b:__ns:=/for_b", "a:__ns:=/for_a"]);
        assert_eq!(node(&renamed, "/", "a"), "/for_b/b");
        let slash = rules(&["__ns:=/foo/"]);
        assert!(slash.node(&NodeName::new("/", "a").unwrap()).unwrap_err().to_string().contains("/foo/"));
    }
}
