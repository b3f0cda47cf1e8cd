//! What can be wrong with interface definitions.

use std::fmt;
use std::path::PathBuf;

use crate::TypeName;

/// A place in a definition: file, line, column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The file, or whatever names the text if it came from elsewhere.
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
    /// A line is not what the grammar of interface files allows.
    #[error("{place}: {message}")]
    Syntax {
        /// Where.
        place: Place,
        /// What was found, what was expected.
        message: String,
    },
    /// A `.srv` or `.action` file does not have the separator lines it needs.
    #[error("{place}: {what} with {expected} between them, found {found}")]
    Separators {
        /// The separator that is too many, or the end of the file where one is missing.
        place: Place,
        /// What needs them.
        what: &'static str,
        /// How many are needed, in words.
        expected: &'static str,
        /// How many such lines there are.
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
        /// What to do, where that can be told; empty otherwise.
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
    /// Messages contain messages that contain messages, and so on, for longer than any program has to follow.
    #[error("{place}: {name} is nested deeper than {bound} messages")]
    TooDeep {
        /// The field that goes too deep.
        place: Box<Place>,
        /// The message with the field.
        name: Box<TypeName>,
        /// How deep is allowed.
        bound: usize,
    },
    /// A message cannot be sent even when all its sequences are empty: its arrays are too large.
    #[error("{place}: {name} takes at least {size} bytes, and no more than {} can be sent", u32::MAX)]
    TooLarge {
        /// The field that is too much.
        place: Box<Place>,
        /// The message with the field.
        name: Box<TypeName>,
        /// The bytes of its fields up to this one.
        size: u64,
    },
    /// The same type is defined twice, with different meaning.
    #[error("{second}: {name} is already defined, differently, in {first}")]
    DefinedTwice {
        /// The type.
        name: TypeName,
        /// Where it was defined first.
        first: String,
        /// Where it was defined again.
        second: String,
    },
    /// A type was asked for that no definition describes.
    #[error("{name} is not in the catalog{hint}")]
    NotInCatalog {
        /// The type.
        name: Box<TypeName>,
        /// What to do, where that can be told.
        hint: String,
    },
    /// A text is not the name of an interface.
    #[error(
        "`{0}` is not an interface name: expected `package/msg/Type`, `package/srv/Type` or `package/action/Type`"
    )]
    Name(String),
    /// A service or an action was given the name of something else.
    #[error(
        "{origin}: {name} cannot be the name of what is defined here: expected `package/{expected}/Type`"
    )]
    Kind {
        /// The file.
        origin: String,
        /// The name.
        name: Box<TypeName>,
        /// The middle it should have.
        expected: &'static str,
    },
    /// A type description does not describe what ROS 2 can have.
    #[error("{origin}: the description of `{type_name}`{} {message}", field.as_ref().map(|field| format!(", field `{field}`,")).unwrap_or_default())]
    Description {
        /// What names the description.
        origin: String,
        /// The type within it.
        type_name: String,
        /// The field at fault, if it is one.
        field: Option<String>,
        /// What is wrong.
        message: String,
    },
    /// A definition text is in a language that is not understood.
    #[error("definition texts in `{0}` are not understood, only those in `ros2msg` and `ros2idl`")]
    Encoding(String),
    /// A file or folder could not be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

fn join(cycle: &[TypeName]) -> String {
    cycle.iter().map(TypeName::to_string).collect::<Vec<_>>().join(" -> ")
}
