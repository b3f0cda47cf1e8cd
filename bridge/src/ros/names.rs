//! Names of nodes, topics and types: valid once they exist, and as they stand on the wire.
//!
//! The rules are those of `rmw_validate_node_name`, `rmw_validate_namespace`, `rcl_validate_topic_name` and
//! `rcl_expand_topic_name` (branch jazzy), the wire form that of
//! `rmw_fastrtps_shared_cpp/namespace_prefix.hpp`.

use crate::middleware::NodeIdentity;
use std::fmt;
use thiserror::Error;

/// `rmw/validate_node_name.h`.
const NODE_NAME_LENGTH: usize = 255;
/// `rmw/validate_namespace.h`.
const NAMESPACE_LENGTH: usize = 245;
/// `rmw/validate_full_topic_name.h`: 255 less the prefix and suffix of services on the wire.
const TOPIC_LENGTH: usize = 247;

/// A name that ROS 2 does not accept.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{kind} {name:?} is not valid: {reason}")]
pub struct NameError {
    kind: &'static str,
    name: String,
    reason: String,
}

/// The namespace and name of a node, such as `/robot/downbeat`.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct NodeName {
    namespace: String,
    name: String,
}

impl NodeName {
    /// A node in a namespace. As in rclcpp an empty namespace means `/`, and a missing first slash is added.
    ///
    /// # Errors
    /// [`NameError`] when ROS 2 does not accept the name or the namespace.
    pub fn new(namespace: &str, name: &str) -> Result<Self, NameError> {
        let refuse = refuse("node name", name);
        if name.is_empty() {
            return Err(refuse("it is empty".to_owned()));
        }
        check_token(name).map_err(refuse)?;
        check_length("node name", name, NODE_NAME_LENGTH)?;

        let namespace = match namespace {
            "" => "/".to_owned(),
            absolute if absolute.starts_with('/') => absolute.to_owned(),
            relative => format!("/{relative}"),
        };
        if namespace != "/" {
            check_path("namespace", &namespace)?;
        }
        check_length("namespace", &namespace, NAMESPACE_LENGTH)?;
        Ok(Self { namespace, name: name.to_owned() })
    }

    /// The namespace: `/`, or a path that begins with a slash and does not end with one.
    #[must_use]
    pub fn namespace(&self) -> &str {
        &self.namespace
    }

    /// The name without the namespace.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The same for the middleware.
    pub(super) fn identity(&self) -> NodeIdentity {
        NodeIdentity { namespace: self.namespace.clone(), name: self.name.clone() }
    }

    fn in_namespace(&self, relative: &str) -> String {
        format!("{}/{relative}", self.namespace.trim_end_matches('/'))
    }
}

impl fmt::Display for NodeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.in_namespace(&self.name))
    }
}

/// The absolute name of a topic, such as `/joint_states`.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TopicName(String);

impl TopicName {
    /// The topic that a node means by `name`: `/joint_states` unchanged, `joint_states` in the node's
    /// namespace, `~/joint_states` below the node's own name. `{node}`, `{ns}` and `{namespace}` stand for
    /// the node's.
    ///
    /// # Errors
    /// [`NameError`] when ROS 2 does not accept the name.
    pub fn expand(name: &str, node: &NodeName) -> Result<Self, NameError> {
        let refuse =
            |reason: &str| NameError { kind: "topic name", name: name.to_owned(), reason: reason.to_owned() };
        if name.is_empty() {
            return Err(refuse("it is empty"));
        }
        let substituted = name
            .replace("{node}", node.name())
            .replace("{ns}", node.namespace())
            .replace("{namespace}", node.namespace());
        let absolute = if let Some(private) = substituted.strip_prefix('~') {
            match private {
                "" => node.to_string(),
                _ if private.starts_with('/') => format!("{node}{private}"),
                _ => return Err(refuse("'~' must stand alone or be followed by '/'")),
            }
        } else if substituted.starts_with('/') {
            substituted
        } else {
            node.in_namespace(&substituted)
        };
        if absolute.contains('~') {
            return Err(refuse("'~' may only be its first character"));
        }
        check_path("topic name", &absolute).map_err(|error| NameError { name: name.to_owned(), ..error })?;
        check_length("topic name", &absolute, TOPIC_LENGTH)?;
        Ok(Self(absolute))
    }

    /// The topic behind a name on the wire, if it is that of a ROS 2 topic.
    #[must_use]
    pub fn from_wire(name: &str) -> Option<Self> {
        name.strip_prefix("rt").and_then(Self::absolute)
    }

    /// A name that is absolute already, if ROS 2 accepts it. Others may have announced any text.
    pub(super) fn absolute(name: &str) -> Option<Self> {
        let is_absolute = name.starts_with('/') && name.len() <= TOPIC_LENGTH;
        let checked = is_absolute.then(|| check_path("topic name", name))?;
        checked.ok().map(|()| Self(name.to_owned()))
    }

    /// The absolute name.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The name on the wire: `rt/joint_states`.
    #[must_use]
    pub fn to_wire(&self) -> String {
        format!("rt{}", self.0)
    }
}

impl fmt::Display for TopicName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// The name of a message type, such as `sensor_msgs/msg/JointState`.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct MessageType(String);

impl MessageType {
    /// A type as ROS 2 writes it: package, kind (`msg`, `srv` or `action`) and name.
    ///
    /// # Errors
    /// [`NameError`] when the three parts are not there.
    pub fn new(name: &str) -> Result<Self, NameError> {
        let refuse = refuse("message type", name);
        let parts: Vec<_> = name.split('/').collect();
        match parts[..] {
            [package, "msg" | "srv" | "action", message] if !package.is_empty() && !message.is_empty() => {
                check_token(package).and_then(|()| check_token(message)).map_err(refuse)?;
                Ok(Self(name.to_owned()))
            }
            _ => Err(refuse("expected a form like \"sensor_msgs/msg/JointState\"".to_owned())),
        }
    }

    /// The type behind a name on the wire, if it is that of a ROS 2 message.
    #[must_use]
    pub fn from_wire(name: &str) -> Option<Self> {
        let (path, message) = name.strip_suffix('_')?.split_once("::dds_::")?;
        Self::new(&format!("{}/{message}", path.replace("::", "/"))).ok()
    }

    /// The name as ROS 2 writes it.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The name on the wire: `sensor_msgs::msg::dds_::JointState_`.
    #[must_use]
    pub fn to_wire(&self) -> String {
        match self.0.rsplit_once('/') {
            Some((path, message)) => format!("{}::dds_::{message}_", path.replace('/', "::")),
            None => self.0.clone(),
        }
    }
}

impl fmt::Display for MessageType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

fn refuse(kind: &'static str, name: &str) -> impl Fn(String) -> NameError {
    let name = name.to_owned();
    move |reason| NameError { kind, name: name.clone(), reason }
}

/// A path of tokens that begins with a slash.
fn check_path(kind: &'static str, path: &str) -> Result<(), NameError> {
    let refuse = refuse(kind, path);
    if path.contains("//") {
        return Err(refuse("it has two slashes in a row".to_owned()));
    }
    if path.ends_with('/') {
        return Err(refuse("it ends with a slash".to_owned()));
    }
    path.split('/').skip(1).try_for_each(check_token).map_err(refuse)
}

fn check_token(token: &str) -> Result<(), String> {
    if let Some(wrong) = token.chars().find(|c| !(c.is_ascii_alphanumeric() || *c == '_')) {
        return Err(format!("{wrong:?} is not allowed, only letters, digits and '_'"));
    }
    if token.starts_with(|c: char| c.is_ascii_digit()) {
        return Err(format!("{token:?} begins with a digit"));
    }
    Ok(())
}

fn check_length(kind: &'static str, name: &str, limit: usize) -> Result<(), NameError> {
    if name.len() <= limit {
        return Ok(());
    }
    Err(refuse(kind, name)(format!("it has {} characters, {limit} are allowed", name.len())))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn node() -> NodeName {
        NodeName::new("/robot", "downbeat").unwrap()
    }

    fn expanded(name: &str) -> Result<String, String> {
        TopicName::expand(name, &node()).map(|topic| topic.to_string()).map_err(|error| error.to_string())
    }

    #[test]
    fn topics_expand_as_in_ros() {
        assert_eq!(expanded("/joint_states").unwrap(), "/joint_states");
        assert_eq!(expanded("joint_states").unwrap(), "/robot/joint_states");
        assert_eq!(expanded("imu/data_raw").unwrap(), "/robot/imu/data_raw");
        assert_eq!(expanded("~/state").unwrap(), "/robot/downbeat/state");
        assert_eq!(expanded("~").unwrap(), "/robot/downbeat");
        assert_eq!(expanded("/{node}/x").unwrap(), "/downbeat/x");
        let root = NodeName::new("/", "downbeat").unwrap();
        assert_eq!(TopicName::expand("joint_states", &root).unwrap().as_str(), "/joint_states");
        assert_eq!(TopicName::expand("~/state", &root).unwrap().as_str(), "/downbeat/state");
    }

    #[test]
    fn a_wrong_topic_is_refused_with_the_reason() {
        for (wrong, reason) in [
            ("", "empty"),
            ("/", "ends with a slash"),
            ("joint states", "' ' is not allowed"),
            ("a//b", "two slashes"),
            ("a/", "ends with a slash"),
            ("/a/1b", "begins with a digit"),
            ("a~/b", "first character"),
            ("~a", "followed by '/'"),
            ("{robot}/x", "'{' is not allowed"),
            ("a-b", "'-' is not allowed"),
        ] {
            let error = expanded(wrong).unwrap_err();
            assert!(error.contains(reason) && error.contains(&format!("{wrong:?}")), "{wrong:?}: {error}");
        }
        assert!(expanded(&"a".repeat(248)).is_err());
    }

    #[test]
    fn a_namespace_gets_its_first_slash() {
        assert_eq!(NodeName::new("", "a").unwrap().to_string(), "/a");
        assert_eq!(NodeName::new("/", "a").unwrap().to_string(), "/a");
        assert_eq!(NodeName::new("robot/left", "a").unwrap().to_string(), "/robot/left/a");
        for wrong in ["/robot/", "/a//b", "/2nd", "/a b"] {
            assert!(NodeName::new(wrong, "a").is_err(), "{wrong}");
        }
        for wrong in ["", "a/b", "2nd", "a-b", "~"] {
            assert!(NodeName::new("/", wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn types_and_topics_survive_the_wire() {
        let joint_state = MessageType::new("sensor_msgs/msg/JointState").unwrap();
        assert_eq!(joint_state.to_wire(), "sensor_msgs::msg::dds_::JointState_");
        assert_eq!(MessageType::from_wire(&joint_state.to_wire()), Some(joint_state));
        let topic = TopicName::expand("/joint_states", &node()).unwrap();
        assert_eq!(topic.to_wire(), "rt/joint_states");
        assert_eq!(TopicName::from_wire("rt/joint_states"), Some(topic));
        assert_eq!(TopicName::from_wire("ros_discovery_info"), None);
        for wrong in [
            "rt",
            "rtchatter",
            "rt\x1b[2J",
            "rt\n/chatter",
            "rt/chat\x07ter",
            "rt/a\u{202e}b",
            "rt/\u{9b}31m",
        ] {
            assert_eq!(TopicName::from_wire(wrong), None, "{wrong:?}");
        }
        assert_eq!(TopicName::from_wire(&format!("rt/{}", "x".repeat(TOPIC_LENGTH))), None);
        assert_eq!(MessageType::from_wire("HelloWorld"), None);
        for wrong in ["sensor_msgs/JointState", "JointState", "sensor_msgs/msg/", "a/b/c/d", "a b/msg/C"] {
            assert!(MessageType::new(wrong).is_err(), "{wrong}");
        }
    }
}
