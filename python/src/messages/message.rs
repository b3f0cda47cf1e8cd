//! The base of all message classes, and the classes themselves, which are created on first use. What they can
//! do is in `methods.rs`, how their fields are read in `fields.rs`.

use std::cell::Cell;
use std::sync::Arc;

use downbeat_msgs::definitions::Value;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyTuple, PyType};

use super::buffer::SharedBytes;
use super::cursor::{Cursor, Read};
use super::types::MessageType;

/// The size of the header of serialised messages.
pub(super) const HEADER: usize = 4;

/// A message. Fields are decoded from bytes when they are read for the first time, and kept.
#[pyclass(subclass, module = "downbeat._core")]
pub(crate) struct Message {
    pub(super) of: Arc<MessageType>,
    /// A received message, or the defaults of the type.
    pub(super) source: Py<SharedBytes>,
    /// Where the message starts in the body of the source.
    pub(super) start: usize,
    /// The last field whose start was needed, and where it starts.
    known: (usize, usize),
    /// The fields that were read or set; empty if none was.
    pub(super) slots: Vec<Option<Py<PyAny>>>,
}

/// The type of a class, in its attribute `_type`.
#[pyclass(frozen, module = "downbeat._core")]
pub(super) struct TypeHandle(pub(super) Arc<MessageType>);

/// A field of a class, which reads it from messages.
#[pyclass(frozen, module = "downbeat._core", name = "Field")]
pub(super) struct FieldReader {
    pub(super) of: Arc<MessageType>,
    pub(super) index: usize,
}

impl Message {
    pub(super) fn over(of: Arc<MessageType>, source: Py<SharedBytes>, start: usize) -> Self {
        Self { of, source, start, known: (0, start), slots: Vec::new() }
    }

    /// A message with the same fields, which can be set without changing this one.
    pub(super) fn shallow_copy(&self, py: Python<'_>) -> Self {
        Self {
            of: Arc::clone(&self.of),
            source: self.source.clone_ref(py),
            start: self.start,
            known: self.known,
            slots: self.slots.iter().map(|slot| slot.as_ref().map(|value| value.clone_ref(py))).collect(),
        }
    }

    pub(super) fn put(&mut self, index: usize, value: Py<PyAny>) {
        if self.slots.is_empty() {
            self.slots.resize_with(self.of.fields.len(), || None);
        }
        self.slots[index] = Some(value);
    }

    /// The value of a field that was read or set.
    pub(super) fn slot(&self, index: usize) -> Option<&Py<PyAny>> {
        self.slots.get(index)?.as_ref()
    }

    pub(super) fn is_untouched(&self) -> bool {
        self.slots.is_empty()
    }

    /// Whether a field after this one has to be copied from the source.
    pub(super) fn has_untouched_after(&self, index: usize) -> bool {
        self.slots.iter().skip(index + 1).any(Option::is_none)
    }

    /// The start of the message in its source.
    pub(super) fn cursor(&self) -> Cursor<'_> {
        let body = self.source.get().bytes.get(HEADER..).unwrap_or_default();
        Cursor { body, at: self.start }
    }

    /// Finds where a field starts.
    pub(super) fn start_of(&mut self, index: usize) -> Read<usize> {
        let body = self.source.get().bytes.get(HEADER..).unwrap_or_default();
        // Fields are mostly read in order.
        let (mut field, at) = if index < self.known.0 { (0, self.start) } else { self.known };
        let mut cursor = Cursor { body, at };
        while field < index {
            cursor.skip(&self.of.fields[field])?;
            field += 1;
        }
        self.known = (index, cursor.at);
        Ok(cursor.at)
    }
}

/// Creates an object for a message in a source.
pub(super) fn instance<'py>(
    py: Python<'py>,
    of: &Arc<MessageType>,
    source: Py<SharedBytes>,
    start: usize,
) -> PyResult<Bound<'py, Message>> {
    object(py, Message::over(Arc::clone(of), source, start))
}

/// Creates an object of the class of a message.
pub(super) fn object(py: Python<'_>, message: Message) -> PyResult<Bound<'_, Message>> {
    let of = Arc::clone(&message.of);
    let class = class(py, &of)?;
    NEXT.set(Some(message));
    let object = class.call0();
    NEXT.set(None);
    Ok(object?.cast_into::<Message>()?)
}

thread_local! {
    /// The contents of the object that [`object`] is creating: Python calls the constructor without them.
    static NEXT: Cell<Option<Message>> = const { Cell::new(None) };
}

/// The contents of the object that is being created, if [`object`] creates it.
pub(super) fn next() -> Option<Message> {
    NEXT.take()
}

/// Bytes that are not a message of the type.
#[cold]
pub(super) fn invalid(of: &MessageType, problem: &str) -> PyErr {
    PyValueError::new_err(format!("the bytes are not a {}: {problem}", of.name))
}

/// The type of a class of messages.
///
/// # Errors
/// `TypeError` if it is none.
pub(crate) fn type_of(class: &Bound<'_, PyType>) -> PyResult<Arc<MessageType>> {
    let Ok(handle) = class.getattr(intern!(class.py(), "_type")) else {
        return Err(PyTypeError::new_err(
            "Message is the base of the message classes: use one of them, for example downbeat.msgs.std_msgs.msg.String",
        ));
    };
    Ok(Arc::clone(&handle.cast::<TypeHandle>()?.get().0))
}

/// The class of a type.
pub(super) fn class<'a, 'py>(py: Python<'py>, of: &'a Arc<MessageType>) -> PyResult<&'a Bound<'py, PyType>> {
    Ok(of.class.get_or_try_init(py, || create_class(py, of))?.bind(py))
}

fn create_class(py: Python<'_>, of: &Arc<MessageType>) -> PyResult<Py<PyType>> {
    let name = &of.parsed.name;
    let contents = PyDict::new(py);
    let comment = of.parsed.comment.join("\n");
    contents.set_item("__slots__", PyTuple::empty(py))?;
    contents.set_item("__module__", format!("downbeat.msgs.{}.{}", name.package, name.kind.as_str()))?;
    contents.set_item("__doc__", format!("{}\n\n{comment}", of.name).trim_end())?;
    contents.set_item("TYPE_NAME", &of.name)?;
    contents.set_item("TYPE_HASH", &of.hash)?;
    contents.set_item("DEFINITION", &of.definition)?;
    for constant in &of.parsed.constants {
        contents.set_item(&constant.name, constant_value(py, &constant.value)?)?;
    }
    // What Python adds to some classes: pictures as arrays.
    let methods = py.import("downbeat._methods")?.getattr("METHODS")?;
    if let Ok(methods) = methods.get_item(&of.name) {
        contents.update(methods.cast::<pyo3::types::PyMapping>()?)?;
    }
    for (index, field) in of.fields.iter().enumerate() {
        contents.set_item(&field.key, Py::new(py, FieldReader { of: Arc::clone(of), index })?)?;
    }
    contents.set_item("_type", Py::new(py, TypeHandle(Arc::clone(of)))?)?;
    let bases = PyTuple::new(py, [py.get_type::<Message>()])?;
    let class = py.get_type::<PyType>().call1((&name.name, bases, contents))?;
    Ok(class.cast_into::<PyType>()?.unbind())
}

fn constant_value(py: Python<'_>, value: &Value) -> PyResult<Py<PyAny>> {
    Ok(match value {
        Value::Bool(value) => value.into_pyobject(py)?.to_owned().into_any().unbind(),
        Value::Integer(value) => match i64::try_from(*value) {
            Ok(value) => value.into_pyobject(py)?.into_any().unbind(),
            Err(_) => u64::try_from(*value).unwrap_or(u64::MAX).into_pyobject(py)?.into_any().unbind(),
        },
        Value::Float(value) => value.into_pyobject(py)?.into_any().unbind(),
        Value::Text(text) => text.into_pyobject(py)?.into_any().unbind(),
        Value::List(values) => {
            let values =
                values.iter().map(|value| constant_value(py, value)).collect::<PyResult<Vec<_>>>()?;
            PyList::new(py, values)?.into_any().unbind()
        }
    })
}
