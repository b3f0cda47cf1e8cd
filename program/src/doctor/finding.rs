//! What was found, and what to do about it.

use std::fmt;

use serde::Serialize;

/// How much a finding matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Verdict {
    /// Nothing is to be done.
    Ok,
    /// The robot runs with less than it could have.
    Warn,
    /// The robot does not do what its file says, or does not start.
    Problem,
}

/// One line of the report.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Finding {
    pub(super) verdict: Verdict,
    /// What it is about, in one word.
    pub(super) area: &'static str,
    pub(super) found: String,
    /// What to do; `None` for nothing, and where `found` says it.
    pub(super) remedy: Option<String>,
}

impl Finding {
    pub(super) fn ok(area: &'static str, found: impl Into<String>) -> Self {
        Self { verdict: Verdict::Ok, area, found: found.into(), remedy: None }
    }

    pub(super) fn warn(area: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { verdict: Verdict::Warn, area, found: found.into(), remedy: Some(remedy.into()) }
    }

    pub(super) fn problem(area: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { verdict: Verdict::Problem, area, found: found.into(), remedy: Some(remedy.into()) }
    }

    /// A problem whose sentence says what to do.
    pub(super) fn explained(area: &'static str, found: impl Into<String>) -> Self {
        Self { verdict: Verdict::Problem, area, found: found.into(), remedy: None }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verdict = match self.verdict {
            Verdict::Ok => "ok",
            Verdict::Warn => "warn",
            Verdict::Problem => "problem",
        };
        write!(f, "{verdict:<8} {:<9} {}", self.area, self.found)?;
        self.remedy.as_ref().map_or(Ok(()), |remedy| write!(f, "; to do: {remedy}"))
    }
}
