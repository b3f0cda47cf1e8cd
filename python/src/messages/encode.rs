//! From Python objects to bytes. What was not touched since it was received is copied as bytes.

use std::sync::Arc;

use downbeat_msgs::definitions::{Element, Primitive, Shape};
use pyo3::prelude::*;
use pyo3::types::PyList;

use super::buffer::with_values;
use super::convert::{self, Converted, Problem, check_count, check_text, text_of};
use super::cursor::{Cursor, Read};
use super::message::{HEADER, Message, invalid};
use super::types::{Field, MessageType};

/// The serialised form of a message.
pub(super) fn to_cdr(message: &Bound<'_, Message>) -> PyResult<Vec<u8>> {
    let mut out = Out(vec![0, 1, 0, 0]);
    let of = Arc::clone(&message.try_borrow()?.of);
    put_message(&mut out, message).map_err(|problem| problem.of(&of.name))?;
    Ok(out.0)
}

/// A message being written.
struct Out(Vec<u8>);

impl Out {
    fn position(&self) -> usize {
        self.0.len() - HEADER
    }

    fn align(&mut self, alignment: usize) {
        let padding = self.position().wrapping_neg() & (alignment - 1);
        self.0.resize(self.0.len() + padding, 0);
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.0.extend_from_slice(bytes);
    }

    fn length(&mut self, length: usize) -> Converted<()> {
        self.align(4);
        let length = u32::try_from(length)
            .map_err(|_| Problem::value(format!("has {length} elements, but lengths in CDR have 32 bits")))?;
        self.bytes(&length.to_le_bytes());
        Ok(())
    }
}

fn put_message(out: &mut Out, message: &Bound<'_, Message>) -> Converted<()> {
    let this = message.try_borrow().map_err(PyErr::from)?;
    let fail = |problem: String| Problem::from(invalid(&this.of, &problem));
    let mut cursor = this.cursor();
    if this.is_untouched() {
        return copy_message(out, &mut cursor, &this.of).map_err(fail);
    }
    if this.of.fields.is_empty() {
        out.bytes(&[0]);
    }
    for (index, field) in this.of.fields.iter().enumerate() {
        match this.slot(index) {
            Some(value) => {
                put_field(out, field, value.bind(message.py()))
                    .map_err(|problem| problem.in_field(&field.name))?;
                if this.has_untouched_after(index) {
                    cursor.skip(field).map_err(fail)?;
                }
            }
            None => copy_field(out, &mut cursor, field).map_err(fail)?,
        }
    }
    Ok(())
}

fn put_field(out: &mut Out, field: &Field, value: &Bound<'_, PyAny>) -> Converted<()> {
    match (&field.of.element, field.of.shape) {
        (element, Shape::Single) => put_element(out, element, value),
        (Element::Primitive(primitive), shape) => {
            let written = with_values(value, *primitive, |bytes| {
                let count = bytes.len() / primitive.size();
                check_count(field, count)?;
                if !matches!(shape, Shape::Array(_)) {
                    out.length(count)?;
                }
                if count > 0 {
                    out.align(primitive.size());
                    if *primitive == Primitive::Bool {
                        out.0.extend(bytes.iter().map(|byte| u8::from(*byte != 0)));
                    } else {
                        out.bytes(bytes);
                    }
                }
                Ok(())
            });
            // An array whose shape or type was changed in place.
            written.unwrap_or_else(|| {
                let array = convert::to_field(value.py(), field, value)?;
                put_field(out, field, array.bind(value.py()))
            })
        }
        (element, shape) => {
            let list = value.cast::<PyList>().map_err(PyErr::from)?;
            check_count(field, list.len())?;
            if !matches!(shape, Shape::Array(_)) {
                out.length(list.len())?;
            }
            for (index, item) in list.iter().enumerate() {
                put_element(out, element, &item).map_err(|problem| problem.at_index(index))?;
            }
            Ok(())
        }
    }
}

fn put_element(
    out: &mut Out,
    element: &Element<Arc<MessageType>>,
    value: &Bound<'_, PyAny>,
) -> Converted<()> {
    match element {
        Element::Primitive(primitive) => {
            out.align(primitive.size());
            convert::put(&mut out.0, *primitive, value)
        }
        Element::String { bound } => {
            let text = text_of(value)?;
            check_text(*bound, text.len())?;
            out.length(text.len() + 1)?;
            out.bytes(text.as_bytes());
            out.bytes(&[0]);
            Ok(())
        }
        Element::WString { bound } => {
            let units: Vec<u16> = text_of(value)?.encode_utf16().collect();
            check_text(*bound, units.len())?;
            out.length(units.len())?;
            units.iter().for_each(|unit| out.bytes(&u32::from(*unit).to_le_bytes()));
            Ok(())
        }
        Element::Message(nested) => put_message(out, &convert::to_message(value.py(), nested, value)?),
    }
}

/// Copies a message that was not touched.
fn copy_message(out: &mut Out, cursor: &mut Cursor<'_>, of: &Arc<MessageType>) -> Read<()> {
    let start = cursor.at;
    if start % 8 == out.position() % 8 {
        // The padding is the same.
        cursor.skip_message(of)?;
        out.bytes(cursor.body.get(start..cursor.at).unwrap_or_default());
        return Ok(());
    }
    if of.fields.is_empty() {
        cursor.bytes(1)?;
        out.bytes(&[0]);
    }
    of.fields.iter().try_for_each(|field| copy_field(out, cursor, field))
}

fn copy_field(out: &mut Out, cursor: &mut Cursor<'_>, field: &Field) -> Read<()> {
    let count = cursor.count(field)?;
    let length = |out: &mut Out, length: usize| {
        out.align(4);
        // Read from 32 bits.
        out.bytes(&(length as u32).to_le_bytes());
    };
    if matches!(field.of.shape, Shape::Bounded(_) | Shape::Sequence) {
        length(out, count);
    }
    if count == 0 {
        return Ok(());
    }
    match &field.of.element {
        Element::Primitive(primitive) => {
            cursor.align(primitive.size());
            out.align(primitive.size());
            out.bytes(cursor.bytes(count.saturating_mul(primitive.size()))?);
            Ok(())
        }
        Element::String { .. } => (0..count).try_for_each(|_| {
            let size = cursor.length(1)?;
            length(out, size);
            out.bytes(cursor.bytes(size)?);
            Ok(())
        }),
        Element::WString { .. } => (0..count).try_for_each(|_| {
            let size = cursor.length(4)?;
            length(out, size);
            out.bytes(cursor.bytes(size * 4)?);
            Ok(())
        }),
        Element::Message(nested) => (0..count).try_for_each(|_| copy_message(out, cursor, nested)),
    }
}
