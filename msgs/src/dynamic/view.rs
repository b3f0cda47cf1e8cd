//! Reads single fields from bytes, without reading the others.

use downbeat_msgs_definitions::{Element, FieldType, Primitive, Shape};

use super::message::{Step, field_of, steps};
use super::model::FieldLayout;
use super::wire::{decode_message, decode_value};
use super::{Array, DynamicMessage, DynamicType, FieldError, FieldProblem, Value, ValueRef, fit};
use crate::WString;
use crate::cdr::{self, Cdr, FromReader, Reader};

/// A serialised message whose fields are read in place. Other fields are skipped without validation.
///
/// ```
/// use downbeat_msgs::cdr;
/// use downbeat_msgs::dynamic::{DynamicType, DynamicView};
/// use downbeat_msgs::sensor_msgs::msg::Image;
///
/// let image = Image { height: 480, data: vec![7; 1024], ..Default::default() };
/// let bytes = cdr::to_vec(&image);
/// let of = DynamicType::of::<Image>()?;
///
/// let view = DynamicView::new(&of, &bytes)?;
/// assert_eq!(view.get("height")?.as_u64(), Some(480));
/// let data = view.get("data")?;
/// assert_eq!(data.as_bytes(), Some(&bytes[bytes.len() - 1024..])); // the same memory
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct DynamicView<'a> {
    of: DynamicType,
    /// At its first byte.
    reader: Reader<'a>,
}

/// A field of a [`DynamicView`].
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum ViewValue<'a> {
    /// A number, a boolean, or a wide string.
    Value(Value),
    /// A string.
    Text(&'a str),
    /// A message that has not been read yet.
    Message(DynamicView<'a>),
    /// An array or sequence of which only the length has been read.
    Array(ArrayView<'a>),
}

/// An array or sequence of a [`DynamicView`].
#[derive(Clone, Debug)]
pub struct ArrayView<'a> {
    /// A type of the same layout.
    layout: DynamicType,
    field_type: FieldType,
    nested: usize,
    /// The start of the array: its length, if it has one.
    start: Reader<'a>,
    count: usize,
    /// The content, if elements are single bytes.
    bytes: Option<&'a [u8]>,
}

/// Why a field of a [`DynamicView`] cannot be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ViewError {
    /// There is no such field or element.
    #[error(transparent)]
    Field(Box<FieldError>),
    /// The bytes are not a message of the type.
    #[error(transparent)]
    Cdr(#[from] cdr::Error),
}

impl<'a> DynamicView<'a> {
    /// Reads only the header of a serialised message.
    ///
    /// # Errors
    /// Returns an error if ROS 2 does not use the representation.
    pub fn new(of: &DynamicType, bytes: &'a [u8]) -> cdr::Result<Self> {
        Ok(Self { of: of.clone(), reader: Reader::new(bytes)? })
    }

    /// Its type.
    #[must_use]
    pub fn message_type(&self) -> &DynamicType {
        &self.of
    }

    /// The value of a field, as in `header.stamp.sec` or `points[3].x`.
    ///
    /// # Errors
    /// Returns an error if there is no such field or element, or the bytes up to it are invalid.
    pub fn get(&self, path: &str) -> Result<ViewValue<'a>, ViewError> {
        let fail = |problem: FieldProblem| ViewError::Field(Box::new(problem.of(self.of.name(), path)));
        let mut here = ViewValue::Message(self.clone());
        for step in steps(path).map_err(fail)? {
            here = match (step, here) {
                (Step::Field(name), ViewValue::Message(view)) => {
                    field_of(view.of.message(), name).map_err(fail)?;
                    view.field(name)?
                }
                (Step::Element(index), ViewValue::Array(array)) => {
                    let length = array.count;
                    array.element(index)?.ok_or_else(|| fail(FieldProblem::Index { index, length }))?
                }
                (Step::Field(wanted), other) => {
                    return Err(fail(FieldProblem::NoFields {
                        wanted: wanted.into(),
                        found: other.describe(),
                    }));
                }
                (Step::Element(index), other) => {
                    return Err(fail(FieldProblem::NoElements { index, found: other.describe() }));
                }
            };
        }
        Ok(here)
    }

    /// Reads all of it.
    ///
    /// # Errors
    /// Returns an error if the bytes are not a message of the type.
    pub fn to_message(&self) -> cdr::Result<DynamicMessage> {
        let mut slots = Vec::with_capacity(self.of.message().slots);
        decode_message(&self.of, self.of.index(), &mut self.reader.clone(), &mut slots)?;
        Ok(DynamicMessage { of: self.of.clone(), slots })
    }

    /// Reads the field of that name, which exists.
    fn field(&self, name: &str) -> cdr::Result<ViewValue<'a>> {
        let layout = &self.of;
        let mut reader = self.reader.clone();
        // Only determines the bounds of a delimited message: the fields after this one are not read.
        reader.message(|reader| {
            for field in &layout.message().fields {
                if field.name == name {
                    return read(layout, field, reader).map_err(|error| error.in_field(name));
                }
                skip(layout, field, reader).map_err(|error| error.in_field(&field.name))?;
            }
            reader.empty_message().map(|()| ViewValue::Value(Value::Bool(false)))
        })
    }
}

impl<'a> ViewValue<'a> {
    /// A floating-point number or an integer, as the nearest `f64`.
    #[must_use]
    pub fn as_f64(&self) -> Option<f64> {
        self.scalar().and_then(ValueRef::as_f64)
    }

    /// An integer that an `i64` can hold.
    #[must_use]
    pub fn as_i64(&self) -> Option<i64> {
        self.scalar().and_then(ValueRef::as_i64)
    }

    /// An integer that is not negative.
    #[must_use]
    pub fn as_u64(&self) -> Option<u64> {
        self.scalar().and_then(ValueRef::as_u64)
    }

    /// A boolean.
    #[must_use]
    pub fn as_bool(&self) -> Option<bool> {
        self.scalar().and_then(ValueRef::as_bool)
    }

    /// The text of a string.
    #[must_use]
    pub fn as_str(&self) -> Option<&'a str> {
        match self {
            Self::Text(text) => Some(text),
            _ => None,
        }
    }

    /// The bytes of an array or sequence of `uint8`, `int8`, `char` or `byte`.
    #[must_use]
    pub fn as_bytes(&self) -> Option<&'a [u8]> {
        match self {
            Self::Array(array) => array.bytes,
            _ => None,
        }
    }

    /// A copy to keep.
    ///
    /// # Errors
    /// Returns an error if the bytes are not a valid value.
    pub fn to_value(&self) -> cdr::Result<Value> {
        Ok(match self {
            Self::Value(value) => value.clone(),
            Self::Text(text) => Value::from(*text),
            Self::Message(view) => Value::from(view.to_message()?),
            Self::Array(array) => Value::Array(array.to_array()?),
        })
    }

    fn scalar(&self) -> Option<ValueRef<'_>> {
        match self {
            Self::Value(value) => Some(ValueRef::from(value)),
            _ => None,
        }
    }

    fn describe(&self) -> String {
        match self {
            Self::Value(value) => fit::describe(ValueRef::from(value)),
            Self::Text(text) => fit::describe(ValueRef::String(text)),
            Self::Message(view) => format!("a {}", view.of.name()),
            Self::Array(array) => format!("an array of {} elements", array.count),
        }
    }
}

impl<'a> ArrayView<'a> {
    /// The number of elements.
    #[must_use]
    pub fn len(&self) -> usize {
        self.count
    }

    /// Returns whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Reads all of it.
    ///
    /// # Errors
    /// Returns an error if the bytes are not a valid array.
    pub fn to_array(&self) -> cdr::Result<Array> {
        let field = self.as_field(self.field_type.shape);
        match decode_value(&self.layout, &field, &mut self.start.clone())? {
            Value::Array(array) => Ok(array),
            _ => Ok(Array::Bool(Vec::new())), // Not reached: the shape is that of an array.
        }
    }

    /// The element at an index; `None` if it is out of range.
    fn element(&self, index: usize) -> cdr::Result<Option<ViewValue<'a>>> {
        if index >= self.count {
            return Ok(None);
        }
        let one = self.as_field(Shape::Single);
        let mut reader = self.start.clone();
        let at_index = |error: cdr::Error| error.at_index(index);
        within(&self.field_type, &self.layout, self.nested, &mut reader, |reader, _| {
            match self.field_type.element {
                Element::Primitive(primitive) => {
                    let size = primitive.size();
                    reader.align(size)?;
                    reader.bytes(index * size)?;
                }
                _ => (0..index).try_for_each(|_| skip(&self.layout, &one, reader))?,
            }
            read(&self.layout, &one, reader).map(Some).map_err(at_index)
        })
    }

    /// This field with another shape.
    fn as_field(&self, shape: Shape) -> FieldLayout {
        FieldLayout {
            name: String::new(),
            field_type: FieldType { element: self.field_type.element.clone(), shape },
            slot: 0,
            nested: self.nested,
            default: None,
        }
    }
}

/// Reads a field; for messages and arrays only their position.
fn read<'a>(
    layout: &DynamicType,
    field: &FieldLayout,
    reader: &mut Reader<'a>,
) -> cdr::Result<ViewValue<'a>> {
    let FieldType { element, shape } = &field.field_type;
    match (element, shape) {
        (Element::Message(_), Shape::Single) => {
            Ok(ViewValue::Message(DynamicView { of: layout.nested(field), reader: reader.clone() }))
        }
        (Element::String { .. }, Shape::Single) => <&str>::from_reader(reader).map(ViewValue::Text),
        (_, Shape::Single) => decode_value(layout, field, reader).map(ViewValue::Value),
        _ => {
            let start = reader.clone();
            let of = &field.field_type;
            let (count, bytes) = within(of, layout, field.nested, reader, |reader, count| {
                let bytes = match element {
                    Element::Primitive(primitive)
                        if primitive.size() == 1 && *primitive != Primitive::Bool =>
                    {
                        Some(reader.bytes(count)?)
                    }
                    _ => None,
                };
                Ok((count, bytes))
            })?;
            let (layout, field_type) = (layout.clone(), field.field_type.clone());
            Ok(ViewValue::Array(ArrayView { layout, field_type, nested: field.nested, start, count, bytes }))
        }
    }
}

/// Skips a field.
fn skip(layout: &DynamicType, field: &FieldLayout, reader: &mut Reader<'_>) -> cdr::Result<()> {
    let FieldType { element, shape } = &field.field_type;
    if *shape == Shape::Single {
        return match element {
            Element::Primitive(primitive) => {
                reader.align(primitive.size())?;
                reader.bytes(primitive.size()).map(|_| ())
            }
            Element::String { .. } => {
                let length = reader.length(1)?;
                reader.bytes(length).map(|_| ())
            }
            Element::WString { .. } => WString::decode(reader).map(|_| ()),
            Element::Message(_) => skip_message(layout, field.nested, reader),
        };
    }
    within(&field.field_type, layout, field.nested, reader, |reader, count| match element {
        Element::Primitive(_) if count == 0 => Ok(()), // No padding either.
        Element::Primitive(primitive) => {
            reader.align(primitive.size())?;
            reader.bytes(count.saturating_mul(primitive.size())).map(|_| ())
        }
        Element::Message(_) => (0..count).try_for_each(|_| skip_message(layout, field.nested, reader)),
        Element::WString { .. } => (0..count).try_for_each(|_| WString::decode(reader).map(|_| ())),
        Element::String { .. } => (0..count).try_for_each(|_| {
            let length = reader.length(1)?;
            reader.bytes(length).map(|_| ())
        }),
    })
}

fn skip_message(layout: &DynamicType, index: usize, reader: &mut Reader<'_>) -> cdr::Result<()> {
    let message = layout.layout().message(index);
    reader.message(|reader| {
        if message.fields.is_empty() {
            return reader.empty_message();
        }
        message
            .fields
            .iter()
            .try_for_each(|field| skip(layout, field, reader).map_err(|error| error.in_field(&field.name)))
    })
}

/// Reads what precedes the elements of an array, then its elements with `read`.
fn within<'a, T>(
    field_type: &FieldType,
    layout: &DynamicType,
    nested: usize,
    reader: &mut Reader<'a>,
    read: impl FnOnce(&mut Reader<'a>, usize) -> cdr::Result<T>,
) -> cdr::Result<T> {
    let (are_primitive, least_size) = match &field_type.element {
        Element::Primitive(primitive) => (true, primitive.size()),
        Element::String { .. } | Element::WString { .. } => (false, 4),
        Element::Message(_) => (false, layout.layout().message(nested).least_size),
    };
    reader.elements(are_primitive, |reader| {
        let count = reader.length_of(field_type.shape, least_size)?;
        read(reader, count)
    })
}
