//! Writes values as FlatBuffers, front to back: a table, then what it refers to.

use super::inline_size;
use crate::interchange::{Field, Kind, Problem, Schema, Value};

/// Writes a value of the schema's root record.
///
/// # Errors
/// Returns an error if the format cannot represent a time, or the message is larger than 2 GiB.
pub(crate) fn encode(schema: &Schema, value: &Value<'_>) -> Result<Vec<u8>, Problem> {
    encode_with_identifier(schema, value, None)
}

/// Like [`encode`], with the four characters of the file identifier.
pub(super) fn encode_with_identifier(
    schema: &Schema,
    value: &Value<'_>,
    identifier: Option<&[u8; 4]>,
) -> Result<Vec<u8>, Problem> {
    let mut out = Buffer { bytes: vec![0; 4] };
    out.bytes.extend_from_slice(identifier.map_or(&[], |identifier| &identifier[..]));
    let root = out.record(schema, 0, value)?;
    out.point(0, root)?;
    Ok(out.bytes)
}

struct Buffer {
    bytes: Vec<u8>,
}

/// A value that is not stored in its table, and the position of the offset to it.
struct Elsewhere<'v> {
    slot: usize,
    field: &'v Field,
    value: &'v Value<'v>,
}

/// The maximum size of a buffer.
const MOST_BYTES: usize = i32::MAX as usize;

impl Buffer {
    /// Appends a table and the values it refers to; returns the position of the table.
    fn record<'v>(
        &mut self,
        schema: &'v Schema,
        index: usize,
        value: &'v Value<'v>,
    ) -> Result<usize, Problem> {
        let Value::Record(values) = value else { return Err(mismatch(value)) };
        let record = &schema.records[index];
        let present: Vec<(&Field, &Value<'v>)> =
            record.fields.iter().zip(values).filter(|(field, value)| is_stored(field, value)).collect();

        // The offset of each value in the table: the largest first, to minimise padding.
        let mut places =
            vec![0_usize; record.fields.iter().map(|field| usize::from(field.id) + 1).max().unwrap_or(0)];
        let (mut size, mut alignment) = (4, 4);
        for width in [8, 4, 2, 1] {
            for (field, _) in present.iter().filter(|(field, _)| size_of_slot(field).1 == width) {
                let (bytes, align) = size_of_slot(field);
                size = usize::next_multiple_of(size, align);
                places[usize::from(field.id)] = size;
                size += bytes;
                alignment = alignment.max(align);
            }
        }
        let too_large = || Problem::new("the fields of a table take more than 64 KiB");
        let size = u16::try_from(size).map_err(|_| too_large())?;

        // The vtable ends at the start of the table.
        let vtable_size = u16::try_from(4 + 2 * places.len()).map_err(|_| too_large())?;
        let table = (self.bytes.len() + usize::from(vtable_size)).next_multiple_of(alignment);
        let vtable = table - usize::from(vtable_size);
        self.bytes.resize(vtable, 0);
        self.bytes.extend_from_slice(&vtable_size.to_le_bytes());
        self.bytes.extend_from_slice(&size.to_le_bytes());
        for place in &places {
            self.bytes.extend_from_slice(&(*place as u16).to_le_bytes()); // At most `size`.
        }
        self.bytes.extend_from_slice(&i32::from(vtable_size).to_le_bytes());
        self.bytes.resize(table + usize::from(size), 0);

        let mut elsewhere = Vec::new();
        for (field, value) in present {
            let slot = table + places[usize::from(field.id)];
            match value {
                Value::Moment { sec, nanosec } => {
                    let moment = moment(field.kind, *sec, *nanosec)
                        .map_err(|problem| problem.in_field(&field.name))?;
                    self.set(slot, &moment);
                }
                _ => match (value.bits(), field.kind.width()) {
                    (Some(bits), Some(width)) => self.set(slot, &bits.to_le_bytes()[..width]),
                    _ => elsewhere.push(Elsewhere { slot, field, value }),
                },
            }
        }
        for Elsewhere { slot, field, value } in elsewhere {
            self.elsewhere(schema, field, value)
                .and_then(|target| self.point(slot, target))
                .map_err(|problem| problem.in_field(&field.name))?;
        }
        Ok(table)
    }

    /// Appends a string, vector or table; returns its position.
    fn elsewhere<'v>(
        &mut self,
        schema: &'v Schema,
        field: &'v Field,
        value: &'v Value<'v>,
    ) -> Result<usize, Problem> {
        match (value, field.kind) {
            (Value::Text(text), _) => self.text(text),
            (Value::Record(_), Kind::Record(index)) => self.record(schema, index, value),
            (Value::Packed(bytes), kind) => {
                let width = kind.width().unwrap_or(1);
                let vector = self.vector(bytes.len() / width, width)?;
                self.bytes.extend_from_slice(bytes);
                Ok(vector)
            }
            (Value::List(values), kind) => {
                let vector = self.vector(values.len(), 4)?;
                let first = self.bytes.len();
                self.bytes.resize(first + 4 * values.len(), 0);
                for (index, value) in values.iter().enumerate() {
                    let target = match (value, kind) {
                        (Value::Text(text), _) => self.text(text),
                        (Value::Record(_), Kind::Record(record)) => self.record(schema, record, value),
                        _ => Err(mismatch(value)),
                    };
                    target
                        .and_then(|target| self.point(first + 4 * index, target))
                        .map_err(|problem| problem.at_index(index))?;
                }
                Ok(vector)
            }
            _ => Err(mismatch(value)),
        }
    }

    fn text(&mut self, text: &str) -> Result<usize, Problem> {
        let start = self.vector(text.len(), 1)?;
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
        Ok(start)
    }

    /// Appends the length of a vector, aligned so that its elements can follow; returns its position.
    fn vector(&mut self, length: usize, alignment: usize) -> Result<usize, Problem> {
        let start = (self.bytes.len() + 4).next_multiple_of(alignment.max(4)) - 4;
        self.bytes.resize(start, 0);
        match u32::try_from(length) {
            Ok(length) => self.bytes.extend_from_slice(&length.to_le_bytes()),
            Err(_) => return Err(too_long()),
        }
        Ok(start)
    }

    /// Sets the offset at `slot` to point to `target`, which is after it.
    fn point(&mut self, slot: usize, target: usize) -> Result<(), Problem> {
        if self.bytes.len() > MOST_BYTES {
            return Err(too_long());
        }
        self.set(slot, &((target - slot) as u32).to_le_bytes()); // At most MOST_BYTES.
        Ok(())
    }

    fn set(&mut self, place: usize, bytes: &[u8]) {
        self.bytes[place..place + bytes.len()].copy_from_slice(bytes);
    }
}

/// Bytes and alignment of a field in its table.
fn size_of_slot(field: &Field) -> (usize, usize) {
    if field.is_list() { (4, 4) } else { inline_size(field.kind) }
}

/// Returns whether a value must be stored: defaults are left out.
fn is_stored(field: &Field, value: &Value<'_>) -> bool {
    match value {
        Value::Absent => false,
        Value::Packed(bytes) => !bytes.is_empty(),
        // Lists of tables are stored even if empty: some schemas require them.
        Value::List(values) => !values.is_empty() || matches!(field.kind, Kind::Record(_)),
        Value::Text(text) => !text.is_empty(),
        Value::Float64(value) if !field.is_list() && !field.is_optional => {
            value.to_bits() != field.default.to_bits()
        }
        _ => field.is_optional || value.bits() != Some(0),
    }
}

/// The structs `Time` and `Duration`.
fn moment(kind: Kind, sec: i64, nanosec: u32) -> Result<[u8; 8], Problem> {
    let mut sec = sec.saturating_add(i64::from(nanosec / 1_000_000_000));
    let mut nanos = i64::from(nanosec % 1_000_000_000);
    let fits = if kind == Kind::Time {
        u32::try_from(sec).is_ok()
    } else {
        // Both have the same sign.
        if sec < 0 && nanos > 0 {
            (sec, nanos) = (sec + 1, nanos - 1_000_000_000);
        }
        i32::try_from(sec).is_ok()
    };
    if !fits {
        return Err(Problem::new(format!("{sec} s cannot be represented by FlatBuffers' {kind:?}")));
    }
    let mut bytes = [0; 8];
    bytes[..4].copy_from_slice(&(sec as u32).to_le_bytes());
    bytes[4..].copy_from_slice(&(nanos as u32).to_le_bytes());
    Ok(bytes)
}

#[cold]
fn too_long() -> Problem {
    Problem::new("the message would take more than 2 GiB, the limit of FlatBuffers")
}

/// A value that does not match its schema, which only a bug can cause.
#[cold]
fn mismatch(value: &Value<'_>) -> Problem {
    Problem::new(format!("the value {value:?} is not of the field's kind"))
}
