//! Messages as text: YAML as the command line of ROS 2 has it, JSON, and any other format of serde.

mod fill;
mod implicit;
#[cfg(feature = "json")]
mod json;
mod numpy;
pub mod python;
mod scalar;
mod serialize;
mod stamps;
mod yaml;

use std::cell::{Cell, RefCell};
use std::fmt::Display;

use serde::de::{DeserializeSeed, Deserializer};

use self::fill::{Fill, State, Trail};
use super::change::Place;
use super::{DynamicMessage, DynamicType, FieldError, MessageRef};

pub use scalar::{Context as YamlContext, write_float as write_yaml_float, write_text as write_yaml_text};
pub use stamps::Stamps;
pub use yaml::YamlStyle;

/// A text is not the message it was read as.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("cannot read this {format}{}: {problem}", at(*line, *column))]
pub struct TextError {
    /// YAML or JSON.
    pub format: &'static str,
    /// Counted from 1; 0 where it is not known.
    pub line: usize,
    /// Counted from 1; 0 where it is not known.
    pub column: usize,
    /// What is wrong.
    pub problem: TextProblem,
}

/// What is wrong with a text.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TextProblem {
    /// A field is not there, or cannot have that value.
    #[error("{0}")]
    Field(Box<FieldError>),
    /// It is not of that format, or not of the form of a message.
    #[error("{0}")]
    Form(String),
}

impl DynamicMessage {
    /// The message as `ros2 topic echo` prints it, without the line `---` behind it: the same bytes.
    #[must_use]
    pub fn to_yaml(&self, style: &YamlStyle) -> String {
        self.as_message().to_yaml(style)
    }

    /// A message from YAML, as `ros2 topic pub` takes it: fields that are not named keep their defaults.
    ///
    /// # Errors
    /// As [`DynamicMessage::fill_yaml`]. Also if the text leaves times to the sender: there is no time to give them here.
    pub fn from_yaml(of: &DynamicType, yaml: &str) -> Result<Self, TextError> {
        let mut message = Self::new(of);
        let stamps = message.fill_yaml(yaml)?;
        without_stamps(&stamps, "YAML").map(|()| message)
    }

    /// Changes the fields that the YAML names, as `ros2 topic pub` does. Gives the times that the text leaves to the
    /// sender by `header: auto` or `stamp: now`.
    ///
    /// A string takes what is written, quoted or not: `data: 010` is `010`, where `ros2 topic pub` reads a number first
    /// and takes its digits, `8`. Numbers and truth values are read as in YAML 1.1 (`yes`, `0b11`, `1_000`). A `byte` is
    /// a number, or a character as `ros2 topic echo` shows it. An integer does not take `1.5`, which rclpy would cut off.
    ///
    /// # Errors
    /// If the text is no YAML mapping, or a field is not there or cannot have its value. The message is unchanged then.
    pub fn fill_yaml(&mut self, yaml: &str) -> Result<Stamps, TextError> {
        let told = |error: &serde_norway::Error, field| {
            let (line, column) = error.location().map_or((0, 0), |place| (place.line(), place.column()));
            TextError::new("YAML", line, column, error, field)
        };
        let yaml = crate::yaml::deserializer(yaml).map_err(|error| told(&error, None))?;
        self.fill_from(yaml).map_err(|(error, field)| told(&error, field))
    }

    /// Changes the fields that the input names, in any format of serde that describes itself.
    ///
    /// # Errors
    /// If the input is no map, or a field is not there or cannot have its value. The message is unchanged then.
    pub fn fill<'de, D: Deserializer<'de>>(&mut self, deserializer: D) -> Result<Stamps, D::Error> {
        self.fill_from(deserializer).map_err(|(error, _)| error)
    }

    fn fill_from<'de, D: Deserializer<'de>>(
        &mut self,
        deserializer: D,
    ) -> Result<Stamps, (D::Error, Option<FieldError>)> {
        let mut filled = self.slots.clone();
        let state = State {
            type_name: self.of.name(),
            stamps: RefCell::default(),
            error: RefCell::default(),
            memory: Cell::default(),
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
    /// `field` says more than the error of the format, if it is there.
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
    /// As [`DynamicMessage::to_yaml`].
    #[must_use]
    pub fn to_yaml(self, style: &YamlStyle) -> String {
        yaml::to_yaml(self, style)
    }
}

fn without_stamps(stamps: &Stamps, format: &'static str) -> Result<(), TextError> {
    match stamps.paths().next() {
        None => Ok(()),
        Some(path) => {
            let problem = TextProblem::Form(format!("`{path}` is left to the sender, give it a time"));
            Err(TextError { format, line: 0, column: 0, problem })
        }
    }
}

/// The text of an error of a format, whose place is told apart from it.
fn without_place(text: &str) -> String {
    text.rfind(" at line ").map_or(text, |place| &text[..place]).to_owned()
}

fn at(line: usize, column: usize) -> String {
    if line == 0 { String::new() } else { format!(", line {line}, column {column}") }
}
