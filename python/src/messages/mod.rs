//! Message classes, and their conversion from and to CDR.
//!
//! A [`Message`] is a view of bytes: those that were received, or the defaults of its type. A field is
//! decoded when it is read for the first time and then belongs to the message, as does what is assigned; the
//! bytes never change. When the message is serialised, what was neither read nor set is copied.
//!
//! Bytes are CDR with the header of four bytes, as everywhere in downbeat.

mod buffer;
mod convert;
mod cursor;
mod decode;
mod encode;
mod fields;
mod message;
mod methods;
mod types;

use std::path::PathBuf;
use std::sync::Arc;

use bytes::Bytes;
use downbeat_msgs::definitions::{Element, Shape};
use downbeat_msgs::dynamic::DynamicMessage;
use pyo3::exceptions::PyTypeError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyType};

use buffer::SharedBytes;
pub(crate) use convert::ros_name;
pub(crate) use message::{Message, type_of};
pub(crate) use types::{MessageType, described_type, interface, learn, message_type, search};

/// Creates a message from its serialised form. The bytes are kept, not copied, unless they are in another
/// representation than plain little-endian CDR, which ROS 2 writes. Fields are decoded when they are read.
///
/// # Errors
/// `ValueError` if the bytes have no valid header, or are in another representation and not a message of the
/// type.
pub(crate) fn from_cdr(py: Python<'_>, of: &Arc<MessageType>, bytes: Bytes) -> PyResult<Py<PyAny>> {
    let bytes = if bytes.starts_with(&[0, 1]) && bytes.len() >= message::HEADER {
        bytes
    } else {
        let decoded = DynamicMessage::from_cdr(&of.dynamic, &bytes);
        decoded.map_err(|error| message::invalid(of, &error.to_string()))?.to_cdr().into()
    };
    let source = Py::new(py, SharedBytes { bytes, is_default: false })?;
    Ok(message::instance(py, of, source, 0)?.into_any().unbind())
}

/// Serialises a message: `message`, of ours, of rclpy, or a mapping of fields, or else one with the defaults;
/// with `fields` set on a copy of it.
///
/// # Errors
/// `TypeError` if the message is one of another type, or a field does not accept its value, `ValueError` if a
/// value is out of range, `AttributeError` for an unknown field.
pub(crate) fn to_cdr(
    py: Python<'_>,
    of: &Arc<MessageType>,
    message: Option<&Bound<'_, PyAny>>,
    fields: Option<&Bound<'_, PyDict>>,
) -> PyResult<Vec<u8>> {
    let message = match message {
        Some(message) => convert::to_message(py, of, message).map_err(|problem| problem.of(&of.name))?,
        None => message::instance(py, of, of.defaults(py)?, 0)?,
    };
    let Some(fields) = fields.filter(|fields| !fields.is_empty()) else { return encode::to_cdr(&message) };
    let mut changed = message.try_borrow()?.shallow_copy(py);
    convert::set_all(&mut changed, py, fields).map_err(|problem| problem.of(&of.name))?;
    encode::to_cdr(&message::object(py, changed)?)
}

/// The class of the messages of a type, by its name as in `sensor_msgs/msg/Imu`.
#[pyfunction]
fn message_class(py: Python<'_>, name: &str) -> PyResult<Py<PyType>> {
    Ok(message::class(py, &message_type(py, name)?)?.clone().unbind())
}

/// The type of a message of ours or of rclpy.
///
/// # Errors
/// `TypeError` if the object is none, `KeyError` if the definition of a message of rclpy is not known.
pub(crate) fn type_of_message(message: &Bound<'_, PyAny>) -> PyResult<Arc<MessageType>> {
    if let Ok(message) = message.cast::<Message>() {
        return Ok(Arc::clone(&message.try_borrow()?.of));
    }
    if !message.hasattr(intern!(message.py(), "get_fields_and_field_types"))? {
        let class = message.get_type().name()?;
        return Err(PyTypeError::new_err(format!(
            "expected a message of downbeat.msgs or of rclpy, got {class}"
        )));
    }
    message_type(message.py(), &convert::ros_name(&message.get_type())?)
}

/// The class of the messages of a type.
pub(crate) fn class_of(py: Python<'_>, of: &Arc<MessageType>) -> PyResult<Py<PyType>> {
    Ok(message::class(py, of)?.clone().unbind())
}

/// Adds the interfaces in a folder, and returns how many files it has: an ament prefix, a folder of packages,
/// or a package.
#[pyfunction]
fn search_interfaces(path: PathBuf) -> PyResult<usize> {
    search(&path)
}

/// The known packages.
#[pyfunction]
fn interface_packages() -> Vec<String> {
    types::packages()
}

/// The known interfaces of a package, as kinds (`msg`, `srv`, `action`) and names.
#[pyfunction]
fn interfaces(package: &str) -> Vec<(&'static str, String)> {
    types::interfaces(package).into_iter().map(|name| (name.kind.as_str(), name.name)).collect()
}

/// Name, type of an element (a primitive, `string`, or the name of a message), whether there are several,
/// type in the definition, comment.
type DescribedField = (String, String, bool, String, String);

/// The fields of a type, for stubs.
#[pyfunction]
fn describe_fields(py: Python<'_>, name: &str) -> PyResult<Vec<DescribedField>> {
    let of = message_type(py, name)?;
    let described = of.fields.iter().zip(&of.parsed.fields).map(|(field, parsed)| {
        let element = match &field.of.element {
            Element::Primitive(primitive) => primitive.as_str().to_owned(),
            Element::String { .. } | Element::WString { .. } => "string".to_owned(),
            Element::Message(nested) => nested.name.clone(),
        };
        let is_several = field.of.shape != Shape::Single;
        (field.name.clone(), element, is_several, field.declared.clone(), parsed.comment.join("\n"))
    });
    Ok(described.collect())
}

/// The names of the constants of a type.
#[pyfunction]
fn constant_names(py: Python<'_>, name: &str) -> PyResult<Vec<String>> {
    let of = message_type(py, name)?;
    Ok(of.parsed.constants.iter().map(|constant| constant.name.clone()).collect())
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Message>()?;
    module.add_function(wrap_pyfunction!(message_class, module)?)?;
    module.add_function(wrap_pyfunction!(search_interfaces, module)?)?;
    module.add_function(wrap_pyfunction!(interface_packages, module)?)?;
    module.add_function(wrap_pyfunction!(interfaces, module)?)?;
    module.add_function(wrap_pyfunction!(describe_fields, module)?)?;
    module.add_function(wrap_pyfunction!(constant_names, module)?)?;
    Ok(())
}
