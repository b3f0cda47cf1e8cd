//! Names of interfaces: `package/msg/Type`.

use std::fmt;
use std::str::FromStr;

use crate::Error;

/// What an interface is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// `action`: an action, or one of the services and messages made from it.
    Action,
    /// `msg`
    Message,
    /// `srv`: a service, or one of the messages made from it (`_Request`, `_Response`, `_Event`).
    Service,
}

impl Kind {
    /// All of them, in the order in which they can be read: messages first.
    pub const ALL: [Self; 3] = [Self::Message, Self::Service, Self::Action];

    /// The middle of the name, the name of the folder, and the extension of the file: `msg`, `srv` or `action`.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Action => "action",
            Self::Message => "msg",
            Self::Service => "srv",
        }
    }
}

/// The full name of an interface, as in `sensor_msgs/msg/JointState`. Orders as its text does.
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
    /// A name of its parts.
    #[must_use]
    pub fn new(package: &str, kind: Kind, name: &str) -> Self {
        Self { package: package.into(), kind, name: name.into() }
    }

    /// The name without its middle, as definition texts write it: `sensor_msgs/JointState`.
    #[must_use]
    pub fn short(&self) -> String {
        format!("{}/{}", self.package, self.name)
    }

    /// A name of its parts, if they are names.
    pub(crate) fn checked(package: &str, kind: Kind, name: &str) -> Option<Self> {
        let (stem, part) = name.split_once('_').map_or((name, None), |(stem, part)| (stem, Some(part)));
        let is_name = is_package_name(package)
            && is_type_name(stem)
            && part.is_none_or(|part| kind_of_part(part) == Some(kind));
        is_name.then(|| Self::new(package, kind, name))
    }

    /// The name that [`short`](TypeName::short) shortens. A message's own name has no underscore, so one that has is a part of a
    /// service or an action.
    pub(crate) fn from_short(package: &str, name: &str) -> Option<Self> {
        let kind = match name.split_once('_') {
            None => Kind::Message,
            Some((_, part)) => kind_of_part(part)?,
        };
        Self::checked(package, kind, name)
    }

    /// The same name with `suffix` added, for the parts of a service or an action.
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

impl FromStr for TypeName {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let mut parts = text.split('/');
        let (package, kind, name) = (parts.next(), parts.next(), parts.next());
        let Some(kind) = Kind::ALL.into_iter().find(|of| kind == Some(of.as_str())) else {
            return Err(Error::Name(text.into()));
        };
        let name = match (package, name, parts.next()) {
            (Some(package), Some(name), None) => Self::checked(package, kind, name),
            _ => None,
        };
        name.ok_or_else(|| Error::Name(text.into()))
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

/// Letters, digits and underscores, a letter first: as IDL and ROS 1 have it.
pub(crate) fn is_identifier(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_alphabetic())
        && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
}

/// What has parts that rosidl names so, behind an underscore.
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
    fn a_name_is_read_and_written_the_same() {
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
    fn what_is_no_name_is_refused() {
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
