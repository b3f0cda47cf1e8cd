//! What can be wrong.

use downbeat_msgs_definitions::{Error as DefinitionError, TypeName};

use crate::cdr;

/// Why a definition could not be made a type.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TypeError {
    /// The definition, or one it refers to, is missing or wrong.
    #[error(transparent)]
    Definition(#[from] DefinitionError),
    /// Messages are nested without measure.
    #[error("{name} contains messages that contain messages, more than {limit} levels deep")]
    TooDeep {
        /// The type.
        name: TypeName,
        /// The greatest depth allowed.
        limit: usize,
    },
    /// There are fields without measure.
    #[error("{name} has more than {limit} fields, those of messages within it counted")]
    TooManyFields {
        /// The type.
        name: TypeName,
        /// The greatest number allowed.
        limit: usize,
    },
    /// Fixed arrays without measure.
    #[error(
        "{name} takes more than {limit} bytes of memory whatever its value: its fixed arrays are too long"
    )]
    TooLarge {
        /// The type.
        name: TypeName,
        /// The greatest size allowed.
        limit: u64,
    },
    /// A default value does not fit its field.
    #[error("cannot use a default value: {0}")]
    Default(Box<FieldError>),
    /// A type description does not have the hash that was announced.
    #[error(
        "the type description of {name} has the hash {found}, but {expected} was announced: it describes another type"
    )]
    Hash {
        /// The type.
        name: String,
        /// The one announced.
        expected: String,
        /// The one it has.
        found: String,
    },
}

/// Why a field could not be read or changed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{type_name}{}: {problem}", of_field(path))]
pub struct FieldError {
    /// The type of the message.
    pub type_name: String,
    /// The field, as in `points[3].x`.
    pub path: String,
    /// What is wrong.
    pub problem: FieldProblem,
}

/// What is wrong with a field, or with a value for it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FieldProblem {
    /// The text is no path.
    #[error("this is no path: expected {expected} at byte {at}, as in `points[3].x`")]
    Path {
        /// Counted from 0.
        at: usize,
        /// What should be there.
        expected: &'static str,
    },
    /// No such field.
    #[error("{message} has no field `{wanted}`{hint}")]
    NoField {
        /// The message that was looked into.
        message: String,
        /// The field that was looked for.
        wanted: String,
        /// The nearest name, or all names, as the end of a sentence.
        hint: String,
    },
    /// What has no fields was asked for one.
    #[error("cannot look for `{wanted}` in {found}, which has no fields")]
    NoFields {
        /// The field that was looked for.
        wanted: String,
        /// What is there.
        found: String,
    },
    /// What has no elements was asked for one.
    #[error("cannot take element {index} of {found}, which has no elements")]
    NoElements {
        /// The element.
        index: usize,
        /// What is there.
        found: String,
    },
    /// There are not as many elements.
    #[error("there is no element {index}, there are {length}, counted from 0")]
    Index {
        /// The element.
        index: usize,
        /// How many there are.
        length: usize,
    },
    /// The value is of another kind.
    #[error("takes {expected}, found {found}")]
    Kind {
        /// What the field holds.
        expected: String,
        /// What was given.
        found: String,
    },
    /// The number is too small or too great.
    #[error("takes {expected}, which cannot hold {found}")]
    Range {
        /// The type of the number.
        expected: String,
        /// What was given.
        found: String,
    },
    /// A string exceeds its bound.
    #[error("takes a string of at most {bound} bytes (wide strings: 16-bit units), found {found}")]
    TextBound {
        /// The bound.
        bound: u64,
        /// The length given.
        found: usize,
    },
    /// A sequence exceeds its bound.
    #[error("takes at most {bound} elements, found {found}")]
    Bound {
        /// The bound.
        bound: u64,
        /// The number given.
        found: usize,
    },
    /// An array is given another number of elements.
    #[error("takes exactly {expected} elements, found {found}")]
    Length {
        /// The number it has.
        expected: u64,
        /// The number given.
        found: usize,
    },
    /// The elements take more memory than can be justified.
    #[error("the elements take more than {limit} bytes of memory together")]
    Memory {
        /// The most allowed.
        limit: u64,
    },
}

impl FieldProblem {
    pub(super) fn of(self, type_name: &TypeName, path: &str) -> FieldError {
        FieldError { type_name: type_name.to_string(), path: path.to_owned(), problem: self }
    }
}

/// Why a dynamic message could not be made a struct.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ConvertError {
    /// They are of different types.
    #[error("cannot convert between {dynamic} and {typed}")]
    Type {
        /// The type of the dynamic message.
        dynamic: String,
        /// The type of the struct.
        typed: &'static str,
    },
    /// They have the same name but different definitions.
    #[error("{name} is defined differently there: {problem}")]
    Cdr {
        /// The type of both.
        name: &'static str,
        /// Where the difference shows.
        problem: cdr::Error,
    },
}

fn of_field(path: &str) -> String {
    if path.is_empty() { String::new() } else { format!(", field `{path}`") }
}
