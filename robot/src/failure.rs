//! The error type for `main` functions and tests of users.

use std::error::Error;
use std::fmt;

/// An error as text, for `main` and for tests.
///
/// Every error converts to it with `?`. A `main` or a test that returns it prints the message with its
/// causes, where a boxed error would print Rust's debug representation.
///
/// ```
/// fn main() -> Result<(), downbeat_robot::Failure> {
///     let port: u16 = "7400".parse()?;
///     assert_eq!(port, 7400);
///     Ok(())
/// }
/// ```
pub struct Failure {
    message: String,
}

/// The result of a test that ends in [`assert_same`](crate::replay::ReplayReport::assert_same) or uses `?`.
pub type TestResult = Result<(), Failure>;

impl<E: Error> From<E> for Failure {
    fn from(error: E) -> Self {
        let causes = std::iter::successors(Some(&error as &dyn Error), |error| (*error).source());
        Self { message: in_one_line(causes.map(ToString::to_string)) }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl fmt::Debug for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// Joins an error and its causes, without causes that the preceding text already contains.
pub fn in_one_line(causes: impl Iterator<Item = String>) -> String {
    causes.fold(String::new(), |mut text, cause| {
        if !text.contains(&cause) {
            text.push_str(if text.is_empty() { "" } else { ": " });
            text.push_str(&cause);
        }
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RobotFile;

    #[test]
    fn a_failure_returned_from_main_is_printed_as_text() {
        let main = || -> TestResult {
            RobotFile::read("nowhere.toml".as_ref())?;
            Ok(())
        };
        let printed = format!("{:?}", main().err());
        assert!(printed.contains("nowhere.toml") && !printed.contains('{'), "{printed}");
    }

    #[test]
    fn a_cause_that_is_already_in_the_text_is_not_repeated() {
        let causes = ["run", "cannot read a: no such file", "no such file"].map(str::to_owned);
        assert_eq!(in_one_line(causes.into_iter()), "run: cannot read a: no such file");
    }
}
