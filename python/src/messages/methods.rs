//! The methods of messages.

use std::sync::Arc;

use bytes::Bytes;
use downbeat_msgs::definitions::{Element, Shape};
use pyo3::exceptions::PyTypeError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::{PyBytes, PyDict, PyString, PyTuple, PyType};

use super::buffer::{NumPy, with_bytes};
use super::fields::get;
use super::message::{self, Message, type_of};
use super::{convert, encode, types};

#[pymethods]
impl Message {
    #[new]
    #[classmethod]
    #[pyo3(signature = (*args, **fields))]
    fn new(
        class: &Bound<'_, PyType>,
        args: &Bound<'_, PyTuple>,
        fields: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        if let Some(next) = message::next() {
            return Ok(next);
        }
        let py = class.py();
        let of = type_of(class)?;
        if !args.is_empty() {
            return Err(PyTypeError::new_err(format!(
                "{} takes its fields by name, as in {}({}=...)",
                of.name,
                of.parsed.name.name,
                of.fields.first().map_or("field", |field| &field.name)
            )));
        }
        let mut message = Self::over(Arc::clone(&of), of.defaults(py)?, 0);
        if let Some(fields) = fields {
            convert::set_all(&mut message, py, fields).map_err(|problem| problem.of(&of.name))?;
        }
        Ok(message)
    }

    /// Reads a message from its serialised form, CDR with its header of four bytes, without a copy if `data`
    /// is `bytes`.
    #[classmethod]
    fn from_cdr(class: &Bound<'_, PyType>, data: &Bound<'_, PyAny>) -> PyResult<Py<PyAny>> {
        let bytes = match data.extract::<PyBackedBytes>() {
            Ok(bytes) => Bytes::from_owner(bytes),
            Err(_) => with_bytes(data, Bytes::copy_from_slice)?,
        };
        super::from_cdr(class.py(), &type_of(class)?, bytes)
    }

    /// The serialised form: CDR, little-endian, with its header of four bytes.
    fn to_cdr<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(slf.py(), &encode::to_cdr(slf)?))
    }

    /// The names of the fields and their types in the words of rosidl, as in rclpy.
    #[classmethod]
    fn get_fields_and_field_types<'py>(class: &Bound<'py, PyType>) -> PyResult<Bound<'py, PyDict>> {
        let types = PyDict::new(class.py());
        for field in &type_of(class)?.fields {
            types.set_item(&field.name, types::rosidl_name(field))?;
        }
        Ok(types)
    }

    fn __setattr__(
        slf: &Bound<'_, Self>,
        name: &Bound<'_, PyString>,
        value: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let of = Arc::clone(&slf.try_borrow()?.of);
        let index = of.field(name).ok_or_else(|| convert::no_field(&of, name))?;
        let field = &of.fields[index];
        let value = convert::to_field(slf.py(), field, value)
            .map_err(|problem| problem.in_field(&field.name).of(&of.name))?;
        slf.try_borrow_mut()?.put(index, value);
        Ok(())
    }

    fn __repr__(slf: &Bound<'_, Self>) -> PyResult<String> {
        let of = Arc::clone(&slf.try_borrow()?.of);
        let mut fields = Vec::with_capacity(of.fields.len());
        for (index, field) in of.fields.iter().enumerate() {
            fields.push(format!("{}={}", field.name, get(slf, index)?.bind(slf.py()).repr()?));
        }
        Ok(format!("{}({})", of.name.replace('/', "."), fields.join(", ")))
    }

    /// Compares the fields; a message of rclpy counts as one of ours.
    fn __eq__(slf: &Bound<'_, Self>, other: &Bound<'_, PyAny>) -> PyResult<bool> {
        let py = slf.py();
        let of = Arc::clone(&slf.try_borrow()?.of);
        let Ok(other) = convert::to_message(py, &of, other) else { return Ok(false) };
        let numpy = NumPy::get(py)?;
        for (index, field) in of.fields.iter().enumerate() {
            let (ours, theirs) = (get(slf, index)?, get(&other, index)?);
            let is_array =
                matches!(field.of.element, Element::Primitive(_)) && field.of.shape != Shape::Single;
            let is_same = if is_array {
                numpy.array_equal.bind(py).call1((ours, theirs))?.is_truthy()?
            } else {
                ours.bind(py).eq(theirs)?
            };
            if !is_same {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// For `copy` and `pickle`: a copy of all of it.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        Ok((slf.get_type().getattr(intern!(slf.py(), "from_cdr"))?, (Self::to_cdr(slf)?,)))
    }
}
