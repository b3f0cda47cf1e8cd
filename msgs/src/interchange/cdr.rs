//! Conversion between CDR and values. Contiguous numbers are borrowed from the input, not copied.

use std::borrow::Cow;

use super::{Field, Kind, Problem, Schema, Shape, Value};
use crate::cdr::{self, Cdr, Endianness, Reader, WString, Writer};

/// Reads the root record of a schema derived from a definition.
///
/// # Errors
/// Returns an error if the bytes are not a valid message.
pub(crate) fn read<'a>(schema: &Schema, bytes: &'a [u8]) -> cdr::Result<Value<'a>> {
    read_record(schema, 0, &mut Reader::new(bytes)?)
}

/// Writes the root record of a schema derived from a definition, little-endian with its header.
///
/// # Errors
/// Returns an error if the value exceeds a bound of the definition. The caller has checked that it matches
/// the schema.
pub(crate) fn write(schema: &Schema, value: &Value<'_>) -> Result<Vec<u8>, Problem> {
    let mut buffer = vec![0, 1, 0, 0];
    write_one(schema, Kind::Record(0), value, &mut Writer::new(&mut buffer))?;
    Ok(buffer)
}

fn read_record<'a>(schema: &Schema, index: usize, reader: &mut Reader<'a>) -> cdr::Result<Value<'a>> {
    let fields = &schema.records[index].fields;
    reader.message(|reader| {
        if fields.is_empty() {
            reader.empty_message()?;
        }
        let values = fields
            .iter()
            .map(|field| read_field(schema, field, reader).map_err(|error| error.in_field(&field.name)));
        Ok(Value::Record(values.collect::<cdr::Result<_>>()?))
    })
}

fn read_field<'a>(schema: &Schema, field: &Field, reader: &mut Reader<'a>) -> cdr::Result<Value<'a>> {
    if !field.is_list() {
        return read_one(schema, field.kind, reader);
    }
    reader.elements(field.kind.width().is_some(), |reader| read_list(schema, field, reader))
}

fn read_list<'a>(schema: &Schema, field: &Field, reader: &mut Reader<'a>) -> cdr::Result<Value<'a>> {
    let count = reader.length_of(field.shape, least_size(schema, field.kind))?;
    match field.kind.width() {
        Some(width) => read_packed(field.kind, width, count, reader),
        None => {
            let mut list = Vec::new();
            for index in 0..count {
                list.push(read_one(schema, field.kind, reader).map_err(|error| error.at_index(index))?);
            }
            Ok(Value::List(list))
        }
    }
}

fn read_packed<'a>(
    kind: Kind,
    width: usize,
    count: usize,
    reader: &mut Reader<'a>,
) -> cdr::Result<Value<'a>> {
    if count == 0 {
        return Ok(Value::Packed(Cow::Borrowed(&[])));
    }
    reader.align(width)?;
    let start = reader.clone();
    let bytes = reader.bytes(count.saturating_mul(width))?;
    if kind == Kind::Bool
        && let Some(&other) = bytes.iter().find(|&&byte| byte > 1)
    {
        return Err(start.error(cdr::Problem::Bool(other)));
    }
    if width == 1 || reader.endianness() == Endianness::Little {
        return Ok(Value::Packed(Cow::Borrowed(bytes)));
    }
    let mut swapped = bytes.to_vec();
    swapped.chunks_exact_mut(width).for_each(<[u8]>::reverse);
    Ok(Value::Packed(Cow::Owned(swapped)))
}

fn read_one<'a>(schema: &Schema, kind: Kind, reader: &mut Reader<'a>) -> cdr::Result<Value<'a>> {
    Ok(match kind {
        Kind::Bool => Value::Bool(bool::decode(reader)?),
        Kind::Int8 => Value::Signed(i8::decode(reader)?.into()),
        Kind::Int16 => Value::Signed(i16::decode(reader)?.into()),
        Kind::Int32 => Value::Signed(i32::decode(reader)?.into()),
        Kind::Int64 => Value::Signed(i64::decode(reader)?),
        Kind::UInt8 | Kind::Enumeration(_) => Value::Unsigned(u8::decode(reader)?.into()),
        Kind::UInt16 => Value::Unsigned(u16::decode(reader)?.into()),
        Kind::UInt32 | Kind::Fixed32 => Value::Unsigned(u32::decode(reader)?.into()),
        Kind::UInt64 => Value::Unsigned(u64::decode(reader)?),
        Kind::Float32 => Value::Float32(f32::decode(reader)?),
        Kind::Float64 => Value::Float64(f64::decode(reader)?),
        Kind::Text { bound } => {
            let text = String::decode(reader)?;
            check_bound(text.len(), bound, reader)?;
            Value::Text(text.into())
        }
        Kind::WideText { bound } => {
            let text = WString::decode(reader)?.0;
            check_bound(text.encode_utf16().count(), bound, reader)?;
            Value::Text(text.into())
        }
        Kind::Time | Kind::Duration => {
            let (sec, nanosec) = (i32::decode(reader)?, u32::decode(reader)?);
            Value::Moment { sec: sec.into(), nanosec }
        }
        Kind::Record(index) => read_record(schema, index, reader)?,
    })
}

fn check_bound(found: usize, bound: Option<usize>, reader: &Reader<'_>) -> cdr::Result<()> {
    match bound {
        Some(bound) if found > bound => Err(reader.error(cdr::Problem::Bound { found, bound })),
        _ => Ok(()),
    }
}

/// The minimum size of an element, without padding.
fn least_size(schema: &Schema, kind: Kind) -> usize {
    match kind {
        Kind::Record(index) => schema.records[index].least_size,
        Kind::Text { .. } | Kind::WideText { .. } => 4,
        _ => kind.width().unwrap_or(8),
    }
}

fn write_field(
    schema: &Schema,
    field: &Field,
    value: &Value<'_>,
    writer: &mut Writer<'_>,
) -> Result<(), Problem> {
    if !field.is_list() {
        return write_one(schema, field.kind, value, writer);
    }
    match value {
        Value::Packed(bytes) => {
            let width = field.kind.width().unwrap_or(1);
            write_length(field, bytes.len() / width, writer)?;
            if !bytes.is_empty() {
                writer.align(width);
                writer.bytes(bytes);
            }
            Ok(())
        }
        Value::List(list) => {
            write_length(field, list.len(), writer)?;
            for (index, value) in list.iter().enumerate() {
                write_one(schema, field.kind, value, writer).map_err(|problem| problem.at_index(index))?;
            }
            Ok(())
        }
        other => Err(mismatch(other)),
    }
}

fn write_length(field: &Field, found: usize, writer: &mut Writer<'_>) -> Result<(), Problem> {
    field.check_count(found)?;
    if matches!(field.shape, Shape::Array(_)) {
        return Ok(());
    }
    check_length(found)?;
    writer.length(found);
    Ok(())
}

/// CDR lengths have 32 bits, and the length of a string includes its terminator.
fn check_length(found: usize) -> Result<(), Problem> {
    if u32::try_from(found).is_ok_and(|found| found < u32::MAX) {
        return Ok(());
    }
    Err(Problem::new(format!("has {found} elements, but lengths in CDR have 32 bits")))
}

fn write_one(schema: &Schema, kind: Kind, value: &Value<'_>, writer: &mut Writer<'_>) -> Result<(), Problem> {
    match (kind, value) {
        (Kind::Text { bound } | Kind::WideText { bound }, Value::Text(text)) => {
            let is_wide = matches!(kind, Kind::WideText { .. });
            let length = if is_wide { text.encode_utf16().count() } else { text.len() };
            if let Some(bound) = bound.filter(|&bound| length > bound) {
                return Err(Problem::new(format!("has the length {length}, the type allows {bound}")));
            }
            check_length(length)?;
            if is_wide {
                writer.value(&WString(text.to_string()));
            } else {
                writer.length(text.len() + 1);
                writer.bytes(text.as_bytes());
                writer.bytes(&[0]);
            }
        }
        (Kind::Time | Kind::Duration, Value::Moment { sec, nanosec }) => {
            let Ok(sec) = i32::try_from(*sec) else {
                return Err(Problem::new(format!("{sec} s do not fit the 32 bits of ROS 2")));
            };
            writer.value(&sec);
            writer.value(nanosec);
        }
        (Kind::Record(index), Value::Record(values)) => {
            let fields = &schema.records[index].fields;
            if fields.is_empty() {
                writer.empty_message();
            }
            for (field, value) in fields.iter().zip(values) {
                write_field(schema, field, value, writer).map_err(|problem| problem.in_field(&field.name))?;
            }
        }
        (_, value) => {
            let (Some(width), Some(bits)) = (kind.width(), value.bits()) else { return Err(mismatch(value)) };
            writer.align(width);
            writer.bytes(&bits.to_le_bytes()[..width]);
        }
    }
    Ok(())
}

/// A value that does not match its schema, which only a bug in a format's reader can cause.
#[cold]
fn mismatch(value: &Value<'_>) -> Problem {
    Problem::new(format!("the value {value:?} is not of the field's kind"))
}
