//! A request to the writing thread, and its result.

/// Why a request to a recording failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ControlError {
    /// It keeps no messages for snapshots.
    #[error("cannot take a snapshot: recording is not in snapshot mode")]
    NoSnapshots,
    /// It has ended, possibly before handling the request.
    #[error("recording has ended")]
    Ended,
}

type Answer<T> = Box<dyn FnOnce(Result<T, ControlError>) + Send>;

/// Completes a request once: with its result or, if dropped before, with the error that recording has ended.
pub(super) struct Done<T> {
    answer: Option<Answer<T>>,
}

impl<T> Done<T> {
    pub(super) fn new(answer: impl FnOnce(Result<T, ControlError>) + Send + 'static) -> Self {
        Self { answer: Some(Box::new(answer)) }
    }

    pub(super) fn send_result(mut self, result: Result<T, ControlError>) {
        if let Some(answer) = self.answer.take() {
            answer(result);
        }
    }
}

impl<T> Drop for Done<T> {
    fn drop(&mut self) {
        if let Some(answer) = self.answer.take() {
            answer(Err(ControlError::Ended));
        }
    }
}
