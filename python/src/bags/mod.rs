//! Reading and writing bags.

mod errors;
mod reading;
mod table;
mod writing;

use pyo3::prelude::*;

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<reading::Bag>()?;
    module.add_class::<reading::Topic>()?;
    module.add_class::<reading::Messages>()?;
    module.add_class::<writing::Writer>()?;
    Ok(())
}
