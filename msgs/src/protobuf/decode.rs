//! Reads values from the wire format.

use std::borrow::Cow;

use super::wire::{Content, Fields};
use crate::interchange::{Budget, Field, Kind, Problem, Schema, Shape, Value};

/// Reads a value of the schema's root record. As the format specifies, fields may be in any order, unknown
/// fields are skipped, and the last occurrence of a repeated field is used (messages are merged).
///
/// # Errors
/// Returns an error if the bytes are not a valid message.
pub(crate) fn decode<'a>(schema: &Schema, bytes: &'a [u8]) -> Result<Value<'a>, Problem> {
    let mut budget = Budget::for_input(bytes.len());
    let mut value = Value::zero(schema, Kind::Record(0), &mut budget)?;
    // Lists start empty, even those of a fixed length: their elements are counted at the end.
    Merger { schema, budget }.merge(0, bytes, 0, &mut value)?;
    Ok(value)
}

struct Merger<'s> {
    schema: &'s Schema,
    budget: Budget,
}

impl Merger<'_> {
    /// Merges the fields of a record into its current value.
    fn merge<'a>(
        &mut self,
        record: usize,
        bytes: &'a [u8],
        origin: usize,
        value: &mut Value<'a>,
    ) -> Result<(), Problem> {
        let schema = self.schema;
        let known = &schema.records[record].fields;
        let Value::Record(values) = value else { return Err(Problem::new("not a record")) };
        // The number of elements read so far of fixed-length lists, whose other elements are zero.
        let mut counts = vec![0_usize; known.len()];
        self.budget.spend(size_of::<usize>() * known.len())?;
        let mut fields = Fields::new(bytes, origin);
        while let Some(part) = fields.next()? {
            let Some(index) = known.iter().position(|field| field.number == part.number) else { continue };
            let field = &known[index];
            let result = if field.is_list() {
                self.read_elements(field, part.content, part.offset, &mut values[index], &mut counts[index])
            } else {
                self.read_one(field.kind, part.content, part.offset, &mut values[index])
            };
            result.map_err(|problem| problem.in_field(&field.name))?;
        }
        for (field, &count) in known.iter().zip(&counts) {
            // An array without elements on the wire is all zeros.
            if count > 0 {
                field.check_count(count).map_err(|problem| problem.in_field(&field.name))?;
            }
        }
        Ok(())
    }

    fn read_elements<'a>(
        &mut self,
        field: &Field,
        content: Content<'a>,
        offset: usize,
        list: &mut Value<'a>,
        count: &mut usize,
    ) -> Result<(), Problem> {
        if *count == 0 && matches!(field.shape, Shape::Array(_)) {
            // Replaces the zeros.
            *list = if field.kind.width().is_some() {
                Value::Packed(Cow::Borrowed(&[]))
            } else {
                Value::List(Vec::new())
            };
        }
        match list {
            Value::Packed(packed) => {
                self.read_packed(field, content, offset, packed)?;
                *count = packed.len() / field.kind.width().unwrap_or(1);
            }
            Value::List(list) => {
                let index = list.len();
                let mut element = Value::zero(self.schema, field.kind, &mut self.budget)?;
                self.budget.spend(size_of::<Value<'_>>())?;
                self.read_one(field.kind, content, offset, &mut element)
                    .map_err(|problem| problem.at_index(index))?;
                list.push(element);
                *count = list.len();
            }
            _ => return Err(Problem::at(offset, "not a list")),
        }
        Ok(())
    }

    fn read_packed<'a>(
        &mut self,
        field: &Field,
        content: Content<'a>,
        offset: usize,
        packed: &mut Cow<'a, [u8]>,
    ) -> Result<(), Problem> {
        let width = field.kind.width().unwrap_or(1);
        match (field.kind, content) {
            // A `bytes` field is the whole list: a later one replaces it.
            (Kind::UInt8, Content::Delimited(bytes)) => *packed = Cow::Borrowed(bytes),
            (Kind::Fixed32 | Kind::Float32 | Kind::Float64, Content::Delimited(bytes)) => {
                if bytes.len() % width != 0 {
                    let text = format!("{} bytes are not a list of numbers of {width} bytes", bytes.len());
                    return Err(Problem::at(offset, text));
                }
                if packed.is_empty() {
                    *packed = Cow::Borrowed(bytes);
                } else {
                    self.budget.spend(bytes.len())?;
                    packed.to_mut().extend_from_slice(bytes);
                }
            }
            (_, Content::Delimited(bytes)) => {
                let packed = packed.to_mut();
                let mut numbers = Fields::new(bytes, offset);
                while let Some((number, offset)) = numbers.next_varint()? {
                    self.budget.spend(width)?;
                    let value = number_of(field.kind, Content::Varint(number), offset)?;
                    packed.extend_from_slice(&value.bits().unwrap_or(0).to_le_bytes()[..width]);
                }
            }
            // A single number: writers of unpacked lists send each separately.
            _ => {
                self.budget.spend(width)?;
                let value = number_of(field.kind, content, offset)?;
                packed.to_mut().extend_from_slice(&value.bits().unwrap_or(0).to_le_bytes()[..width]);
            }
        }
        Ok(())
    }

    fn read_one<'a>(
        &mut self,
        kind: Kind,
        content: Content<'a>,
        offset: usize,
        value: &mut Value<'a>,
    ) -> Result<(), Problem> {
        match (kind, content) {
            (Kind::Record(index), Content::Delimited(bytes)) => {
                if *value == Value::Absent {
                    *value = Value::zero(self.schema, kind, &mut self.budget)?;
                }
                self.merge(index, bytes, offset, value)?;
            }
            (Kind::Time | Kind::Duration, Content::Delimited(bytes)) => {
                *value = moment(bytes, offset, value)?;
            }
            (Kind::Text { .. } | Kind::WideText { .. }, Content::Delimited(bytes)) => {
                let text = std::str::from_utf8(bytes).map_err(|error| {
                    let valid = error.valid_up_to();
                    Problem::at(offset, format!("the string is not UTF-8 after its first {valid} bytes"))
                })?;
                *value = Value::Text(Cow::Borrowed(text));
            }
            _ => *value = number_of(kind, content, offset)?,
        }
        Ok(())
    }
}

/// Merges a timestamp or duration into its current value.
fn moment(bytes: &[u8], origin: usize, known: &Value<'_>) -> Result<Value<'static>, Problem> {
    let (mut seconds, mut nanos) = match known {
        Value::Moment { sec, nanosec } => (*sec, i64::from(*nanosec)),
        _ => (0, 0),
    };
    let mut fields = Fields::new(bytes, origin);
    while let Some(part) = fields.next()? {
        match (part.number, part.content) {
            (1, Content::Varint(value)) => seconds = value as i64,
            (2, Content::Varint(value)) => nanos = i64::from(value as i32),
            (1 | 2, _) => return Err(Problem::at(part.offset, "seconds and nanoseconds are varints")),
            _ => {}
        }
    }
    let (carry, nanosec) = (nanos.div_euclid(1_000_000_000), nanos.rem_euclid(1_000_000_000) as u32); // Below 10^9.
    Ok(Value::Moment { sec: seconds.saturating_add(carry), nanosec })
}

fn number_of(kind: Kind, content: Content<'_>, offset: usize) -> Result<Value<'static>, Problem> {
    let varint = match (kind, content) {
        (Kind::Float32, Content::Fixed32(bytes)) => return Ok(Value::Float32(f32::from_le_bytes(bytes))),
        (Kind::Fixed32, Content::Fixed32(bytes)) => {
            return Ok(Value::Unsigned(u32::from_le_bytes(bytes).into()));
        }
        (Kind::Float64, Content::Fixed64(bytes)) => return Ok(Value::Float64(f64::from_le_bytes(bytes))),
        (Kind::Float32 | Kind::Fixed32 | Kind::Float64, _) => {
            return Err(wrong_wire_type(kind, content, offset));
        }
        (_, Content::Varint(value)) => value,
        _ => return Err(wrong_wire_type(kind, content, offset)),
    };
    // As the format specifies, numbers that do not fit into 32 bits are truncated.
    let integer = match kind {
        Kind::Bool => return Ok(Value::Bool(varint != 0)),
        Kind::Int64 => i128::from(varint as i64),
        Kind::UInt64 => i128::from(varint),
        Kind::Int8 | Kind::Int16 | Kind::Int32 | Kind::Enumeration(_) => i128::from(varint as i32),
        Kind::UInt8 | Kind::UInt16 | Kind::UInt32 => i128::from(varint as u32),
        _ => return Err(wrong_wire_type(kind, content, offset)),
    };
    Value::integer(kind, integer)
        .ok_or_else(|| Problem::at(offset, format!("{integer} is out of the range of {kind:?}")))
}

#[cold]
fn wrong_wire_type(kind: Kind, content: Content<'_>, offset: usize) -> Problem {
    let found = match content {
        Content::Varint(_) => "a varint",
        Content::Fixed64(_) => "eight bytes",
        Content::Fixed32(_) => "four bytes",
        Content::Delimited(_) => "bytes with a length",
    };
    Problem::at(offset, format!("{found} is not a valid encoding of {kind:?}"))
}
