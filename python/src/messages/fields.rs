//! Reads fields of messages: each is decoded when it is read for the first time.

use std::sync::Arc;

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;

use super::decode;
use super::message::{FieldReader, Message, invalid};
use super::types::MessageType;

#[pymethods]
impl FieldReader {
    fn __get__(
        slf: &Bound<'_, Self>,
        instance: &Bound<'_, PyAny>,
        _owner: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Py<PyAny>> {
        if instance.is_none() {
            return Ok(slf.clone().into_any().unbind());
        }
        let Self { of, index } = slf.get();
        let message = instance.cast::<Message>()?;
        get_of(message, *index, Some(of))
    }

    fn __repr__(&self) -> String {
        let field = &self.of.fields[self.index];
        format!("<field {} {} of {}>", field.declared, field.name, self.of.name)
    }
}

/// The value of a field, which is decoded when it is read for the first time.
pub(super) fn get(message: &Bound<'_, Message>, index: usize) -> PyResult<Py<PyAny>> {
    get_of(message, index, None)
}

/// Like [`get`], if the message is of this type.
fn get_of(
    message: &Bound<'_, Message>,
    index: usize,
    expected: Option<&Arc<MessageType>>,
) -> PyResult<Py<PyAny>> {
    let py = message.py();
    let (of, source, start) = {
        let mut this = message.try_borrow_mut()?;
        if let Some(expected) = expected.filter(|expected| !Arc::ptr_eq(expected, &this.of)) {
            return Err(PyTypeError::new_err(format!("this field is one of {}", expected.name)));
        }
        if let Some(value) = this.slot(index) {
            return Ok(value.clone_ref(py));
        }
        let start = if this.of.is_scalars && this.slots.is_empty() {
            None
        } else {
            Some(this.start_of(index).map_err(|problem| invalid(&this.of, &problem))?)
        };
        (Arc::clone(&this.of), this.source.clone_ref(py), start.ok_or(this.start))
    };
    // Not borrowed here: creating objects may run the garbage collector, and with it any code.
    match start {
        Ok(start) => {
            let value = decode::field(source.bind(py), &of, &of.fields[index], start)?;
            message.try_borrow_mut()?.put(index, value.clone_ref(py));
            Ok(value)
        }
        Err(start) => {
            let values = decode::scalars(source.bind(py), &of, start)?;
            let value = values[index].as_ref().map_or_else(|| py.None(), |value| value.clone_ref(py));
            message.try_borrow_mut()?.slots = values;
            Ok(value)
        }
    }
}
