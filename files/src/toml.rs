//! TOML that users write: read up to a size, with errors that name file and line.
//!
//! A reader makes a [`Source`] of a file, gets its content with [`Source::parse`] as a type, or with
//! [`Source::table`] as tables to be taken apart, and reports what it refuses with [`Source::error`]: in both
//! ways the [`Spanned`] parts know where they stand.

use std::borrow::Cow;
use std::fmt;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
pub use toml::Spanned;
pub use toml::de::{DeString, DeTable, DeValue};

use crate::lines::{Lines, line_of};
use crate::user_file;

/// What is wrong with a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Error {
    /// The file cannot be read, or is too large for its kind.
    Unreadable {
        /// What it is, such as "the robot file".
        what: &'static str,
        /// The file.
        path: PathBuf,
        /// The error of the operating system, or the size.
        reason: String,
    },
    /// A line is invalid.
    Line {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What was found, and what was expected.
        problem: String,
    },
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreadable { what, path, reason } => {
                write!(f, "cannot read {what} {}: {reason}", path.display())
            }
            Self::Line { path, line, problem } => write!(f, "{}:{line}: {problem}", path.display()),
        }
    }
}

impl std::error::Error for Error {}

/// What is wrong with a text that has no path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// The line, from 1.
    pub line: usize,
    /// What was found, and what was expected.
    pub problem: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: {}", self.line, self.problem)
    }
}

impl std::error::Error for Problem {}

/// Parses a text without a path.
///
/// # Errors
/// If it is no TOML, or has not the form of `T`.
pub fn parse<T: DeserializeOwned>(text: &str) -> Result<T, Problem> {
    toml::from_str(text).map_err(|error| problem(text, &error))
}

/// The text of a file, and its path for errors.
#[derive(Clone, Debug)]
pub struct Source<'a> {
    path: PathBuf,
    text: Cow<'a, str>,
    lines: Lines,
}

impl Source<'static> {
    /// Reads a regular file of at most `most` bytes; `what` names it in errors, such as "the robot file".
    ///
    /// # Errors
    /// [`Error::Unreadable`].
    pub fn read(path: impl Into<PathBuf>, what: &'static str, most: u64) -> Result<Self, Error> {
        let path = path.into();
        match user_file::read_text_within(&path, most) {
            Ok(text) => Ok(Self::new(path, text)),
            Err(error) => Err(Error::Unreadable { what, path, reason: error.to_string() }),
        }
    }
}

impl<'a> Source<'a> {
    /// A text that is, or is meant to be, at this path.
    pub fn new(path: impl Into<PathBuf>, text: impl Into<Cow<'a, str>>) -> Self {
        let text = text.into();
        Self { path: path.into(), lines: Lines::new(&text), text }
    }

    /// The path as the user wrote it.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The whole text.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The line of a byte, from 1.
    #[must_use]
    pub fn line_of(&self, offset: usize) -> usize {
        self.lines.line_of(offset)
    }

    /// An error at a byte.
    pub fn error(&self, offset: usize, problem: impl Into<String>) -> Error {
        self.error_on(self.line_of(offset), problem)
    }

    /// An error on a line.
    pub fn error_on(&self, line: usize, problem: impl Into<String>) -> Error {
        Error::Line { path: self.path.clone(), line, problem: problem.into() }
    }

    /// The content as a type.
    ///
    /// # Errors
    /// If the text is no TOML, or has not the form of `T`.
    pub fn parse<T: DeserializeOwned>(&self) -> Result<T, Error> {
        toml::from_str(&self.text).map_err(|error| self.refused(&error))
    }

    /// The content as tables.
    ///
    /// # Errors
    /// If the text is no TOML.
    pub fn table(&self) -> Result<Spanned<DeTable<'_>>, Error> {
        DeTable::parse(&self.text).map_err(|error| self.refused(&error))
    }

    fn refused(&self, error: &toml::de::Error) -> Error {
        let Problem { line, problem } = problem(&self.text, error);
        self.error_on(line, problem)
    }
}

fn problem(text: &str, error: &toml::de::Error) -> Problem {
    let line = line_of(text, error.span().map_or(0, |span| span.start));
    Problem { line, problem: error.message().trim().to_owned() }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use serde::Deserialize;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Ball {
        radius: Spanned<f64>,
    }

    #[test]
    fn a_file_is_read_with_lines() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ball.toml");
        std::fs::write(&path, "# A ball.\n\nradius = 0.5\n").unwrap();
        let source = Source::read(&path, "the ball", 100).unwrap();
        let ball: Ball = source.parse().unwrap();
        assert_eq!(*ball.radius.get_ref(), 0.5);
        let error = source.error(ball.radius.span().start, "too large").to_string();
        assert_eq!(error, format!("{}:3: too large", path.display()));
    }

    #[test]
    fn what_cannot_be_read_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ball.toml");
        let error = || Source::read(&path, "the ball", 10).unwrap_err().to_string();
        assert!(error().starts_with(&format!("cannot read the ball {}: ", path.display())), "{}", error());
        std::fs::write(&path, "radius = 0.5").unwrap();
        assert!(error().ends_with(": it has 12 bytes; at most 10 are read"), "{}", error());
    }

    #[test]
    fn both_ways_to_parse_name_the_line() {
        let wrong = Source::new("a.toml", "radius = 1\n\nradius = 2");
        let typed = wrong.parse::<Ball>().unwrap_err();
        assert_eq!(typed, wrong.table().unwrap_err());
        assert!(typed.to_string().starts_with("a.toml:3: "), "{typed}");
        let unknown = Source::new("a.toml", "radius = 1\nmass = 2").parse::<Ball>().unwrap_err();
        assert!(unknown.to_string().starts_with("a.toml:2: unknown field"), "{unknown}");
        let without_path = parse::<Ball>("radius = 1\nmass = 2").unwrap_err().to_string();
        assert!(without_path.starts_with("line 2: unknown field"), "{without_path}");
    }
}
