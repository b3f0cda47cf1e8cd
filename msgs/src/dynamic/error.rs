//! Errors of dynamic messages.

use downbeat_msgs_definitions::{Error as DefinitionError, TypeName};

use crate::cdr;

/// Why a definition could not be compiled to a type.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TypeError {
    /// The definition, or one it refers to, is missing or invalid.
    #[error(transparent)]
    Definition(#[from] DefinitionError),
    /// Messages are nested too deeply.
    #[error("{name} contains messages nested more than {limit} levels deep")]
    TooDeep {
        /// The type.
        name: TypeName,
        /// The maximum depth.
        limit: usize,
    },
    /// There are too many fields.
    #[error("{name} has more than {limit} fields, including those of nested messages")]
    TooManyFields {
        /// The type.
        name: TypeName,
        /// The maximum number.
        limit: usize,
    },
    /// Fixed arrays are too large.
    #[error("{name} always takes more than {limit} bytes of memory: its fixed arrays are too long")]
    TooLarge {
        /// The type.
        name: TypeName,
        /// The maximum size.
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
        /// The announced hash.
        expected: String,
        /// The actual hash.
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
    /// The problem.
    pub problem: FieldProblem,
}

/// The problem with a field, or with a value for it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FieldProblem {
    /// The text is not a path.
    #[error("invalid path: expected {expected} at byte {at}, as in `points[3].x`")]
    Path {
        /// Counted from 0.
        at: usize,
        /// The expected part.
        expected: &'static str,
    },
    /// There is no such field.
    #[error("{message} has no field `{wanted}`{hint}")]
    NoField {
        /// The type of the message.
        message: String,
        /// The requested field.
        wanted: String,
        /// The nearest name, or all names, as the end of a sentence.
        hint: String,
    },
    /// A field of a value without fields was requested.
    #[error("cannot look for `{wanted}` in {found}, which has no fields")]
    NoFields {
        /// The requested field.
        wanted: String,
        /// A description of the value.
        found: String,
    },
    /// An element of a value without elements was requested.
    #[error("cannot take element {index} of {found}, which has no elements")]
    NoElements {
        /// The element.
        index: usize,
        /// A description of the value.
        found: String,
    },
    /// The index is out of range.
    #[error("there is no element {index}, there are {length}, counted from 0")]
    Index {
        /// The element.
        index: usize,
        /// The number of elements.
        length: usize,
    },
    /// The value is of another kind.
    #[error("takes {expected}, found {found}")]
    Kind {
        /// The kind that the field holds.
        expected: String,
        /// The given value.
        found: String,
    },
    /// A key without a value, or with `null`.
    #[error("is empty: give it a value, or leave it out")]
    Empty,
    /// The number is too small or too great.
    #[error("takes {expected}, which cannot hold {found}")]
    Range {
        /// The type of the number.
        expected: String,
        /// The given value.
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
    /// The number of elements does not match the array.
    #[error("takes exactly {expected} elements, found {found}")]
    Length {
        /// The number it has.
        expected: u64,
        /// The number given.
        found: usize,
    },
    /// The elements take too much memory.
    #[error("the elements take more than {limit} bytes of memory together")]
    Memory {
        /// The maximum in bytes.
        limit: u64,
    },
}

impl FieldProblem {
    pub(super) fn of(self, type_name: &TypeName, path: &str) -> FieldError {
        FieldError { type_name: type_name.to_string(), path: path.to_owned(), problem: self }
    }
}

/// Why a dynamic message could not be converted to or from a struct.
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
    #[error("{name} has a different definition there: {problem}")]
    Cdr {
        /// The type of both.
        name: &'static str,
        /// The first difference.
        problem: cdr::Error,
    },
}

fn of_field(path: &str) -> String {
    if path.is_empty() { String::new() } else { format!(", field `{path}`") }
}
