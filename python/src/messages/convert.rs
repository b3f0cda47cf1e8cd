//! What may be assigned to a field, and what the field holds then.
//!
//! | field | accepted | held |
//! | --- | --- | --- |
//! | `bool` | `bool`, also of NumPy | `bool` |
//! | integers | what has `__index__`, in range; for `byte` also `bytes` of length 1 | `int` |
//! | `float32`, `float64` | numbers | `float`, rounded to the precision of the field |
//! | strings | `str` | `str` |
//! | numbers, several | arrays of NumPy and other buffers, sequences of numbers | an array of NumPy; one that fits is not copied |
//! | strings, several | sequences of `str` | a new list |
//! | a message | ours or rclpy's of that type, a mapping of its fields | a message of ours; one of ours is not copied |
//! | messages, several | sequences of these | a new list |

use std::sync::Arc;

use downbeat_msgs::definitions::{Element, Primitive, Shape, nearest};
use pyo3::exceptions::{PyAttributeError, PyTypeError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{
    PyBool, PyBytes, PyDict, PyFloat, PyInt, PyList, PyMapping, PySet, PyString, PyTuple, PyType,
};

use super::buffer::{NumPy, dtype, with_values};
use super::message::{self, Message};
use super::types::{Field, MessageType};

/// Why a value cannot be assigned.
pub(super) struct Problem {
    kind: Kind,
    path: String,
    text: String,
}

enum Kind {
    Type,
    Value,
    /// An exception of other code.
    Raised(PyErr),
}

pub(super) type Converted<T> = Result<T, Problem>;

impl Problem {
    #[cold]
    fn expected(what: &str, found: &Bound<'_, PyAny>) -> Self {
        Self {
            kind: Kind::Type,
            path: String::new(),
            text: format!("expected {what}, got {}", describe(found)),
        }
    }

    #[cold]
    pub(super) fn value(text: String) -> Self {
        Self { kind: Kind::Value, path: String::new(), text }
    }

    #[cold]
    pub(super) fn in_field(mut self, name: &str) -> Self {
        let separator = if self.path.is_empty() || self.path.starts_with('[') { "" } else { "." };
        self.path = format!("{name}{separator}{}", self.path);
        self
    }

    #[cold]
    pub(super) fn at_index(self, index: usize) -> Self {
        self.in_field(&format!("[{index}]"))
    }

    /// The exception for a message of this type.
    #[cold]
    pub(super) fn of(self, name: &str) -> PyErr {
        let Self { kind, path, text } = self;
        let text =
            if path.is_empty() { format!("{name}: {text}") } else { format!("{name}, field {path}: {text}") };
        match kind {
            Kind::Type => PyTypeError::new_err(text),
            Kind::Value => PyValueError::new_err(text),
            Kind::Raised(error) => error,
        }
    }
}

impl From<PyErr> for Problem {
    fn from(error: PyErr) -> Self {
        Self { kind: Kind::Raised(error), path: String::new(), text: String::new() }
    }
}

/// Converts a value to what a field holds.
pub(super) fn to_field(py: Python<'_>, field: &Field, value: &Bound<'_, PyAny>) -> Converted<Py<PyAny>> {
    match (&field.of.element, field.of.shape) {
        (element, Shape::Single) => to_element(py, element, value),
        (Element::Primitive(primitive), _) => to_array(py, field, *primitive, value),
        (element, _) => {
            let items = items(field, value)?;
            check_count(field, items.len())?;
            for (index, item) in items.iter().enumerate() {
                let converted = to_element(py, element, &item).map_err(|problem| problem.at_index(index))?;
                items.set_item(index, converted)?;
            }
            Ok(items.into_any().unbind())
        }
    }
}

fn to_element(
    py: Python<'_>,
    element: &Element<Arc<MessageType>>,
    value: &Bound<'_, PyAny>,
) -> Converted<Py<PyAny>> {
    match element {
        Element::Primitive(Primitive::Bool) => {
            Ok(PyBool::new(py, to_bool(value)?).to_owned().into_any().unbind())
        }
        Element::Primitive(primitive @ (Primitive::Float32 | Primitive::Float64)) => {
            let number = to_float(*primitive, value)?;
            let is_same = *primitive == Primitive::Float64 && value.is_exact_instance_of::<PyFloat>();
            Ok(if is_same { value.clone().unbind() } else { PyFloat::new(py, number).into_any().unbind() })
        }
        Element::Primitive(primitive) => {
            let number = to_integer(*primitive, value)?;
            if value.is_exact_instance_of::<PyInt>() {
                return Ok(value.clone().unbind());
            }
            let Ok(number) = match u64::try_from(number) {
                Ok(number) => number.into_pyobject(py),
                Err(_) => i64::try_from(number).unwrap_or(i64::MIN).into_pyobject(py),
            };
            Ok(number.into_any().unbind())
        }
        Element::String { bound } => {
            check_text(*bound, text_of(value)?.len())?;
            Ok(value.clone().unbind())
        }
        Element::WString { bound } => {
            check_text(*bound, text_of(value)?.encode_utf16().count())?;
            Ok(value.clone().unbind())
        }
        Element::Message(nested) => Ok(to_message(py, nested, value)?.into_any().unbind()),
    }
}

pub(super) fn to_bool(value: &Bound<'_, PyAny>) -> Converted<bool> {
    if let Ok(value) = value.cast::<PyBool>() {
        return Ok(value.is_true());
    }
    let is_numpy = value.get_type().name().is_ok_and(|name| name == "bool_" || name == "bool");
    if is_numpy { Ok(value.is_truthy()?) } else { Err(Problem::expected("bool", value)) }
}

pub(super) fn to_float(primitive: Primitive, value: &Bound<'_, PyAny>) -> Converted<f64> {
    let Ok(number) = value.extract::<f64>() else { return Err(Problem::expected(primitive.as_str(), value)) };
    if primitive == Primitive::Float64 {
        return Ok(number);
    }
    let rounded = f64::from(number as f32);
    if rounded.is_infinite() && number.is_finite() {
        return Err(Problem::value(format!("{number:?} is out of the range of float32")));
    }
    Ok(rounded)
}

pub(super) fn to_integer(primitive: Primitive, value: &Bound<'_, PyAny>) -> Converted<i128> {
    let number: i128 = match value.extract::<i64>() {
        Ok(number) => number.into(),
        Err(_) => match (value.extract::<u64>(), value.cast::<PyBytes>()) {
            (Ok(number), _) => number.into(),
            (_, Ok(bytes)) if primitive == Primitive::Byte && bytes.as_bytes().len() == 1 => {
                bytes.as_bytes()[0].into()
            }
            _ if value.hasattr("__index__")? => return Err(out_of_range(primitive, value)),
            _ => return Err(Problem::expected(primitive.as_str(), value)),
        },
    };
    match primitive.range() {
        Some((least, most)) if (least..=most).contains(&number) => Ok(number),
        _ => Err(out_of_range(primitive, value)),
    }
}

#[cold]
fn out_of_range(primitive: Primitive, value: &Bound<'_, PyAny>) -> Problem {
    let (least, most) = primitive.range().unwrap_or_default();
    Problem::value(format!(
        "{} is out of the range of {}, {least} to {most}",
        text(value),
        primitive.as_str()
    ))
}

pub(super) fn text_of<'a>(value: &'a Bound<'_, PyAny>) -> Converted<std::borrow::Cow<'a, str>> {
    let text = value.cast::<PyString>().map_err(|_| Problem::expected("str", value))?;
    text.to_cow().map_err(|_| Problem::value(format!("{} is no valid Unicode", text_repr(value))))
}

pub(super) fn check_text(bound: Option<u64>, length: usize) -> Converted<()> {
    match bound {
        Some(bound) if length as u64 > bound => {
            Err(Problem::value(format!("has the length {length}, its type allows {bound}")))
        }
        _ => Ok(()),
    }
}

pub(super) fn check_count(field: &Field, found: usize) -> Converted<()> {
    match field.of.shape {
        Shape::Array(count) if found as u64 != count => {
            Err(Problem::value(format!("{} needs exactly {count} elements, got {found}", field.declared)))
        }
        Shape::Bounded(bound) if found as u64 > bound => {
            Err(Problem::value(format!("{} takes at most {bound} elements, got {found}", field.declared)))
        }
        _ => Ok(()),
    }
}

/// The elements of a sequence, as a new list.
fn items<'py>(field: &Field, value: &Bound<'py, PyAny>) -> Converted<Bound<'py, PyList>> {
    let py = value.py();
    if let Ok(list) = value.cast::<PyList>() {
        return Ok(list.get_slice(0, list.len()));
    }
    if let Ok(tuple) = value.cast::<PyTuple>() {
        return Ok(tuple.to_list());
    }
    // Neither are those of a text single texts, nor do those of a set have an order.
    let is_other = value.is_instance_of::<PyString>()
        || value.is_instance_of::<PyBytes>()
        || value.is_instance_of::<PySet>()
        || value.is_instance_of::<PyDict>();
    let items = if is_other { None } else { value.try_iter().ok() };
    let Some(items) = items else { return Err(Problem::expected(&field.declared, value)) };
    let list = PyList::empty(py);
    for item in items {
        list.append(item?)?;
    }
    Ok(list)
}

fn to_array(
    py: Python<'_>,
    field: &Field,
    primitive: Primitive,
    value: &Bound<'_, PyAny>,
) -> Converted<Py<PyAny>> {
    let numpy = NumPy::get(py)?;
    let is_list = value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>();
    if !is_list {
        let is_array = value.get_type().is(&numpy.ndarray);
        // The values in memory are those of the field.
        let plain = with_values(value, primitive, |bytes| {
            let count = bytes.len() / primitive.size();
            (count, if is_array { None } else { Some(numpy.copy(py, primitive, bytes)) })
        });
        if let Some((count, copy)) = plain {
            check_count(field, count)?;
            return Ok(copy.transpose()?.unwrap_or_else(|| value.clone().unbind()));
        }
        if is_array {
            return cast_array(py, field, primitive, value);
        }
    }
    let items = items(field, value)?;
    check_count(field, items.len())?;
    let mut bytes = Vec::with_capacity(items.len() * primitive.size());
    for (index, item) in items.iter().enumerate() {
        put(&mut bytes, primitive, &item).map_err(|problem| problem.at_index(index))?;
    }
    Ok(numpy.copy(py, primitive, &bytes)?)
}

/// Appends a number without padding.
pub(super) fn put(bytes: &mut Vec<u8>, primitive: Primitive, value: &Bound<'_, PyAny>) -> Converted<()> {
    match primitive {
        Primitive::Bool => bytes.push(to_bool(value)?.into()),
        Primitive::Float32 => bytes.extend_from_slice(&(to_float(primitive, value)? as f32).to_le_bytes()),
        Primitive::Float64 => bytes.extend_from_slice(&to_float(primitive, value)?.to_le_bytes()),
        // In two's complement the lower bytes are the number.
        _ => bytes.extend_from_slice(&to_integer(primitive, value)?.to_le_bytes()[..primitive.size()]),
    }
    Ok(())
}

/// An array of another type or with more dimensions, row by row.
fn cast_array(
    py: Python<'_>,
    field: &Field,
    primitive: Primitive,
    value: &Bound<'_, PyAny>,
) -> Converted<Py<PyAny>> {
    let numpy = NumPy::get(py)?;
    let kind: String = value.getattr(intern!(py, "dtype"))?.getattr(intern!(py, "kind"))?.extract()?;
    let accepted = match primitive {
        Primitive::Bool => "b",
        Primitive::Float32 | Primitive::Float64 => "fiu",
        _ => "iu",
    };
    if !accepted.contains(&kind) {
        let found = value.getattr(intern!(py, "dtype"))?;
        return Err(Problem {
            kind: Kind::Type,
            path: String::new(),
            text: format!("expected {}, got an array of {found}", field.declared),
        });
    }
    let flat = value.call_method1(intern!(py, "reshape"), (-1,))?;
    if let Some((least, most)) = primitive.range()
        && flat.len()? > 0
    {
        let extremes = [flat.call_method0(intern!(py, "min"))?, flat.call_method0(intern!(py, "max"))?];
        for extreme in extremes {
            let number: i128 =
                extreme.call_method0(intern!(py, "item"))?.extract::<i64>().map_or(i128::MAX, i128::from);
            if number != i128::MAX && !(least..=most).contains(&number)
                || number == i128::MAX && primitive != Primitive::UInt64
            {
                return Err(out_of_range(primitive, &extreme));
            }
        }
    }
    let cast =
        numpy.asarray.bind(py).call1((flat.call_method1(intern!(py, "astype"), (dtype(primitive),))?,))?;
    check_count(field, cast.len()?)?;
    Ok(cast.unbind())
}

/// Converts to a message of ours: one of this type is returned as it is.
pub(super) fn to_message<'py>(
    py: Python<'py>,
    of: &Arc<MessageType>,
    value: &Bound<'py, PyAny>,
) -> Converted<Bound<'py, Message>> {
    if let Ok(ours) = value.cast::<Message>() {
        let other = &ours.try_borrow().map_err(PyErr::from)?.of;
        if Arc::ptr_eq(other, of) {
            return Ok(ours.clone());
        }
        let text = if other.name == of.name {
            format!(
                "expected {}, got one of another definition (hash {} instead of {})",
                of.name, other.hash, of.hash
            )
        } else {
            format!("expected {}, got {}", of.name, other.name)
        };
        return Err(Problem { kind: Kind::Type, path: String::new(), text });
    }
    let is_ros = value.hasattr(intern!(py, "get_fields_and_field_types"))?;
    let fields = if is_ros {
        let name = ros_name(&value.get_type())?;
        if name != of.name {
            return Err(Problem {
                kind: Kind::Type,
                path: String::new(),
                text: format!("expected {}, got {name}", of.name),
            });
        }
        let fields = PyDict::new(py);
        for field in &of.fields {
            fields.set_item(&field.key, value.getattr(&field.key)?)?;
        }
        fields
    } else if let Ok(mapping) = value.cast::<PyMapping>() {
        let fields = PyDict::new(py);
        fields.update(mapping)?;
        fields
    } else {
        return Err(Problem::expected(&of.name, value));
    };
    let mut filled = Message::over(Arc::clone(of), of.defaults(py)?, 0);
    set_all(&mut filled, py, &fields)?;
    Ok(message::object(py, filled)?)
}

/// Sets fields of a message.
pub(super) fn set_all(message: &mut Message, py: Python<'_>, fields: &Bound<'_, PyDict>) -> Converted<()> {
    for (name, value) in fields {
        let name = name.cast_into::<PyString>().map_err(PyErr::from)?;
        let index = message.of.field(&name).ok_or_else(|| no_field(&message.of, &name))?;
        let field = &message.of.fields[index];
        let value = to_field(py, field, &value).map_err(|problem| problem.in_field(&field.name))?;
        message.put(index, value);
    }
    Ok(())
}

/// The error for a name that is no field of a type.
#[cold]
pub(super) fn no_field(of: &MessageType, name: &Bound<'_, PyString>) -> PyErr {
    let name = name.to_string_lossy();
    let names = || of.fields.iter().map(|field| field.name.as_str());
    let hint = match nearest(&name, names()) {
        Some(known) => format!(", did you mean '{known}'?"),
        None if of.fields.is_empty() => ", it has no fields at all".to_owned(),
        None => format!(", its fields are {}", names().collect::<Vec<_>>().join(", ")),
    };
    PyAttributeError::new_err(format!("{} has no field '{name}'{hint}", of.name))
}

/// The name of the type of a class of rclpy: that of `std_msgs.msg._header`, `Header`.
pub(crate) fn ros_name(class: &Bound<'_, PyType>) -> PyResult<String> {
    let module: String = class.getattr(intern!(class.py(), "__module__"))?.extract()?;
    let mut parts = module.split('.');
    let (package, kind) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
    Ok(format!("{package}/{kind}/{}", class.name()?))
}

fn describe(value: &Bound<'_, PyAny>) -> String {
    let name = value.get_type().name().map_or_else(|_| "an object".to_owned(), |name| name.to_string());
    if value.is_none() { name } else { format!("{name} {}", text_repr(value)) }
}

fn text(value: &Bound<'_, PyAny>) -> String {
    value.str().map_or_else(|_| "the value".to_owned(), |text| text.to_string_lossy().into_owned())
}

fn text_repr(value: &Bound<'_, PyAny>) -> String {
    const LONGEST: usize = 60;
    let text = value.repr().map_or_else(|_| String::new(), |text| text.to_string_lossy().into_owned());
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}
