//! Names of interfaces: `package/msg/Type`.

use std::fmt;

/// The kind of an interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// `action`: an action, or one of the services and messages derived from it.
    Action,
    /// `msg`
    Message,
    /// `srv`: a service, or one of the messages derived from it (`_Request`, `_Response`, `_Event`).
    Service,
}

impl Kind {
    /// All kinds, in an order in which they can be read: messages first.
    pub const ALL: [Self; 3] = [Self::Message, Self::Service, Self::Action];

    /// `msg`, `srv` or `action`: the middle part of names, the name of the folder, and the file extension.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Action => "action",
            Self::Message => "msg",
            Self::Service => "srv",
        }
    }
}

/// The full name of an interface, as in `sensor_msgs/msg/JointState`. Ordered like its text.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TypeName {
    /// The package: `sensor_msgs`.
    pub package: String,
    /// Message, service or action.
    pub kind: Kind,
    /// The type within the package: `JointState`.
    pub name: String,
}

impl TypeName {
    /// Creates a name from its parts.
    #[must_use]
    pub fn new(package: &str, kind: Kind, name: &str) -> Self {
        Self { package: package.into(), kind, name: name.into() }
    }

    /// The name without its middle part, as in definition texts: `sensor_msgs/JointState`.
    #[must_use]
    pub fn short(&self) -> String {
        format!("{}/{}", self.package, self.name)
    }

    /// The name in portable definition texts: [`short`](Self::short) for a message, else the full one.
    pub(crate) fn in_texts(&self) -> String {
        if self.kind == Kind::Message { self.short() } else { self.to_string() }
    }

    /// Creates a name from its parts, if they are valid.
    pub(crate) fn checked(package: &str, kind: Kind, name: &str) -> Option<Self> {
        let (stem, part) = name.split_once('_').map_or((name, None), |(stem, part)| (stem, Some(part)));
        let is_name = is_package_name(package)
            && is_type_name(stem)
            && part.is_none_or(|part| kind_of_part(part) == Some(kind));
        is_name.then(|| Self::new(package, kind, name))
    }

    /// The inverse of [`short`](TypeName::short). Names of messages have no underscore, so a name with one is
    /// a part of a service or an action.
    pub(crate) fn from_short(package: &str, name: &str) -> Option<Self> {
        let kind = match name.split_once('_') {
            None => Kind::Message,
            Some((_, part)) => kind_of_part(part)?,
        };
        Self::checked(package, kind, name)
    }

    /// Appends `suffix` to the name, for the parts of a service or an action.
    #[must_use]
    pub fn with_suffix(&self, suffix: &str) -> Self {
        Self { name: format!("{}{suffix}", self.name), ..self.clone() }
    }
}

impl fmt::Display for TypeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.package, self.kind.as_str(), self.name)
    }
}

/// Lower case, digits and single underscores, a letter first, no underscore last: packages and fields.
pub(crate) fn is_package_name(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_lowercase())
        && text.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
        && !text.contains("__")
        && !text.ends_with('_')
}

/// Letters and digits, a capital first: types.
pub(crate) fn is_type_name(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_uppercase()) && text.chars().all(|c| c.is_ascii_alphanumeric())
}

/// Upper case, digits and single underscores, a letter first, no underscore last: constants.
pub(crate) fn is_constant_name(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_uppercase())
        && text.chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_')
        && !text.contains("__")
        && !text.ends_with('_')
}

/// Letters, digits and underscores, a letter first, as in IDL and ROS 1.
pub(crate) fn is_identifier(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_alphabetic())
        && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

/// The kind of interface that has a part with this suffix.
fn kind_of_part(part: &str) -> Option<Kind> {
    match part {
        "Request" | "Response" | "Event" => Some(Kind::Service),
        "Goal" | "Result" | "Feedback" | "FeedbackMessage" | "SendGoal" | "GetResult" => Some(Kind::Action),
        _ => {
            let (service, part) = part.split_once('_')?;
            let is_part =
                matches!(service, "SendGoal" | "GetResult") && kind_of_part(part) == Some(Kind::Service);
            is_part.then_some(Kind::Action)
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::TypeName;

    #[test]
    fn a_name_is_written_as_it_was_read() {
        for text in [
            "sensor_msgs/msg/JointState",
            "std_srvs/srv/SetBool_Request",
            "test_msgs/action/Fibonacci",
            "test_msgs/action/Fibonacci_SendGoal_Event",
        ] {
            assert_eq!(text.parse::<TypeName>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn invalid_names_are_refused() {
        for text in [
            "",
            "String",
            "std_msgs/String",
            "std_msgs/msg/",
            "a/msg/B/c",
            "Std/msg/B",
            "a/idl/B",
            "a/msg/b",
            "a/msg/B_C",
        ] {
            assert!(text.parse::<TypeName>().is_err(), "{text}");
        }
    }
}
