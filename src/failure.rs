//! What a `main` or a test of a user's own returns.

use std::error::Error;
use std::fmt;

/// An error as text, for `main` and for tests.
///
/// Every error becomes one with `?`. A `main` or a test that returns it prints the message with its causes, where a boxed
/// error would print Rust's debug representation.
///
/// ```
/// fn main() -> Result<(), downbeat::Failure> {
///     let port: u16 = "7400".parse()?;
///     assert_eq!(port, 7400);
///     Ok(())
/// }
/// ```
pub struct Failure {
    message: String,
}

/// What a test returns that ends in [`assert_same`](crate::replay::ReplayReport::assert_same) or uses `?`.
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

/// The error and its causes, without those that the text before them says already.
pub(crate) fn in_one_line(causes: impl Iterator<Item = String>) -> String {
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
    use crate::robot::RobotFile;

    #[test]
    fn a_failure_is_printed_as_text_also_by_a_main_that_returns_it() {
        let main = || -> TestResult {
            RobotFile::read("nowhere.toml".as_ref())?;
            Ok(())
        };
        let printed = format!("{:?}", main().err());
        assert!(printed.contains("nowhere.toml") && !printed.contains('{'), "{printed}");
    }

    #[test]
    fn a_cause_that_is_told_already_is_not_told_again() {
        let causes = ["run", "cannot read a: no such file", "no such file"].map(str::to_owned);
        assert_eq!(in_one_line(causes.into_iter()), "run: cannot read a: no such file");
    }
}
