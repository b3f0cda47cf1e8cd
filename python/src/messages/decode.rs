//! From bytes to Python objects.

use std::sync::Arc;

use downbeat_msgs::definitions::{Element, Primitive, Shape};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyFloat, PyList, PyString};

use super::buffer::{NumPy, SharedBytes};
use super::cursor::{Cursor, Read, in_field};
use super::message::{HEADER, instance, invalid};
use super::types::{Field, MessageType};

/// Decodes the field that starts at this position of the body.
pub(super) fn field(
    source: &Bound<'_, SharedBytes>,
    of: &MessageType,
    field: &Field,
    start: usize,
) -> PyResult<Py<PyAny>> {
    let body = source.get().bytes.get(HEADER..).unwrap_or_default();
    let mut cursor = Cursor { body, at: start };
    let fail = |problem: String| invalid(of, &in_field(&field.name, &problem));
    let py = source.py();
    match (&field.of.element, field.of.shape) {
        (Element::Message(nested), Shape::Single) => {
            Ok(instance(py, nested, source.clone().unbind(), start)?.into_any().unbind())
        }
        (element, Shape::Single) => scalar(py, element, &mut cursor).map_err(fail),
        (Element::Primitive(primitive), _) => {
            let count = cursor.count(field).map_err(fail)?;
            let (offset, length) = primitives(&mut cursor, *primitive, count).map_err(fail)?;
            NumPy::get(py)?.view(source, *primitive, HEADER + offset, length)
        }
        (element, _) => {
            let count = cursor.count(field).map_err(fail)?;
            let list = PyList::empty(py);
            for index in 0..count {
                let at_index = |problem: String| fail(format!("[{index}] {problem}"));
                let item = match element {
                    Element::Message(nested) => {
                        let start = cursor.at;
                        cursor.skip_message(nested).map_err(at_index)?;
                        instance(py, nested, source.clone().unbind(), start)?.into_any().unbind()
                    }
                    element => scalar(py, element, &mut cursor).map_err(at_index)?,
                };
                list.append(item)?;
            }
            Ok(list.into_any().unbind())
        }
    }
}

/// Decodes all fields of a message whose fields are scalars.
pub(super) fn scalars(
    source: &Bound<'_, SharedBytes>,
    of: &MessageType,
    start: usize,
) -> PyResult<Vec<Option<Py<PyAny>>>> {
    let body = source.get().bytes.get(HEADER..).unwrap_or_default();
    let mut cursor = Cursor { body, at: start };
    let decoded = of.fields.iter().map(|field| {
        scalar(source.py(), &field.of.element, &mut cursor)
            .map(Some)
            .map_err(|problem| invalid(of, &in_field(&field.name, &problem)))
    });
    decoded.collect()
}

/// A number, a truth value, or a text.
fn scalar(py: Python<'_>, element: &Element<Arc<MessageType>>, cursor: &mut Cursor<'_>) -> Read<Py<PyAny>> {
    macro_rules! integer {
        ($of:ty) => {{
            let Ok(integer) = <$of>::from_le_bytes(cursor.number()?).into_pyobject(py);
            integer.into_any().unbind()
        }};
    }
    Ok(match element {
        Element::Primitive(primitive) => match primitive {
            Primitive::Bool => match cursor.bytes(1)?[0] {
                byte @ (0 | 1) => PyBool::new(py, byte == 1).to_owned().into_any().unbind(),
                other => return Err(format!("a bool is 0 or 1, found {other}")),
            },
            Primitive::Float64 => PyFloat::new(py, f64::from_le_bytes(cursor.number()?)).into_any().unbind(),
            Primitive::Float32 => {
                PyFloat::new(py, f32::from_le_bytes(cursor.number()?).into()).into_any().unbind()
            }
            Primitive::Byte | Primitive::Char | Primitive::UInt8 => integer!(u8),
            Primitive::Int8 => integer!(i8),
            Primitive::Int16 => integer!(i16),
            Primitive::UInt16 => integer!(u16),
            Primitive::Int32 => integer!(i32),
            Primitive::UInt32 => integer!(u32),
            Primitive::Int64 => integer!(i64),
            Primitive::UInt64 => integer!(u64),
        },
        Element::String { bound } => PyString::new(py, cursor.text(*bound)?).into_any().unbind(),
        Element::WString { bound } => PyString::new(py, &cursor.wide_text(*bound)?).into_any().unbind(),
        Element::Message(_) => return Err("a message is no scalar".to_owned()), // Not reached: see the callers.
    })
}

/// The position and the length of numbers in the body.
fn primitives(cursor: &mut Cursor<'_>, primitive: Primitive, count: usize) -> Read<(usize, usize)> {
    if count == 0 {
        return Ok((0, 0)); // No padding either.
    }
    cursor.align(primitive.size());
    let start = cursor.at;
    let bytes = cursor.bytes(count.saturating_mul(primitive.size()))?;
    if primitive == Primitive::Bool
        && let Some(other) = bytes.iter().find(|byte| **byte > 1)
    {
        return Err(format!("a bool is 0 or 1, found {other}"));
    }
    Ok((start, bytes.len()))
}
