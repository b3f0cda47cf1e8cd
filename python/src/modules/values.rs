//! Values of settings, as Python has them.

use downbeat::executor::SettingValue;
use pyo3::IntoPyObjectExt;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyBytes, PyFloat, PyInt, PyList, PyString, PyTuple};

pub(super) fn to_python(py: Python<'_>, value: &SettingValue) -> PyResult<Py<PyAny>> {
    match value {
        SettingValue::Bool(value) => value.into_py_any(py),
        SettingValue::Integer(value) => value.into_py_any(py),
        SettingValue::Double(value) => value.into_py_any(py),
        SettingValue::Text(value) => value.into_py_any(py),
        SettingValue::Bools(values) => values.into_py_any(py),
        SettingValue::Bytes(values) => PyBytes::new(py, values).into_py_any(py),
        SettingValue::Integers(values) => values.into_py_any(py),
        SettingValue::Doubles(values) => values.into_py_any(py),
        SettingValue::Texts(values) => values.into_py_any(py),
    }
}

/// The value of a setting. An empty list is of any kind.
pub(crate) fn from_python(value: &Bound<'_, PyAny>) -> PyResult<SettingValue> {
    if let Some(value) = scalar(value)? {
        return Ok(value);
    }
    if let Ok(value) = value.cast::<PyBytes>() {
        return Ok(SettingValue::Bytes(value.as_bytes().to_vec()));
    }
    if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
        let items = value.try_iter()?.collect::<PyResult<Vec<_>>>()?;
        if items.is_empty() {
            return Ok(SettingValue::Integers(Vec::new()));
        }
        if items.iter().all(|item| item.is_instance_of::<PyBool>()) {
            return Ok(SettingValue::Bools(value.extract()?));
        }
        if items.iter().all(|item| item.is_instance_of::<PyString>()) {
            return Ok(SettingValue::Texts(value.extract()?));
        }
        if items.iter().all(|item| item.is_instance_of::<PyInt>()) {
            return Ok(SettingValue::Integers(value.extract()?));
        }
        if let Ok(values) = value.extract() {
            return Ok(SettingValue::Doubles(values));
        }
    }
    Err(PyTypeError::new_err(format!(
        "a setting holds a bool, an int, a float, a str, bytes, or a list of one of them, not {}",
        value.get_type().name()?
    )))
}

fn scalar(value: &Bound<'_, PyAny>) -> PyResult<Option<SettingValue>> {
    // A bool is an int too.
    Ok(Some(if value.is_instance_of::<PyBool>() {
        SettingValue::Bool(value.extract()?)
    } else if value.is_instance_of::<PyInt>() {
        SettingValue::Integer(value.extract()?)
    } else if value.is_instance_of::<PyFloat>() {
        SettingValue::Double(value.extract()?)
    } else if value.is_instance_of::<PyString>() {
        SettingValue::Text(value.extract()?)
    } else {
        return Ok(None);
    }))
}
