//! The common part of all serialisations except CDR: a message is a [`Value`] of named and numbered fields,
//! described by a [`Schema`]. Each format reads and writes values by their schema and does not depend on ROS
//! 2; [`cdr`] converts between values and messages.
//!
//! ```text
//!  message ◄── cdr ──► Value + Schema of its definition ◄──► JSON, CBOR, Protobuf, FlatBuffers
//!     ▲                                                            ▲
//!     └─── foxglove ─► Value + Foxglove's schema ◄─────────────────┘
//! ```

// Each format uses a part of it.
#![cfg_attr(
    not(all(feature = "json", feature = "cbor", feature = "protobuf", feature = "flatbuffers")),
    allow(dead_code, unused_imports)
)]

mod budget;
pub(crate) mod cdr;
mod kind;
mod missing;
mod schema;
#[cfg(any(feature = "json", feature = "cbor"))]
pub(crate) mod tree;
mod value;

use std::fmt;

pub(crate) use budget::Budget;
pub(crate) use downbeat_msgs_definitions::Shape;
pub(crate) use kind::Kind;
pub(crate) use schema::{Enumeration, Field, Record, Schema};
pub(crate) use value::Value;

/// A message or a type cannot be converted.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The definition is invalid.
    #[error(transparent)]
    Definition(#[from] downbeat_msgs_definitions::Error),
    /// The bytes to convert are not CDR of the type.
    #[error("{type_name}: {source}")]
    Cdr {
        /// The expected type.
        type_name: String,
        /// The problem.
        source: crate::cdr::Error,
    },
    /// A value or its bytes cannot be converted.
    #[error("{type_name}: cannot {direction} {format}{}{}: {problem}", at(*offset), in_field(path))]
    Convert {
        /// The type.
        type_name: String,
        /// Whether the format was being read or written.
        direction: CodecDirection,
        /// The format: `protobuf`, `json`, …
        format: &'static str,
        /// The offset in the bytes, if they were being read and the format has offsets.
        offset: Option<usize>,
        /// The field, as in `points[3].x`. Empty outside of fields.
        path: String,
        /// The problem.
        problem: String,
    },
    /// A type is nested too deeply for conversions.
    #[error(
        "{type_name} nests messages more than {limit} levels deep, the limit for serialisations other than CDR"
    )]
    TooDeep {
        /// The type.
        type_name: String,
        /// The maximum depth.
        limit: usize,
    },
    /// A type has more fields than the format can number.
    #[error("{type_name} has {found} fields, Protobuf and FlatBuffers support at most {limit}")]
    TooManyFields {
        /// The type.
        type_name: String,
        /// The number of fields.
        found: usize,
        /// The maximum number.
        limit: usize,
    },
    /// This build does not have the encoding.
    #[error("the encoding \"{encoding}\" is not compiled in: build with the Cargo feature \"{feature}\"")]
    NotCompiledIn {
        /// Its name.
        encoding: &'static str,
        /// The feature that enables it.
        feature: &'static str,
    },
}

/// The direction of a conversion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CodecDirection {
    /// From bytes of the format.
    Read,
    /// To bytes of the format.
    Write,
}

impl fmt::Display for CodecDirection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Read => "read",
            Self::Write => "write",
        })
    }
}

/// An error that is passed outwards, collecting the path of its field.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Problem {
    pub(crate) text: String,
    pub(crate) offset: Option<usize>,
    pub(crate) path: String,
}

impl Problem {
    #[cold]
    pub(crate) fn new(text: impl Into<String>) -> Self {
        Self { text: text.into(), offset: None, path: String::new() }
    }

    #[cold]
    pub(crate) fn at(offset: usize, text: impl Into<String>) -> Self {
        Self { offset: Some(offset), ..Self::new(text) }
    }

    #[cold]
    pub(crate) fn in_field(mut self, name: &str) -> Self {
        let separator = if self.path.is_empty() || self.path.starts_with('[') { "" } else { "." };
        self.path = format!("{name}{separator}{}", self.path);
        self
    }

    #[cold]
    pub(crate) fn at_index(self, index: usize) -> Self {
        self.in_field(&format!("[{index}]"))
    }

    #[cold]
    pub(crate) fn into_error(
        self,
        type_name: &str,
        direction: CodecDirection,
        format: &'static str,
    ) -> Error {
        let Self { text: problem, offset, path } = self;
        Error::Convert { type_name: type_name.into(), direction, format, offset, path, problem }
    }
}

fn at(offset: Option<usize>) -> String {
    offset.map_or_else(String::new, |offset| format!(" at byte {offset}"))
}

fn in_field(path: &str) -> String {
    if path.is_empty() { String::new() } else { format!(", field `{path}`") }
}
