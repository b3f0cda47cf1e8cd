//! Running cases, and saying how it went.

use crate::cases::{CASES, Case, Ran};
use crate::engine::{Domain, Engine, KnownFailure};
use std::any::Any;
use std::fmt::{self, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// How a case went.
#[derive(Clone, Debug)]
pub struct CaseResult {
    /// The engine.
    pub engine: &'static str,
    /// The case.
    pub case: &'static Case,
    /// How it went.
    pub outcome: Outcome,
}

/// How a case can go.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// The engine does it; with a figure, where one was measured.
    Passed(Option<String>),
    /// It does not, with what was found.
    Failed(String),
    /// It does not, as was known; with what was found.
    KnownFailure(KnownFailure, String),
    /// It was known not to, and does: the note is to be taken away.
    Mended(KnownFailure, Option<String>),
    /// The engine has nothing that the case is about, for the reason given.
    NotApplicable(&'static str),
}

/// Runs one case.
#[must_use]
pub fn run(engine: &Engine, case: &'static Case) -> CaseResult {
    let domain = Domain { engine, domain_id: case.domain_id };
    let known = engine.known_failures.iter().find(|known| known.case == case.name).copied();
    let ran = catch_unwind(AssertUnwindSafe(|| (case.run)(&domain)));
    let found = match ran {
        Ok(Ran::Done(figure)) => Ok(figure),
        Ok(Ran::Failed(problem)) => Err(problem),
        Ok(Ran::NotApplicable(reason)) => {
            return CaseResult { engine: engine.name, case, outcome: Outcome::NotApplicable(reason) };
        }
        Err(panic) => Err(message(&*panic)),
    };
    let outcome = match (found, known) {
        (Ok(figure), None) => Outcome::Passed(figure),
        (Ok(figure), Some(known)) => Outcome::Mended(known, figure),
        (Err(problem), None) => Outcome::Failed(problem),
        (Err(problem), Some(known)) => Outcome::KnownFailure(known, problem),
    };
    CaseResult { engine: engine.name, case, outcome }
}

/// Runs all cases, one after the other.
pub fn run_all(engine: &Engine) -> impl Iterator<Item = CaseResult> {
    CASES.iter().map(move |case| run(engine, case))
}

impl CaseResult {
    /// True unless the case failed and is no known failure. A known failure that passes is as expected too.
    #[must_use]
    pub fn is_as_expected(&self) -> bool {
        !matches!(self.outcome, Outcome::Failed(_))
    }
}

impl fmt::Display for CaseResult {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { engine, case, outcome } = self;
        write!(f, "{engine}: {}: ", case.name)?;
        match outcome {
            Outcome::Passed(None) => f.write_str("passed"),
            Outcome::Passed(Some(figure)) => write!(f, "passed, {figure}"),
            Outcome::Failed(problem) => write!(f, "FAILED: {problem}"),
            Outcome::KnownFailure(known, problem) => write!(f, "known failure ({}): {problem}", known.limit),
            Outcome::Mended(known, _) => {
                write!(f, "mended: it passes, so it is no known failure any more ({})", known.limit)
            }
            Outcome::NotApplicable(reason) => write!(f, "not applicable: {reason}"),
        }
    }
}

/// The page of what an engine cannot do, and of its figures, in Markdown.
#[must_use]
pub fn limits_page(engine: &Engine, results: &[CaseResult]) -> String {
    let mut page = format!(
        "# What the DDS engine does and does not\n\nMade by `cargo run -p downbeat-conformance --bin limits` of what {} did on this \
         machine, in the cases of [`bridge/conformance`](../bridge/conformance/README.md). [bridge/README.md](../bridge/README.md) \
         has limits besides that no case is for.\n\n## Limits\n\n",
        engine.name
    );
    page.push_str(if engine.known_failures.is_empty() {
        "None: no case fails.\n"
    } else {
        "| limit | cause | effect | measured | what you can do |\n| --- | --- | --- | --- | --- |\n"
    });
    for result in results {
        let (known, measured) = match &result.outcome {
            Outcome::KnownFailure(known, problem) => (known, problem.replace(['\n', '|'], " ")),
            Outcome::Mended(known, _) => (known, "not seen in this run".to_owned()),
            _ => continue,
        };
        let KnownFailure { limit, cause, effect, remedy, .. } = known;
        // Writing to a string does not fail.
        let _ = writeln!(page, "| {limit} | {cause} | {effect} | {measured} | {remedy} |");
    }
    page.push_str("\n## All cases\n\n| | case | |\n| --- | --- | --- |\n");
    for CaseResult { case, outcome, .. } in results {
        let outcome = match outcome {
            Outcome::Passed(figure) => figure.clone().unwrap_or_else(|| "pass".into()),
            Outcome::Failed(problem) => format!("**fails**: {}", problem.replace(['\n', '|'], " ")),
            Outcome::KnownFailure(..) => "known limit, see above".into(),
            Outcome::Mended(..) => "pass; was a known limit".into(),
            Outcome::NotApplicable(reason) => format!("not applicable: {reason}"),
        };
        let _ = writeln!(page, "| {} | {} | {outcome} |", case.heading, case.name.replace('_', " "));
    }
    page
}

fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic without a message").to_owned()
}
