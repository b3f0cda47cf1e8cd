//! Errors in interface definitions.

use std::fmt;
use std::path::PathBuf;

use crate::TypeName;

/// A position in a definition: file, line, column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The file, or another name of the text.
    pub origin: String,
    /// Counted from 1.
    pub line: usize,
    /// Counted from 1, in characters.
    pub column: usize,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}", self.origin, self.line, self.column)
    }
}

/// Why definitions could not be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A line does not follow the grammar of interface files.
    #[error("{place}: {message}")]
    Syntax {
        /// The position of the error.
        place: Place,
        /// What was found, what was expected.
        message: String,
    },
    /// A `.srv` or `.action` file does not have the separator lines it needs.
    #[error("{place}: {what} with {expected} between them, found {found}")]
    Separators {
        /// The superfluous separator, or the end of the file if one is missing.
        place: Place,
        /// The definition that needs them.
        what: &'static str,
        /// How many are needed, in words.
        expected: &'static str,
        /// The number of such lines found.
        found: usize,
    },
    /// A field has a type that no definition describes.
    #[error("{place}: field `{field}` of {owner} has the unknown type `{wanted}`{hint}")]
    UnknownType {
        /// Where the field is declared.
        place: Box<Place>,
        /// The message with the field.
        owner: Box<TypeName>,
        /// The field.
        field: String,
        /// Its type.
        wanted: Box<TypeName>,
        /// A suggestion, or empty.
        hint: String,
    },
    /// A message contains itself, directly or through others.
    #[error("{place}: {} contains itself: {}", cycle[0], join(cycle))]
    Cycle {
        /// The field that leads back to the first message.
        place: Box<Place>,
        /// The messages on the way from the first to itself.
        cycle: Vec<TypeName>,
    },
    /// Messages are nested too deeply.
    #[error("{place}: {name} is nested deeper than {bound} messages")]
    TooDeep {
        /// The field that goes too deep.
        place: Box<Place>,
        /// The message with the field.
        name: Box<TypeName>,
        /// The maximum depth.
        bound: usize,
    },
    /// A message cannot be sent even when all its sequences are empty: its arrays are too large.
    #[error("{place}: {name} takes at least {size} bytes, and no more than {} can be sent", u32::MAX)]
    TooLarge {
        /// The field that exceeds the limit.
        place: Box<Place>,
        /// The message with the field.
        name: Box<TypeName>,
        /// The bytes of its fields up to this one.
        size: u64,
    },
    /// A type has two different definitions.
    #[error("{second}: {name} is already defined, differently, in {first}")]
    DefinedTwice {
        /// The type.
        name: TypeName,
        /// Where it was defined first.
        first: String,
        /// Where it was defined again.
        second: String,
    },
    /// A folder has two packages of one name.
    #[error(
        "there are two packages named {package}: {} and {}; rename or remove one of them", first.display(), second.display()
    )]
    TwoPackages {
        /// The name.
        package: String,
        /// Where it was found first.
        first: PathBuf,
        /// Where it was found again.
        second: PathBuf,
    },
    /// A folder has no interfaces.
    #[error(
        "{} has no interfaces: expected a package with a folder msg, srv or action, a folder of packages, or an ament prefix",
        .0.display()
    )]
    NoInterfaces(PathBuf),
    /// The requested type has no definition.
    #[error("{name} is not in the catalog{hint}")]
    NotInCatalog {
        /// The type.
        name: Box<TypeName>,
        /// A suggestion, or empty.
        hint: String,
    },
    /// A text is not the name of an interface.
    #[error(
        "`{0}` is not an interface name: expected `package/msg/Type`, `package/srv/Type` or `package/action/Type`"
    )]
    Name(String),
    /// The name does not fit the kind of the definition.
    #[error("{origin}: {name} cannot be the name of this definition: expected `package/{expected}/Type`")]
    Kind {
        /// The file.
        origin: String,
        /// The name.
        name: Box<TypeName>,
        /// The expected middle part of the name.
        expected: &'static str,
    },
    /// A type description describes something that ROS 2 does not support.
    #[error("{origin}: the description of `{type_name}`{} {message}", field.as_ref().map(|field| format!(", field `{field}`,")).unwrap_or_default())]
    Description {
        /// The source of the description.
        origin: String,
        /// The type within it.
        type_name: String,
        /// The invalid field, if any.
        field: Option<String>,
        /// The problem.
        message: String,
    },
    /// The language of a definition text is not supported.
    #[error("definition texts in `{0}` are not supported, only `ros2msg` and `ros2idl`")]
    Encoding(String),
    /// A file or folder could not be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

fn join(cycle: &[TypeName]) -> String {
    cycle.iter().map(TypeName::to_string).collect::<Vec<_>>().join(" -> ")
}
