//! Writes values in the wire format.

use super::wire::{WireType, put_bytes, put_delimited, put_tag, put_varint};
use crate::interchange::{Field, Kind, Problem, Schema, Value};

/// Writes a value of the schema's root record.
///
/// # Errors
/// Returns an error if the format cannot represent a time.
pub(crate) fn encode(schema: &Schema, value: &Value<'_>) -> Result<Vec<u8>, Problem> {
    let mut out = Vec::new();
    put_record(&mut out, schema, 0, value)?;
    Ok(out)
}

fn put_record(out: &mut Vec<u8>, schema: &Schema, index: usize, value: &Value<'_>) -> Result<(), Problem> {
    let Value::Record(values) = value else { return Err(mismatch(value)) };
    for (field, value) in schema.records[index].fields.iter().zip(values) {
        put_field(out, schema, field, value).map_err(|problem| problem.in_field(&field.name))?;
    }
    Ok(())
}

fn put_field(out: &mut Vec<u8>, schema: &Schema, field: &Field, value: &Value<'_>) -> Result<(), Problem> {
    match value {
        Value::Absent => Ok(()),
        Value::Packed(bytes) if bytes.is_empty() => Ok(()),
        Value::Packed(bytes) => {
            put_packed(out, field, bytes);
            Ok(())
        }
        Value::List(list) => list.iter().enumerate().try_for_each(|(index, value)| {
            put_element(out, schema, field, value).map_err(|problem| problem.at_index(index))
        }),
        // proto3 omits zeros, unless zero differs from absent.
        _ if !field.is_optional && value.bits() == Some(0) => Ok(()),
        Value::Text(text) if text.is_empty() && !field.is_optional => Ok(()),
        _ => put_element(out, schema, field, value),
    }
}

/// Writes packed numbers: those with a fixed size are the same on the wire as in memory.
fn put_packed(out: &mut Vec<u8>, field: &Field, bytes: &[u8]) {
    match field.kind {
        Kind::UInt8 | Kind::Fixed32 | Kind::Float32 | Kind::Float64 => put_bytes(out, field.number, bytes),
        kind => {
            let width = kind.width().unwrap_or(1);
            let numbers = bytes.chunks_exact(width).map(|bytes| Value::from_packed(kind, bytes));
            let varints = |out: &mut Vec<u8>| {
                for number in numbers {
                    put_varint(out, number.bits().unwrap_or(0));
                }
                Ok::<(), Problem>(())
            };
            // Writing to memory cannot fail.
            let _ = put_delimited(out, field.number, varints);
        }
    }
}

fn put_element(out: &mut Vec<u8>, schema: &Schema, field: &Field, value: &Value<'_>) -> Result<(), Problem> {
    let number = field.number;
    match (field.kind, value) {
        (Kind::Record(index), _) => put_delimited(out, number, |out| put_record(out, schema, index, value)),
        (Kind::Time | Kind::Duration, Value::Moment { sec, nanosec }) => {
            let (seconds, nanos) = well_known(field.kind, *sec, *nanosec);
            put_delimited(out, number, |out| {
                put_nonzero(out, 1, seconds);
                put_nonzero(out, 2, nanos);
                Ok(())
            })
        }
        (Kind::Text { .. } | Kind::WideText { .. }, Value::Text(text)) => {
            put_bytes(out, number, text.as_bytes());
            Ok(())
        }
        (Kind::Fixed32, Value::Unsigned(value)) => {
            put_tag(out, number, WireType::Fixed32);
            out.extend_from_slice(&value.to_le_bytes()[..4]);
            Ok(())
        }
        (Kind::Float32, Value::Float32(value)) => {
            put_tag(out, number, WireType::Fixed32);
            out.extend_from_slice(&value.to_le_bytes());
            Ok(())
        }
        (Kind::Float64, Value::Float64(value)) => {
            put_tag(out, number, WireType::Fixed64);
            out.extend_from_slice(&value.to_le_bytes());
            Ok(())
        }
        (_, Value::Bool(_) | Value::Signed(_) | Value::Unsigned(_)) => {
            put_tag(out, number, WireType::Varint);
            put_varint(out, value.bits().unwrap_or(0));
            Ok(())
        }
        _ => Err(mismatch(value)),
    }
}

/// Seconds and nanoseconds as in the well-known types: nanoseconds of a timestamp are positive, those of a
/// duration have the sign of the seconds.
fn well_known(kind: Kind, sec: i64, nanosec: u32) -> (i64, i64) {
    // ROS 2 permits nanoseconds of a second and more; the well-known types do not.
    let sec = sec.saturating_add(i64::from(nanosec / 1_000_000_000));
    let nanos = i64::from(nanosec % 1_000_000_000);
    if kind == Kind::Duration && sec < 0 && nanos > 0 {
        (sec + 1, nanos - 1_000_000_000)
    } else {
        (sec, nanos)
    }
}

fn put_nonzero(out: &mut Vec<u8>, number: u32, value: i64) {
    if value != 0 {
        put_tag(out, number, WireType::Varint);
        put_varint(out, value as u64);
    }
}

/// A value that does not match its schema, which only a bug can cause.
#[cold]
fn mismatch(value: &Value<'_>) -> Problem {
    Problem::new(format!("the value {value:?} is not of the field's kind"))
}
