//! Errors of reading bags as exceptions.

use std::io::ErrorKind;

use downbeat_bags::ReaderError;
use pyo3::exceptions::{PyFileNotFoundError, PyOSError, PyValueError};
use pyo3::prelude::*;

/// The exception for an error of reading a bag.
pub(super) fn exception(error: ReaderError) -> PyErr {
    let text = error.to_string();
    match error {
        ReaderError::Read { source, .. } if source.kind() == ErrorKind::NotFound => {
            PyFileNotFoundError::new_err(text)
        }
        ReaderError::Read { .. } => PyOSError::new_err(text),
        _ => PyValueError::new_err(text),
    }
}
