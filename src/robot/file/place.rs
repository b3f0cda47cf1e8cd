//! Where the value of a setting was given.

use std::sync::Arc;

use downbeat_executor::SettingValue;

use super::{RobotFile, RobotFileError, Source};
use crate::robot::parameters::line_of;

/// The value of a setting and where it was given.
#[derive(Clone)]
pub(crate) struct Given {
    pub(crate) place: Place,
    pub(crate) value: SettingValue,
}

/// Where a value was given.
#[derive(Clone)]
pub(crate) enum Place {
    /// On a line of the robot file.
    Line(usize),
    /// In a parameter file.
    Parameter(ParameterPlace),
    /// On the command line, so.
    Argument(String),
}

/// A value in a parameter file, by the keys that lead to it.
#[derive(Clone)]
pub(crate) struct ParameterPlace {
    pub(crate) source: Arc<Source>,
    pub(crate) keys: Vec<String>,
}

impl RobotFile {
    /// An error that points to a place.
    pub(crate) fn error_at(&self, place: &Place, problem: impl Into<String>) -> RobotFileError {
        match place {
            Place::Line(line) => self.source.error(*line, problem),
            Place::Parameter(place) => place.error(problem),
            Place::Argument(argument) => {
                RobotFileError::Argument { argument: argument.clone(), problem: problem.into() }
            }
        }
    }
}

impl ParameterPlace {
    pub(crate) fn error(&self, problem: impl Into<String>) -> RobotFileError {
        self.source.error(line_of(self.source.text(), &self.keys), problem)
    }
}
