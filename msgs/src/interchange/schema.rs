//! Records of named and numbered fields.

use std::collections::BTreeMap;

use downbeat_msgs_definitions as definitions;
use downbeat_msgs_definitions::{Catalog, Element, Primitive, Shape, TypeName};

use super::{Error, Kind, Value};

/// A record and its nested records.
#[derive(Clone, Debug, Default)]
pub(crate) struct Schema {
    /// The first is the root. No record contains itself.
    pub(crate) records: Vec<Record>,
    pub(crate) enumerations: Vec<Enumeration>,
}

/// A message type.
#[derive(Clone, Debug)]
pub(crate) struct Record {
    /// Including the namespace, as in `sensor_msgs.msg.Imu`, `foxglove.RawImage`.
    pub(crate) name: String,
    pub(crate) fields: Vec<Field>,
    /// The minimum size in CDR.
    pub(crate) least_size: usize,
}

/// A field of a record.
#[derive(Clone, Debug)]
pub(crate) struct Field {
    pub(crate) name: String,
    /// The field number in Protobuf.
    pub(crate) number: u32,
    /// The field id in FlatBuffers.
    pub(crate) id: u16,
    pub(crate) kind: Kind,
    pub(crate) shape: Shape,
    /// Whether a single value may be missing, which differs from zero.
    pub(crate) is_optional: bool,
    /// The default of a number in FlatBuffers.
    pub(crate) default: f64,
    /// The default in the definition, if any.
    pub(crate) initial: Option<Value<'static>>,
}

/// Names for numbers.
#[derive(Clone, Debug)]
pub(crate) struct Enumeration {
    /// The record that Protobuf defines it in, and its name there.
    pub(crate) owner: usize,
    pub(crate) nested_name: &'static str,
    /// Its name in FlatBuffers.
    pub(crate) name: &'static str,
    /// The names of the values, starting at 0.
    pub(crate) values: &'static [&'static str],
}

/// Maximum nesting of records: conversions recurse.
const DEEPEST: usize = 64;
/// Protobuf reserves the numbers from 19 000.
const MOST_FIELDS: usize = 18_999;

impl Schema {
    /// Derives a schema from a definition, with fields numbered in order and everything that CDR requires.
    ///
    /// # Errors
    /// Returns an error if the catalog lacks a type, or the type is too large.
    pub(crate) fn of_definition(catalog: &Catalog, name: &TypeName) -> Result<Self, Error> {
        let mut schema = Self::default();
        schema.add(catalog, name, &mut BTreeMap::new(), 1)?;
        Ok(schema)
    }

    pub(crate) fn root(&self) -> &Record {
        &self.records[0]
    }

    fn add(
        &mut self,
        catalog: &Catalog,
        name: &TypeName,
        known: &mut BTreeMap<TypeName, usize>,
        depth: usize,
    ) -> Result<usize, Error> {
        // Also stops at cycles, which the catalog's own check reports.
        if depth > DEEPEST {
            return Err(Error::TooDeep { type_name: name.to_string(), limit: DEEPEST });
        }
        if let Some(&index) = known.get(name) {
            return Ok(index);
        }
        let definition = catalog.message(name)?;
        let found = definition.fields.len();
        if found > MOST_FIELDS {
            return Err(Error::TooManyFields { type_name: name.to_string(), found, limit: MOST_FIELDS });
        }
        let index = self.records.len();
        let least_size = usize::try_from(catalog.least_wire_size(name)?).unwrap_or(usize::MAX);
        self.records.push(Record { name: dotted(name), fields: Vec::new(), least_size });
        for (position, field) in definition.fields.iter().enumerate() {
            let kind = match &field.field_type.element {
                Element::Message(inner) => Kind::Record(self.add(catalog, inner, known, depth + 1)?),
                element => kind_of(element),
            };
            let number = u16::try_from(position).unwrap_or(u16::MAX); // At most MOST_FIELDS.
            self.records[index].fields.push(Field {
                name: field.name.clone(),
                number: u32::from(number) + 1,
                id: number,
                kind,
                shape: field.field_type.shape,
                is_optional: false,
                default: 0.0,
                initial: field.default.as_ref().and_then(|default| initial(kind, default)),
            });
        }
        known.insert(name.clone(), index);
        Ok(index)
    }
}

impl Field {
    pub(crate) fn is_list(&self) -> bool {
        self.shape != Shape::Single
    }

    /// Checks the number of elements.
    pub(crate) fn check_count(&self, found: usize) -> Result<(), super::Problem> {
        let (what, length) = match self.shape {
            Shape::Array(length) if found as u64 != length => ("exactly", length),
            Shape::Bounded(length) if found as u64 > length => ("at most", length),
            _ => return Ok(()),
        };
        Err(super::Problem::new(format!("has {found} elements, but the type has {what} {length}")))
    }
}

/// `sensor_msgs.msg.Imu`
fn dotted(name: &TypeName) -> String {
    name.to_string().replace('/', ".")
}

fn kind_of(element: &Element) -> Kind {
    let size = |bound: Option<u64>| bound.map(|bound| usize::try_from(bound).unwrap_or(usize::MAX));
    match element {
        Element::Primitive(primitive) => match primitive {
            Primitive::Bool => Kind::Bool,
            Primitive::Byte | Primitive::Char | Primitive::UInt8 => Kind::UInt8,
            Primitive::Int8 => Kind::Int8,
            Primitive::Int16 => Kind::Int16,
            Primitive::UInt16 => Kind::UInt16,
            Primitive::Int32 => Kind::Int32,
            Primitive::UInt32 => Kind::UInt32,
            Primitive::Int64 => Kind::Int64,
            Primitive::UInt64 => Kind::UInt64,
            Primitive::Float32 => Kind::Float32,
            Primitive::Float64 => Kind::Float64,
        },
        Element::String { bound } => Kind::Text { bound: size(*bound) },
        Element::WString { bound } => Kind::WideText { bound: size(*bound) },
        Element::Message(_) => unreachable!("messages are records"),
    }
}

/// Converts a default of a definition, which the parser has checked against the field's type.
fn initial(kind: Kind, default: &definitions::Value) -> Option<Value<'static>> {
    Some(match (default, kind) {
        (definitions::Value::Bool(value), _) => Value::Bool(*value),
        (definitions::Value::Integer(value), _) => Value::integer(kind, *value)?,
        (definitions::Value::Float(value), Kind::Float32) => Value::Float32(*value as f32),
        (definitions::Value::Float(value), _) => Value::Float64(*value),
        (definitions::Value::Text(text), _) => Value::Text(text.clone().into()),
        (definitions::Value::List(values), _) => {
            let values: Vec<Value<'static>> =
                values.iter().map(|value| initial(kind, value)).collect::<Option<_>>()?;
            match kind.width() {
                Some(width) => {
                    let bits = values.iter().filter_map(Value::bits);
                    let bytes: Vec<u8> =
                        bits.flat_map(|bits| bits.to_le_bytes().into_iter().take(width)).collect();
                    Value::Packed(bytes.into())
                }
                None => Value::List(values),
            }
        }
    })
}
