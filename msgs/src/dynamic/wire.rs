//! CDR of messages whose type is known only at run time: the same bytes as for structs with the same
//! definition.

use downbeat_msgs_definitions::{Element, FieldType, Shape};

use super::model::{FieldLayout, Layout, Messages};
use super::{Array, ConvertError, DynamicMessage, DynamicType, TypeError, Value};
use crate::cdr::{self, Cdr, Problem, Reader, Text, Writer};
use crate::{Message, WString};

impl DynamicMessage {
    /// Reads a message from its serialised form, including the header, in either byte order. Bytes after it
    /// are ignored.
    ///
    /// Memory is proportional to the input: at most 32 bytes per byte, or 1 KiB per byte for pathologically
    /// nested arrays of messages.
    ///
    /// # Errors
    /// See [`cdr::from_slice`].
    pub fn from_cdr(of: &DynamicType, bytes: &[u8]) -> cdr::Result<Self> {
        let mut reader = Reader::new(bytes)?;
        let mut slots = Vec::with_capacity(of.message().slots);
        decode_message(of, of.index(), &mut reader, &mut slots)?;
        Ok(Self { of: of.clone(), slots })
    }

    /// The serialised form: header and body, little-endian.
    ///
    /// # Panics
    /// See [`cdr::to_vec`].
    #[must_use]
    pub fn to_cdr(&self) -> Vec<u8> {
        let mut buffer = Vec::new();
        self.to_cdr_buffer(&mut buffer);
        buffer
    }

    /// Like [`DynamicMessage::to_cdr`], into a buffer whose memory is reused. Its previous contents are
    /// discarded.
    ///
    /// # Panics
    /// See [`cdr::to_vec`].
    pub fn to_cdr_buffer(&self, buffer: &mut Vec<u8>) {
        buffer.clear();
        buffer.extend_from_slice(&[0, 1, 0, 0]);
        encode_message(self.of.layout(), self.of.index(), &self.slots, &mut Writer::new(buffer));
    }

    /// Converts a struct, through its serialised form.
    ///
    /// # Errors
    /// Returns an error if the types differ.
    pub fn from_typed<T: Message>(of: &DynamicType, message: &T) -> Result<Self, ConvertError> {
        same_type::<T>(of)?;
        Self::from_cdr(of, &cdr::to_vec(message))
            .map_err(|problem| ConvertError::Cdr { name: T::TYPE_NAME, problem })
    }

    /// Converts to a struct, through its serialised form.
    ///
    /// ```
    /// use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
    /// use downbeat_msgs::std_msgs::msg::Header;
    ///
    /// let mut header = DynamicMessage::new(&DynamicType::of::<Header>()?);
    /// header.set("frame_id", "body")?;
    /// assert_eq!(header.to_typed::<Header>()?.frame_id, "body");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// Returns an error if the types differ.
    pub fn to_typed<T: Message>(&self) -> Result<T, ConvertError> {
        same_type::<T>(&self.of)?;
        cdr::from_slice(&self.to_cdr()).map_err(|problem| ConvertError::Cdr { name: T::TYPE_NAME, problem })
    }
}

impl DynamicType {
    /// The type of a struct.
    ///
    /// # Errors
    /// Returns an error if the definition of the struct is too large: see [`DynamicType::new`].
    pub fn of<T: Message>() -> Result<Self, TypeError> {
        Self::from_definition_text(T::TYPE_NAME, "ros2msg", T::DEFINITION)
    }
}

fn same_type<T: Message>(of: &DynamicType) -> Result<(), ConvertError> {
    let dynamic = of.name().to_string();
    if dynamic == T::TYPE_NAME { Ok(()) } else { Err(ConvertError::Type { dynamic, typed: T::TYPE_NAME }) }
}

pub(super) fn decode_message(
    layout: &DynamicType,
    index: usize,
    reader: &mut Reader<'_>,
    slots: &mut Vec<Value>,
) -> cdr::Result<()> {
    let message = layout.layout().message(index);
    reader.message(|reader| {
        if message.fields.is_empty() {
            return reader.empty_message();
        }
        for field in &message.fields {
            let result = if field.is_one_message() {
                decode_message(layout, field.nested, reader, slots)
            } else {
                decode_value(layout, field, reader).map(|value| slots.push(value))
            };
            result.map_err(|error| error.in_field(&field.name))?;
        }
        Ok(())
    })
}

pub(super) fn decode_value(
    layout: &DynamicType,
    field: &FieldLayout,
    reader: &mut Reader<'_>,
) -> cdr::Result<Value> {
    let FieldType { element, shape } = &field.field_type;
    if *shape == Shape::Single {
        return match element {
            Element::Primitive(primitive) => {
                each_primitive!(primitive, T => T::decode(reader).map(Value::from))
            }
            Element::WString { bound } => text(WString::decode(reader)?, *bound, reader).map(Value::WString),
            Element::String { bound } => text(String::decode(reader)?, *bound, reader).map(Value::String),
            // Not reached: a single message is not a slot.
            Element::Message(_) => decode_messages(layout, field, reader).map(Value::Array),
        };
    }
    let are_primitive = matches!(element, Element::Primitive(_));
    reader.elements(are_primitive, |reader| decode_array(layout, field, reader)).map(Value::Array)
}

fn decode_array(layout: &DynamicType, field: &FieldLayout, reader: &mut Reader<'_>) -> cdr::Result<Array> {
    let FieldType { element, shape } = &field.field_type;
    Ok(match element {
        Element::Primitive(primitive) => each_primitive!(primitive, T => {
            let count = reader.length_of(*shape, T::LEAST_SIZE)?;
            Array::from(T::decode_vec(count, reader)?)
        }),
        Element::String { bound } => {
            let count = reader.length_of(*shape, String::LEAST_SIZE)?;
            Array::String(text(String::decode_vec(count, reader)?, *bound, reader)?)
        }
        Element::WString { bound } => {
            let count = reader.length_of(*shape, WString::LEAST_SIZE)?;
            Array::WString(text(WString::decode_vec(count, reader)?, *bound, reader)?)
        }
        Element::Message(_) => decode_messages(layout, field, reader)?,
    })
}

fn decode_messages(layout: &DynamicType, field: &FieldLayout, reader: &mut Reader<'_>) -> cdr::Result<Array> {
    let nested = layout.layout().message(field.nested);
    let count = reader.length_of(field.field_type.shape, nested.least_size)?;
    // A slot takes at least a byte of the input, so this is proportional to it.
    let mut slots = Vec::with_capacity(count * nested.slots);
    for element in 0..count {
        decode_message(layout, field.nested, reader, &mut slots).map_err(|error| error.at_index(element))?;
    }
    Ok(Array::Message(Messages { of: layout.nested(field), count, slots }))
}

/// Checks strings against their bound.
fn text<T: Text>(value: T, bound: Option<u64>, reader: &Reader<'_>) -> cdr::Result<T> {
    let Some(bound) = bound else { return Ok(value) };
    let bound = usize::try_from(bound).unwrap_or(usize::MAX);
    match value.longest() {
        found if found > bound => Err(reader.error(Problem::Bound { found, bound })),
        _ => Ok(value),
    }
}

fn encode_message(layout: &Layout, index: usize, slots: &[Value], writer: &mut Writer<'_>) {
    let message = layout.message(index);
    if message.fields.is_empty() {
        writer.empty_message();
    }
    for field in &message.fields {
        if field.is_one_message() {
            let count = layout.message(field.nested).slots;
            encode_message(layout, field.nested, &slots[field.slot..field.slot + count], writer);
        } else {
            encode_value(field.field_type.shape, &slots[field.slot], writer);
        }
    }
}

fn encode_value(shape: Shape, value: &Value, writer: &mut Writer<'_>) {
    match value {
        Value::Bool(value) => writer.value(value),
        Value::Int8(value) => writer.value(value),
        Value::UInt8(value) => writer.value(value),
        Value::Int16(value) => writer.value(value),
        Value::UInt16(value) => writer.value(value),
        Value::Int32(value) => writer.value(value),
        Value::UInt32(value) => writer.value(value),
        Value::Int64(value) => writer.value(value),
        Value::UInt64(value) => writer.value(value),
        Value::Float32(value) => writer.value(value),
        Value::Float64(value) => writer.value(value),
        Value::String(text) => writer.value(text),
        Value::WString(text) => writer.value(text),
        Value::Message(message) => {
            encode_message(message.of.layout(), message.of.index(), &message.slots, writer);
        }
        Value::Array(array) => {
            if !matches!(shape, Shape::Array(_)) {
                writer.length(array.len());
            }
            encode_array(array, writer);
        }
    }
}

fn encode_array(array: &Array, writer: &mut Writer<'_>) {
    match array {
        Array::Bool(values) => Cdr::encode_slice(values, writer),
        Array::Int8(values) => Cdr::encode_slice(values, writer),
        Array::UInt8(values) => Cdr::encode_slice(values, writer),
        Array::Int16(values) => Cdr::encode_slice(values, writer),
        Array::UInt16(values) => Cdr::encode_slice(values, writer),
        Array::Int32(values) => Cdr::encode_slice(values, writer),
        Array::UInt32(values) => Cdr::encode_slice(values, writer),
        Array::Int64(values) => Cdr::encode_slice(values, writer),
        Array::UInt64(values) => Cdr::encode_slice(values, writer),
        Array::Float32(values) => Cdr::encode_slice(values, writer),
        Array::Float64(values) => Cdr::encode_slice(values, writer),
        Array::String(values) => Cdr::encode_slice(values, writer),
        Array::WString(values) => Cdr::encode_slice(values, writer),
        Array::Message(messages) => {
            for message in (0..messages.len()).filter_map(|index| messages.get(index)) {
                encode_message(messages.of.layout(), messages.of.index(), message.slots(), writer);
            }
        }
    }
}
