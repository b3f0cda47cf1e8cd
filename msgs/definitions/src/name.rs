//! Names of interfaces: `package/msg/Type`.

use std::fmt;
use std::str::FromStr;

use crate::Error;

/// What an interface is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// `msg`
    Message,
    /// `srv`: a service, or one of the messages made from it (`_Request`, `_Response`, `_Event`).
    Service,
}

impl Kind {
    /// The middle of the name, and the name of the folder: `msg` or `srv`.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
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
    /// Message or service.
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

    /// The same name with `suffix` added, for the messages of a service.
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
        let kind = match kind {
            Some("msg") => Kind::Message,
            Some("srv") => Kind::Service,
            _ => return Err(Error::Name(text.into())),
        };
        match (package, name, parts.next()) {
            (Some(package), Some(name), None) if is_package_name(package) && is_identifier(name) => {
                Ok(Self::new(package, kind, name))
            }
            _ => Err(Error::Name(text.into())),
        }
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

/// A type name that may have the suffix of a service's messages.
fn is_identifier(text: &str) -> bool {
    let stem = ["_Request", "_Response", "_Event"].iter().find_map(|suffix| text.strip_suffix(suffix));
    is_type_name(stem.unwrap_or(text))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::TypeName;

    #[test]
    fn a_name_is_read_and_written_the_same() {
        for text in ["sensor_msgs/msg/JointState", "std_srvs/srv/SetBool_Request"] {
            assert_eq!(text.parse::<TypeName>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn what_is_no_name_is_refused() {
        for text in
            ["", "String", "std_msgs/String", "std_msgs/msg/", "a/msg/B/c", "Std/msg/B", "a/idl/B", "a/msg/b"]
        {
            assert!(text.parse::<TypeName>().is_err(), "{text}");
        }
    }
}
