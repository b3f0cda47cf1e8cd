//! Access to the fields of a record by their names.

use crate::interchange::{Field, Kind, Problem, Schema, Value};

/// A record's value with its schema.
pub(super) struct Object<'o, 'v> {
    pub(super) schema: &'o Schema,
    pub(super) record: usize,
    pub(super) value: &'o mut Value<'v>,
}

impl<'o, 'v> Object<'o, 'v> {
    pub(super) fn new(schema: &'o Schema, record: usize, value: &'o mut Value<'v>) -> Self {
        Self { schema, record, value }
    }

    /// The field at a path, and its value.
    pub(super) fn field(&mut self, path: &str) -> Result<(&'o Field, &mut Value<'v>), Problem> {
        let Some((field, indices)) = resolve(self.schema, self.record, path) else {
            return Err(Problem::new("the type has no such field").in_field(path));
        };
        let mut value = &mut *self.value;
        for index in indices {
            value = match value {
                Value::Record(values) if index < values.len() => &mut values[index],
                _ => return Err(Problem::new("does not exist").in_field(path)),
            };
        }
        Ok((field, value))
    }

    /// Removes and returns a value.
    pub(super) fn take(&mut self, path: &str) -> Result<Value<'v>, Problem> {
        Ok(std::mem::replace(self.field(path)?.1, Value::Absent))
    }

    pub(super) fn put(&mut self, path: &str, value: Value<'v>) -> Result<(), Problem> {
        *self.field(path)?.1 = value;
        Ok(())
    }

    pub(super) fn unsigned(&mut self, path: &str) -> Result<u64, Problem> {
        match self.field(path)?.1 {
            Value::Unsigned(value) => Ok(*value),
            Value::Bool(value) => Ok(u64::from(*value)),
            _ => Err(Problem::new("is not an unsigned number").in_field(path)),
        }
    }

    pub(super) fn float(&mut self, path: &str) -> Result<f64, Problem> {
        match self.field(path)?.1 {
            Value::Float32(value) => Ok((*value).into()),
            Value::Float64(value) => Ok(*value),
            _ => Err(Problem::new("is not a floating-point number").in_field(path)),
        }
    }

    pub(super) fn text(&mut self, path: &str) -> Result<String, Problem> {
        match self.field(path)?.1 {
            Value::Text(text) => Ok(text.to_string()),
            _ => Err(Problem::new("is not a string").in_field(path)),
        }
    }

    /// Takes the bytes of a list of numbers.
    pub(super) fn take_packed(&mut self, path: &str) -> Result<std::borrow::Cow<'v, [u8]>, Problem> {
        match self.take(path)? {
            Value::Packed(bytes) => Ok(bytes),
            _ => Err(Problem::new("is not a list of numbers").in_field(path)),
        }
    }

    /// Takes the elements of a list, and returns the kind of an element.
    pub(super) fn take_list(&mut self, path: &str) -> Result<(Kind, Vec<Value<'v>>), Problem> {
        let kind = self.field(path)?.0.kind;
        match self.take(path)? {
            Value::List(values) => Ok((kind, values)),
            _ => Err(Problem::new("is not a list").in_field(path)),
        }
    }
}

/// The field at a path, and its index in each record on the path.
pub(super) fn resolve<'s>(schema: &'s Schema, record: usize, path: &str) -> Option<(&'s Field, Vec<usize>)> {
    let (mut record, mut indices, mut found) = (Some(record), Vec::new(), None);
    for name in path.split('.') {
        let fields = &schema.records.get(record?)?.fields;
        // `D` in Protobuf is `d` in FlatBuffers.
        let index = fields.iter().position(|field| field.name.eq_ignore_ascii_case(name))?;
        let field = &fields[index];
        record = match field.kind {
            Kind::Record(inner) if !field.is_list() => Some(inner),
            _ => None,
        };
        indices.push(index);
        found = Some(field);
    }
    Some((found?, indices))
}
