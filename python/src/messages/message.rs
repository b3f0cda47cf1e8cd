//! The base of all message classes, and the classes themselves, which are created on first use.

use std::cell::Cell;
use std::sync::Arc;

use bytes::Bytes;
use downbeat_msgs::definitions::{Element, Shape, Value, nearest};
use pyo3::exceptions::{PyAttributeError, PyTypeError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::{PyBytes, PyDict, PyList, PyString, PyTuple, PyType};

use super::buffer::{NumPy, SharedBytes, with_bytes};
use super::convert::{self, Converted};
use super::cursor::{Cursor, Read};
use super::types::{self, MessageType};
use super::{decode, encode};

/// The size of the header of serialised messages.
pub(super) const HEADER: usize = 4;

/// A message. Fields are decoded from bytes when they are read for the first time, and kept.
#[pyclass(subclass, module = "downbeat._core")]
pub(crate) struct Message {
    pub(super) of: Arc<MessageType>,
    /// A received message, or the defaults of the type.
    source: Py<SharedBytes>,
    /// Where the message starts in the body of the source.
    start: usize,
    /// The last field whose start was needed, and where it starts.
    known: (usize, usize),
    /// The fields that were read or set; empty if none was.
    slots: Vec<Option<Py<PyAny>>>,
}

/// The type of a class, in its attribute `_type`.
#[pyclass(frozen, module = "downbeat._core")]
pub(super) struct TypeHandle(pub(super) Arc<MessageType>);

/// A field of a class, which reads it from messages.
#[pyclass(frozen, module = "downbeat._core", name = "Field")]
pub(super) struct FieldReader {
    of: Arc<MessageType>,
    index: usize,
}

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
        if let Some(next) = NEXT.take() {
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
            message.set_all(py, fields).map_err(|problem| problem.of(&of.name))?;
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
        let index = of.field(name).ok_or_else(|| no_field(&of, name))?;
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

    pub(super) fn set_all(&mut self, py: Python<'_>, fields: &Bound<'_, PyDict>) -> Converted<()> {
        for (name, value) in fields {
            let name = name.cast_into::<PyString>().map_err(PyErr::from)?;
            let index = self.of.field(&name).ok_or_else(|| no_field(&self.of, &name))?;
            let field = &self.of.fields[index];
            let value =
                convert::to_field(py, field, &value).map_err(|problem| problem.in_field(&field.name))?;
            self.put(index, value);
        }
        Ok(())
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
    fn start_of(&mut self, index: usize) -> Read<usize> {
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

/// Bytes that are not a message of the type.
#[cold]
pub(super) fn invalid(of: &MessageType, problem: &str) -> PyErr {
    PyValueError::new_err(format!("the bytes are not a {}: {problem}", of.name))
}

#[cold]
fn no_field(of: &MessageType, name: &Bound<'_, PyString>) -> PyErr {
    let name = name.to_string_lossy();
    let names = || of.fields.iter().map(|field| field.name.as_str());
    let hint = match nearest(&name, names()) {
        Some(known) => format!(", did you mean '{known}'?"),
        None if of.fields.is_empty() => ", it has no fields at all".to_owned(),
        None => format!(", its fields are {}", names().collect::<Vec<_>>().join(", ")),
    };
    PyAttributeError::new_err(format!("{} has no field '{name}'{hint}", of.name))
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
