//! The text of a robot file, and errors that point into it.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use downbeat_executor::SettingValue;
use downbeat_files::toml::{self, DeTable, Spanned};
use downbeat_files::user_file;

use super::yaml_line::line_of;

/// Error in a robot file or in arguments for it, with its place.
#[derive(Debug, thiserror::Error)]
pub enum RobotFileError {
    /// The robot file, or one that it names, cannot be read, or a line is invalid.
    #[error(transparent)]
    File(#[from] toml::Error),
    /// An argument of the command line is invalid.
    #[error("-p {argument}: {problem}")]
    Argument {
        /// The argument as given.
        argument: String,
        /// What was found, what was expected, and the most similar valid name if there is one.
        problem: String,
    },
}

/// The path and the text of a robot file, or of a parameter file.
pub struct Source {
    source: toml::Source<'static>,
}

impl Source {
    /// Reads a file that a user wrote; `what` names it in errors, such as "the robot file".
    ///
    /// # Errors
    /// If it cannot be read, or is far too large for its kind.
    pub fn read(path: &Path, what: &'static str) -> Result<Self, RobotFileError> {
        Ok(Self { source: toml::Source::read(path, what, user_file::LARGEST)? })
    }

    /// A text that was read from `path`.
    #[must_use]
    pub fn new(path: &Path, text: String) -> Self {
        Self { source: toml::Source::new(path, text) }
    }

    /// The path as the user wrote it.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.source.path()
    }

    /// The whole text.
    #[must_use]
    pub fn text(&self) -> &str {
        self.source.text()
    }

    /// The line of the first byte of a span, from 1.
    #[must_use]
    pub fn line_of(&self, span: &Range<usize>) -> usize {
        self.source.line_of(span.start)
    }

    /// An error that names the file and the line.
    pub fn error(&self, line: usize, problem: impl Into<String>) -> RobotFileError {
        self.source.error_on(line, problem).into()
    }

    /// The content as TOML.
    ///
    /// # Errors
    /// If it is no TOML.
    pub(super) fn table(&self) -> Result<Spanned<DeTable<'_>>, RobotFileError> {
        Ok(self.source.table()?)
    }
}

/// Returns a TOML string with all special characters escaped.
pub fn toml_string(text: &str) -> String {
    let escape = |c: char| match c {
        '"' | '\\' => format!("\\{c}"),
        c if c.is_control() => format!("\\u{:04x}", u32::from(c)),
        c => c.to_string(),
    };
    format!("\"{}\"", text.chars().map(escape).collect::<String>())
}

/// The value of a setting with the place at which it was given.
#[derive(Clone)]
pub struct Given {
    /// Where it was given.
    pub place: Place,
    /// The value.
    pub value: SettingValue,
    /// Whether it was given under a wildcard, and may be meant for other nodes.
    pub is_wildcard: bool,
}

/// The place at which a value was given.
#[derive(Clone)]
pub enum Place {
    /// On a line of the robot file.
    Line(usize),
    /// On a line of a file that it includes.
    Included(Arc<Source>, usize),
    /// In a parameter file.
    Parameter(ParameterPlace),
    /// In this argument of the command line.
    Argument(String),
}

/// A value in a parameter file, identified by the keys that lead to it.
#[derive(Clone)]
pub struct ParameterPlace {
    /// The file.
    pub source: Arc<Source>,
    /// From the root of the file.
    pub keys: Vec<String>,
}

impl Place {
    /// True for the command line and parameter files, which say how this run is to be, and not how the robot
    /// is.
    #[must_use]
    pub fn is_for_this_run(&self) -> bool {
        matches!(self, Self::Parameter(_) | Self::Argument(_))
    }
}

impl ParameterPlace {
    /// An error that names the file and the line of the value.
    #[must_use]
    pub fn error(&self, problem: impl Into<String>) -> RobotFileError {
        self.source.error(line_of(self.source.text(), &self.keys), problem)
    }
}
