//! Runs user code and catches its panics.

use std::any::Any;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{LockResult, PoisonError};

/// Locks, and ignores poisoning: panics of user code are caught before they reach a lock, so the protected
/// data are consistent.
#[inline]
pub(crate) fn unpoisoned<T>(locked: LockResult<T>) -> T {
    locked.unwrap_or_else(PoisonError::into_inner)
}

/// Runs code that drops messages of a user's type. A panic in it is logged and caught; returns false in that
/// case.
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

/// Ends a panic and returns its message. The drop of the panic's payload is guarded too.
pub(crate) fn end_of(panic: Box<dyn Any + Send>) -> String {
    let said = reason(&*panic).to_owned();
    if let Err(another) = catch_unwind(AssertUnwindSafe(|| drop(panic))) {
        tracing::error!("the payload of a panic panicked while it was dropped: {}", reason(&*another));
        // Leaked, because its drop could panic again, without end.
        std::mem::forget(another);
    }
    said
}

/// The full message of a panic.
pub(crate) fn reason(panic: &(dyn Any + Send)) -> &str {
    match panic.downcast_ref::<Failure>() {
        Some(Failure { report: Some(report), .. }) => report,
        _ => sentence(panic),
    }
}

/// The message of a panic, without the report of a [`Failure`].
pub(crate) fn sentence(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    let text = text.or_else(|| panic.downcast_ref::<String>().map(String::as_str));
    let text = text.or_else(|| panic.downcast_ref::<Failure>().map(|failure| &*failure.reason));
    text.unwrap_or("no reason given")
}

/// The reason for which a module ends, as the payload of a panic; for modules that have more than a sentence
/// to report, such as the traceback of an exception.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// The reason in one sentence, which waiting clients of the module receive.
    pub reason: String,
    /// The full report for the log; `None` if there is only the sentence.
    pub report: Option<String>,
}

impl Failure {
    /// The report, or the sentence if there is no report.
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
