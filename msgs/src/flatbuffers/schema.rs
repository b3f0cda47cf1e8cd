//! `.bfbs`: a schema as a FlatBuffer, described by `reflection.fbs`.

use super::encode::encode_with_identifier;
use super::inline_size;
use crate::interchange::{Enumeration, Field, Kind, Record, Schema, Shape, Value};

/// The numbers of `reflection.BaseType`.
mod base_type {
    pub(super) const BOOL: i64 = 2;
    pub(super) const BYTE: i64 = 3;
    pub(super) const UBYTE: i64 = 4;
    pub(super) const SHORT: i64 = 5;
    pub(super) const USHORT: i64 = 6;
    pub(super) const INT: i64 = 7;
    pub(super) const UINT: i64 = 8;
    pub(super) const LONG: i64 = 9;
    pub(super) const ULONG: i64 = 10;
    pub(super) const FLOAT: i64 = 11;
    pub(super) const DOUBLE: i64 = 12;
    pub(super) const STRING: i64 = 13;
    pub(super) const VECTOR: i64 = 14;
    pub(super) const OBJECT: i64 = 15;
}

/// The binary schema of a schema.
pub(crate) fn binary_schema(schema: &Schema) -> Vec<u8> {
    let uses =
        |kind: Kind| schema.records.iter().any(|record| record.fields.iter().any(|field| field.kind == kind));
    let mut names: Vec<&str> = schema.records.iter().map(|record| record.name.as_str()).collect();
    let moments = [(Kind::Time, TIME, base_type::UINT), (Kind::Duration, DURATION, base_type::INT)];
    names.extend(moments.iter().filter(|(kind, ..)| uses(*kind)).map(|(_, name, _)| *name));
    // Readers find objects and enumerations by binary search, so they must be sorted.
    names.sort_unstable();
    let mut enumerations: Vec<&str> = schema.enumerations.iter().map(|of| of.name).collect();
    enumerations.sort_unstable();

    let made = Made { schema, names: &names, enumerations: &enumerations };
    let objects = names.iter().map(|name| match moments.iter().find(|(_, moment, _)| moment == name) {
        Some((_, name, number)) => moment(name, *number),
        None => made.object(name),
    });
    let enums = enumerations.iter().filter_map(|name| made.enumeration(name));
    let value = Value::Record(vec![
        Value::List(objects.collect()),
        Value::List(enums.collect()),
        made.object(&schema.root().name),
    ]);
    // Only fails for times and sizes above 2 GiB, which do not occur.
    encode_with_identifier(&reflection(), &value, Some(b"BFBS")).unwrap_or_default()
}

/// The element size that `flatc` writes for types without elements.
const NO_ELEMENT: u64 = 1;
const TIME: &str = "foxglove.Time";
const DURATION: &str = "foxglove.Duration";

struct Made<'m> {
    schema: &'m Schema,
    names: &'m [&'m str],
    enumerations: &'m [&'m str],
}

impl Made<'_> {
    fn object(&self, name: &str) -> Value<'static> {
        let record = self.schema.records.iter().find(|record| record.name == name);
        let mut fields: Vec<&Field> = record.into_iter().flat_map(|record| &record.fields).collect();
        fields.sort_unstable_by(|a, b| a.name.cmp(&b.name));
        object(name, fields.into_iter().map(|field| self.field(field)).collect(), None)
    }

    fn field(&self, field: &Field) -> Value<'static> {
        let is_scalar = field.kind.width().is_some() && !field.is_list();
        Value::Record(vec![
            text(&field.name),
            self.field_type(field),
            Value::Unsigned(field.id.into()),
            Value::Unsigned(u64::from(field.id) * 2 + 4),
            Value::Float64(field.default),
            Value::Bool(!is_scalar || field.is_optional),
        ])
    }

    fn field_type(&self, field: &Field) -> Value<'static> {
        let (number, index) = self.element(field.kind);
        let (size, _) = inline_size(field.kind);
        if field.is_list() {
            type_of(base_type::VECTOR, Some(number), index, 4, size as u64)
        } else {
            let size = field.kind.width().unwrap_or(4);
            type_of(number, None, index, size as u64, NO_ELEMENT)
        }
    }

    /// The base type of a kind, and the index of the object it refers to.
    fn element(&self, kind: Kind) -> (i64, Option<usize>) {
        let object = |name: &str| (base_type::OBJECT, self.names.iter().position(|other| *other == name));
        match kind {
            Kind::Bool => (base_type::BOOL, None),
            Kind::Int8 => (base_type::BYTE, None),
            Kind::UInt8 => (base_type::UBYTE, None),
            Kind::Int16 => (base_type::SHORT, None),
            Kind::UInt16 => (base_type::USHORT, None),
            Kind::Int32 => (base_type::INT, None),
            Kind::UInt32 | Kind::Fixed32 => (base_type::UINT, None),
            Kind::Int64 => (base_type::LONG, None),
            Kind::UInt64 => (base_type::ULONG, None),
            Kind::Float32 => (base_type::FLOAT, None),
            Kind::Float64 => (base_type::DOUBLE, None),
            Kind::Text { .. } | Kind::WideText { .. } => (base_type::STRING, None),
            Kind::Time => object(TIME),
            Kind::Duration => object(DURATION),
            Kind::Record(index) => object(&self.schema.records[index].name),
            Kind::Enumeration(index) => {
                let name = self.schema.enumerations[index].name;
                (base_type::UBYTE, self.enumerations.iter().position(|other| *other == name))
            }
        }
    }

    fn enumeration(&self, name: &str) -> Option<Value<'static>> {
        let of: &Enumeration = self.schema.enumerations.iter().find(|of| of.name == name)?;
        let underlying = || {
            type_of(
                base_type::UBYTE,
                None,
                self.enumerations.iter().position(|other| *other == name),
                1,
                NO_ELEMENT,
            )
        };
        let values = of.values.iter().enumerate().map(|(number, value)| {
            let none = type_of(0, None, None, 1, NO_ELEMENT);
            Value::Record(vec![text(value), Value::Signed(i64::try_from(number).unwrap_or(0)), none])
        });
        Some(Value::Record(vec![text(name), Value::List(values.collect()), underlying()]))
    }
}

/// The struct `Time` or `Duration`.
fn moment(name: &str, number: i64) -> Value<'static> {
    let fields = [("nsec", 1, 4), ("sec", 0, 0)].map(|(field, id, offset)| {
        Value::Record(vec![
            text(field),
            type_of(number, None, None, 4, NO_ELEMENT),
            Value::Unsigned(id),
            Value::Unsigned(offset),
            Value::Float64(0.0),
            Value::Bool(false),
        ])
    });
    object(name, fields.into(), Some((4, 8)))
}

/// A table, or a struct with that alignment and size.
fn object(name: &str, fields: Vec<Value<'static>>, layout: Option<(i64, i64)>) -> Value<'static> {
    let (alignment, size) = layout.unwrap_or((1, 0));
    Value::Record(vec![
        text(name),
        Value::List(fields),
        Value::Bool(layout.is_some()),
        Value::Signed(alignment),
        Value::Signed(size),
    ])
}

fn type_of(
    number: i64,
    element: Option<i64>,
    index: Option<usize>,
    size: u64,
    element_size: u64,
) -> Value<'static> {
    Value::Record(vec![
        Value::Signed(number),
        Value::Signed(element.unwrap_or(0)),
        index.map_or(Value::Absent, |index| Value::Signed(i64::try_from(index).unwrap_or(-1))),
        if size == 4 { Value::Absent } else { Value::Unsigned(size) },
        Value::Unsigned(element_size),
    ])
}

fn text(text: &str) -> Value<'static> {
    Value::Text(text.to_owned().into())
}

/// The part of `reflection.fbs` that is written here.
fn reflection() -> Schema {
    use Shape::{Sequence, Single};
    const TEXT: Kind = Kind::Text { bound: None };
    const OBJECT: usize = 1;
    const FIELD: usize = 2;
    const TYPE: usize = 3;
    const ENUM: usize = 4;
    const VALUE: usize = 5;
    let record = |name: &str, fields: &[(&str, u16, Kind, Shape)]| Record {
        name: format!("reflection.{name}"),
        fields: fields
            .iter()
            .map(|&(name, id, kind, shape)| Field {
                name: name.into(),
                number: 0,
                id,
                kind,
                shape,
                // Zero is written too: their defaults are -1 and 4.
                is_optional: ["index", "base_size"].contains(&name),
                default: 0.0,
                initial: None,
            })
            .collect(),
        least_size: 1,
    };
    Schema {
        records: vec![
            record(
                "Schema",
                &[
                    ("objects", 0, Kind::Record(OBJECT), Sequence),
                    ("enums", 1, Kind::Record(ENUM), Sequence),
                    ("root_table", 4, Kind::Record(OBJECT), Single),
                ],
            ),
            record(
                "Object",
                &[
                    ("name", 0, TEXT, Single),
                    ("fields", 1, Kind::Record(FIELD), Sequence),
                    ("is_struct", 2, Kind::Bool, Single),
                    ("minalign", 3, Kind::Int32, Single),
                    ("bytesize", 4, Kind::Int32, Single),
                ],
            ),
            record(
                "Field",
                &[
                    ("name", 0, TEXT, Single),
                    ("type", 1, Kind::Record(TYPE), Single),
                    ("id", 2, Kind::UInt16, Single),
                    ("offset", 3, Kind::UInt16, Single),
                    ("default_real", 5, Kind::Float64, Single),
                    ("optional", 11, Kind::Bool, Single),
                ],
            ),
            record(
                "Type",
                &[
                    ("base_type", 0, Kind::Int8, Single),
                    ("element", 1, Kind::Int8, Single),
                    ("index", 2, Kind::Int32, Single),
                    ("base_size", 4, Kind::UInt32, Single),
                    ("element_size", 5, Kind::UInt32, Single),
                ],
            ),
            record(
                "Enum",
                &[
                    ("name", 0, TEXT, Single),
                    ("values", 1, Kind::Record(VALUE), Sequence),
                    ("underlying_type", 3, Kind::Record(TYPE), Single),
                ],
            ),
            record(
                "EnumVal",
                &[
                    ("name", 0, TEXT, Single),
                    ("value", 1, Kind::Int64, Single),
                    ("union_type", 3, Kind::Record(TYPE), Single),
                ],
            ),
        ],
        enumerations: vec![],
    }
}

/// All records of a schema in one file.
pub(super) fn schema_text(schema: &Schema) -> String {
    let (mut text, mut namespace) = (String::new(), "");
    for record in &schema.records {
        let (inner, name) = record.name.rsplit_once('.').unwrap_or(("", &record.name));
        if inner != namespace {
            text.push_str(&format!("namespace {inner};\n\n"));
            namespace = inner;
        }
        text.push_str(&format!("table {name} {{\n"));
        for field in &record.fields {
            let of = type_name(schema, field.kind);
            let of = if field.is_list() { format!("[{of}]") } else { of };
            let default = match field.kind.width() {
                Some(_) if field.is_optional => " = null".to_owned(),
                _ if field.default != 0.0 => format!(" = {:?}", field.default),
                _ => String::new(),
            };
            text.push_str(&format!("  {}:{of}{default} (id: {});\n", field.name, field.id));
        }
        text.push_str("}\n\n");
    }
    let (_, root) = schema.root().name.rsplit_once('.').unwrap_or(("", &schema.root().name));
    let root = if schema.records.len() == 1 { root } else { &schema.root().name };
    text.push_str(&format!("root_type {root};\n"));
    text
}

fn type_name(schema: &Schema, kind: Kind) -> String {
    match kind {
        Kind::Bool => "bool",
        Kind::Int8 => "byte",
        Kind::UInt8 => "ubyte",
        Kind::Int16 => "short",
        Kind::UInt16 => "ushort",
        Kind::Int32 => "int",
        Kind::UInt32 | Kind::Fixed32 => "uint",
        Kind::Int64 => "long",
        Kind::UInt64 => "ulong",
        Kind::Float32 => "float",
        Kind::Float64 => "double",
        Kind::Text { .. } | Kind::WideText { .. } => "string",
        Kind::Time => "foxglove.Time",
        Kind::Duration => "foxglove.Duration",
        Kind::Enumeration(index) => schema.enumerations[index].name,
        Kind::Record(index) => &schema.records[index].name,
    }
    .into()
}
