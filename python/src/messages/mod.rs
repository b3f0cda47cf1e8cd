//! Message classes, and their conversion from and to CDR.

use pyo3::prelude::*;

pub(crate) fn register(_: &Bound<'_, PyModule>) -> PyResult<()> {
    Ok(())
}
