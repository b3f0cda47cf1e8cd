//! Messages as text: YAML as on the command line of ROS 2, JSON, and other serde formats.

mod fill;
#[cfg(feature = "json")]
mod json;
mod numpy;
pub mod python;
mod scalar;
mod serialize;
mod yaml;

use std::cell::{Cell, RefCell};
use std::fmt::Display;

use serde::de::{DeserializeSeed, Deserializer};

use self::fill::{Fill, Nothing, State, Trail};
use super::change::Place;
use super::{DynamicMessage, DynamicType, FieldError, MessageRef};
pub use fill::Stamps;
pub use scalar::{Context as YamlContext, write_float as write_yaml_float, write_text as write_yaml_text};
pub use yaml::YamlStyle;

/// A text is not a message of the expected type.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("cannot read this {format}{}: {problem}", at(*line, *column))]
pub struct TextError {
    /// YAML or JSON.
    pub format: &'static str,
    /// Counted from 1; 0 if unknown.
    pub line: usize,
    /// Counted from 1; 0 if unknown.
    pub column: usize,
    /// The problem.
    pub problem: TextProblem,
}

/// The problem with a text.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TextProblem {
    /// There is no such field, or it cannot have that value.
    #[error("{0}")]
    Field(Box<FieldError>),
    /// The text has invalid syntax, or not the structure of a message.
    #[error("{0}")]
    Form(String),
}

impl DynamicMessage {
    /// Formats the message like `ros2 topic echo`, byte for byte, without the final line `---`.
    #[must_use]
    pub fn to_yaml(&self, style: &YamlStyle) -> String {
        self.as_message().to_yaml(style)
    }

    /// Parses a message from YAML, like `ros2 topic pub`: missing fields keep their defaults.
    ///
    /// # Errors
    /// See [`DynamicMessage::fill_yaml`]. Also if the text asks for the time of sending, which is not known
    /// here.
    pub fn from_yaml(of: &DynamicType, yaml: &str) -> Result<Self, TextError> {
        let mut message = Self::new(of);
        let stamps = message.fill_yaml(yaml)?;
        without_stamps(&stamps, "YAML").map(|()| message)
    }

    /// Sets the fields in the YAML text, like `ros2 topic pub`. Returns the times that the text asks the
    /// sender to set, with `header: auto` or `stamp: now`.
    ///
    /// A string is the text as written, quoted or not: `data: 010` is `010`, where `ros2 topic pub` parses a
    /// number first and uses its digits, `8`. Numbers and booleans are read as in YAML 1.1 (`yes`, `0b11`,
    /// `1_000`). A `byte` is a number, or a character as printed by `ros2 topic echo`. An integer does not
    /// accept `1.5`, which rclpy truncates. `!!binary` gives the bytes of an array of `uint8` or `byte`; what
    /// `!!bool`, `!!int` and `!!float` do not fit is an error. So is a key without a value, or with `null`.
    ///
    /// # Errors
    /// Returns an error if the text is not a YAML mapping, or there is no such field or it cannot have the
    /// value. The message is then unchanged.
    pub fn fill_yaml(&mut self, yaml: &str) -> Result<Stamps, TextError> {
        let text_error = |error: &serde_norway::Error, field| {
            let (line, column) = error.location().map_or((0, 0), |place| (place.line(), place.column()));
            TextError::new("YAML", line, column, error, field)
        };
        let yaml = crate::yaml::with_local_tags(yaml);
        let yaml = crate::yaml::deserializer(&yaml).map_err(|error| text_error(&error, None))?;
        self.fill_from(yaml, Nothing::IsRefused).map_err(|(error, field)| text_error(&error, field))
    }

    /// Sets the fields in the input, in any self-describing serde format.
    ///
    /// # Errors
    /// Returns an error if the input is not a map, or there is no such field or it cannot have the value. The
    /// message is then unchanged.
    pub fn fill<'de, D: Deserializer<'de>>(&mut self, deserializer: D) -> Result<Stamps, D::Error> {
        self.fill_from(deserializer, Nothing::IsNan).map_err(|(error, _)| error)
    }

    fn fill_from<'de, D: Deserializer<'de>>(
        &mut self,
        deserializer: D,
        nothing: Nothing,
    ) -> Result<Stamps, (D::Error, Option<FieldError>)> {
        let mut filled = self.slots.clone();
        let state = State {
            type_name: self.of.name(),
            stamps: RefCell::default(),
            error: RefCell::default(),
            memory: Cell::default(),
            nothing,
        };
        let place = Place::Message { layout: &self.of, index: self.of.index(), slots: &mut filled };
        let result = Fill { place, trail: &Trail::Root, state: &state }.deserialize(deserializer);
        match result {
            Ok(()) => {
                let paths = state.stamps.into_inner();
                self.slots = filled;
                Ok(Stamps { paths })
            }
            Err(error) => Err((error, state.error.into_inner())),
        }
    }
}

impl TextError {
    /// `field`, if present, has more detail than the error of the format.
    fn new(
        format: &'static str,
        line: usize,
        column: usize,
        error: &dyn Display,
        field: Option<FieldError>,
    ) -> Self {
        let problem = match field {
            Some(field) => TextProblem::Field(Box::new(field)),
            None => TextProblem::Form(without_place(&error.to_string())),
        };
        Self { format, line, column, problem }
    }
}

impl MessageRef<'_> {
    /// See [`DynamicMessage::to_yaml`].
    #[must_use]
    pub fn to_yaml(self, style: &YamlStyle) -> String {
        yaml::to_yaml(self, style)
    }
}

fn without_stamps(stamps: &Stamps, format: &'static str) -> Result<(), TextError> {
    match stamps.paths().next() {
        None => Ok(()),
        Some(path) => {
            let problem = TextProblem::Form(format!("`{path}` is to be set by the sender: give it a time"));
            Err(TextError { format, line: 0, column: 0, problem })
        }
    }
}

/// Removes the position from the text of an error, since it is reported separately.
fn without_place(text: &str) -> String {
    text.rfind(" at line ").map_or(text, |place| &text[..place]).to_owned()
}

fn at(line: usize, column: usize) -> String {
    if line == 0 { String::new() } else { format!(", line {line}, column {column}") }
}
