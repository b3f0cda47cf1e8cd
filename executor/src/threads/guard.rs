//! Running code of users so that its panics stay where they are.

use std::any::Any;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{LockResult, PoisonError};

/// What a lock protects, even if a thread panicked while it held the lock: panics of users' code are caught before
/// they reach one, so what is behind it is whole.
#[inline]
pub(crate) fn unpoisoned<T>(locked: LockResult<T>) -> T {
    locked.unwrap_or_else(PoisonError::into_inner)
}

/// Runs what drops messages of a user's type. A panic in it is logged, and nothing else stops.
/// Returns false if there was one.
pub(crate) fn drop_guarded(what: &str, run: impl FnOnce()) -> bool {
    match catch_unwind(AssertUnwindSafe(run)) {
        Ok(()) => true,
        Err(panic) => {
            log_panic(what, panic);
            false
        }
    }
}

#[cold]
fn log_panic(what: &str, panic: Box<dyn Any + Send>) {
    tracing::error!("{what} panicked while it was dropped: {}", end_of(panic));
}

/// What a panic said, which ends here: what it carried may panic in its drop.
pub(crate) fn end_of(panic: Box<dyn Any + Send>) -> String {
    let said = reason(&*panic).to_owned();
    if let Err(another) = catch_unwind(AssertUnwindSafe(|| drop(panic))) {
        tracing::error!("what a panic carried panicked while it was dropped: {}", reason(&*another));
        // There may be no end to it.
        std::mem::forget(another);
    }
    said
}

/// What a panic said, in full.
pub(crate) fn reason(panic: &(dyn Any + Send)) -> &str {
    match panic.downcast_ref::<Failure>() {
        Some(Failure { report: Some(report), .. }) => report,
        _ => sentence(panic),
    }
}

/// What a panic said, without the report that a [`Failure`] has.
pub(crate) fn sentence(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    let text = text.or_else(|| panic.downcast_ref::<String>().map(String::as_str));
    let text = text.or_else(|| panic.downcast_ref::<Failure>().map(|failure| &*failure.reason));
    text.unwrap_or("no reason given")
}

/// Why a module ends, as what a panic carries, for a module that has more to report than a sentence: the traceback of an exception.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// In a sentence. Clients receive it whose requests have no answer because of it.
    pub reason: String,
    /// In full, for the log. `None`: there is no more than the sentence.
    pub report: Option<String>,
}

impl Failure {
    /// The report, or the sentence if that is all.
    #[must_use]
    pub fn into_report(self) -> String {
        self.report.unwrap_or(self.reason)
    }
}

impl From<String> for Failure {
    fn from(reason: String) -> Self {
        Self { reason, report: None }
    }
}

impl From<&str> for Failure {
    fn from(reason: &str) -> Self {
        reason.to_owned().into()
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.reason)
    }
}
