//! Reads values from FlatBuffers. The input is not trusted: every offset is checked, and the memory of values
//! is counted, since several offsets may lead to the same table.

use std::borrow::Cow;

use crate::interchange::{Budget, Field, Kind, Problem, Schema, Value};

/// Reads a value of the schema's root record.
///
/// # Errors
/// Returns an error if the bytes are not a valid buffer.
pub(crate) fn decode<'a>(schema: &Schema, bytes: &'a [u8]) -> Result<Value<'a>, Problem> {
    let mut reader = Reader { schema, bytes, budget: Budget::for_input(bytes.len()) };
    let root = reader.follow(0)?;
    reader.record(0, root)
}

struct Reader<'s, 'a> {
    schema: &'s Schema,
    bytes: &'a [u8],
    budget: Budget,
}

impl<'a> Reader<'_, 'a> {
    /// Reads the table at an offset.
    fn record(&mut self, index: usize, table: usize) -> Result<Value<'a>, Problem> {
        let schema = self.schema;
        let back = i32::from_le_bytes(self.array(table)?);
        // A vtable may be before or after its table.
        let vtable = i64::try_from(table).unwrap_or(i64::MAX).checked_sub(i64::from(back));
        let Some(vtable) = vtable.and_then(|vtable| usize::try_from(vtable).ok()) else {
            return Err(Problem::at(
                table,
                format!("the offset {back} to the vtable leads out of the buffer"),
            ));
        };
        let vtable_size = usize::from(u16::from_le_bytes(self.array(vtable)?));
        let fields = &schema.records[index].fields;
        self.budget.spend(size_of::<Value<'_>>() * fields.len())?;
        let mut values = Vec::with_capacity(fields.len());
        for field in fields {
            let entry = 4 + 2 * usize::from(field.id);
            let place = if entry + 2 > vtable_size {
                0
            } else {
                usize::from(u16::from_le_bytes(self.array(vtable.saturating_add(entry))?))
            };
            let value = match place {
                0 => self.absent(field),
                place => self.field(field, table.saturating_add(place)),
            };
            values.push(value.map_err(|problem| problem.in_field(&field.name))?);
        }
        Ok(Value::Record(values))
    }

    fn absent(&mut self, field: &Field) -> Result<Value<'a>, Problem> {
        if field.kind == Kind::Float64 && !field.is_list() && !field.is_optional {
            return Ok(Value::Float64(field.default));
        }
        Value::absent(self.schema, field, &mut self.budget)
    }

    fn field(&mut self, field: &Field, slot: usize) -> Result<Value<'a>, Problem> {
        if field.is_list() {
            let vector = self.follow(slot)?;
            let value = self.vector(field.kind, vector)?;
            let found = match &value {
                Value::Packed(bytes) => bytes.len() / field.kind.width().unwrap_or(1),
                Value::List(values) => values.len(),
                _ => 0,
            };
            field.check_count(found)?;
            return Ok(value);
        }
        match field.kind {
            Kind::Text { .. } | Kind::WideText { .. } | Kind::Record(_) => self.element(field.kind, slot),
            Kind::Time | Kind::Duration => {
                let [sec, nanos] = [self.array(slot)?, self.array(slot.saturating_add(4))?];
                let sec = match field.kind {
                    Kind::Time => i64::from(u32::from_le_bytes(sec)),
                    _ => i64::from(i32::from_le_bytes(sec)),
                };
                let nanos = i64::from(i32::from_le_bytes(nanos));
                let nanosec = nanos.rem_euclid(1_000_000_000) as u32; // Below 10^9.
                Ok(Value::Moment { sec: sec + nanos.div_euclid(1_000_000_000), nanosec })
            }
            kind => {
                let width = kind.width().unwrap_or(8);
                let value = Value::from_packed(kind, self.slice(slot, width)?);
                Ok(value)
            }
        }
    }

    fn vector(&mut self, kind: Kind, vector: usize) -> Result<Value<'a>, Problem> {
        let length = u32::from_le_bytes(self.array(vector)?) as usize;
        let first = vector.saturating_add(4);
        match kind.width() {
            Some(width) => {
                let bytes = self.slice(first, length.saturating_mul(width))?;
                // A boolean is any byte here, but 0 or 1 in CDR.
                let is_plain = kind != Kind::Bool || bytes.iter().all(|&byte| byte <= 1);
                Ok(Value::Packed(if is_plain {
                    Cow::Borrowed(bytes)
                } else {
                    bytes.iter().map(|&byte| u8::from(byte != 0)).collect()
                }))
            }
            None => {
                self.slice(first, length.saturating_mul(4))?;
                let mut values = Vec::new();
                for index in 0..length {
                    self.budget.spend(size_of::<Value<'_>>())?;
                    let value = self.element(kind, first + 4 * index);
                    values.push(value.map_err(|problem| problem.at_index(index))?);
                }
                Ok(Value::List(values))
            }
        }
    }

    /// Reads the string or table to which the offset at a position points.
    fn element(&mut self, kind: Kind, slot: usize) -> Result<Value<'a>, Problem> {
        let target = self.follow(slot)?;
        match kind {
            Kind::Record(index) => self.record(index, target),
            _ => {
                let length = u32::from_le_bytes(self.array(target)?) as usize;
                let bytes = self.slice(target.saturating_add(4), length)?;
                let text = std::str::from_utf8(bytes).map_err(|error| {
                    let valid = error.valid_up_to();
                    Problem::at(target, format!("the string is not UTF-8 after its first {valid} bytes"))
                })?;
                Ok(Value::Text(Cow::Borrowed(text)))
            }
        }
    }

    fn follow(&self, slot: usize) -> Result<usize, Problem> {
        let offset = u32::from_le_bytes(self.array(slot)?) as usize;
        Ok(slot.saturating_add(offset))
    }

    fn array<const N: usize>(&self, place: usize) -> Result<[u8; N], Problem> {
        let mut array = [0; N];
        array.copy_from_slice(self.slice(place, N)?);
        Ok(array)
    }

    fn slice(&self, place: usize, count: usize) -> Result<&'a [u8], Problem> {
        let end = place.saturating_add(count);
        self.bytes.get(place..end).ok_or_else(|| {
            Problem::at(place, format!("needs {count} bytes here, the buffer has {}", self.bytes.len()))
        })
    }
}
