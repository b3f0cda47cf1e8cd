//! Running code of users so that its panics stay where they are.

use std::any::Any;
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

/// What a panic said.
pub(crate) fn reason(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("no reason given")
}
