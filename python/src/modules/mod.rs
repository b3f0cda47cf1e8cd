//! Modules in Python: how they are loaded and reloaded, and what joins them to a core.
//!
//! A module's callbacks run attached to the interpreter, on the thread on which the core runs the module;
//! nothing here waits while it is attached. What a callback asks for is collected in its [`Link`] and applied
//! when the callback returns.

mod link;
mod loader;
mod python_module;
mod values;
mod watch;

pub(crate) use loader::{python_kind, python_kind_of};
pub(crate) use values::from_python as setting_value;

use pyo3::prelude::*;

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<link::Link>()?;
    module.add_class::<link::Publisher>()?;
    module.add_class::<link::Client>()?;
    module.add_class::<link::Request>()?;
    Ok(())
}
