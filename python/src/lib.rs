//! The Rust half of the Python package `downbeat`: the extension module `downbeat._core`.
//!
//! `messages` are the message classes and their conversion from and to CDR, `bags` reads and writes bags,
//! `modules` hosts modules of users' classes, `robot` runs robots with them, `probe` tests modules without a
//! robot. The Python half is in `python/downbeat/`.

use pyo3::prelude::*;

mod bags;
mod messages;
mod modules;
mod probe;
mod robot;

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    messages::register(module)?;
    bags::register(module)?;
    modules::register(module)?;
    probe::register(module)?;
    robot::register(module)?;
    Ok(())
}
