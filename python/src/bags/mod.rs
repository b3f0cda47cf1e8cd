//! Reading and writing bags.

use pyo3::prelude::*;

pub(crate) fn register(_: &Bound<'_, PyModule>) -> PyResult<()> {
    Ok(())
}
