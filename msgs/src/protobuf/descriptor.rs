//! `FileDescriptorSet`: Protobuf's own representation of a schema, which MCAP files contain.

use std::convert::Infallible;

use super::wire::{WireType, put_bytes, put_delimited, put_tag, put_varint};
use super::{DURATION, TIMESTAMP, parts, path_of};
use crate::interchange::{Enumeration, Field, Kind, Record, Schema, Shape};

type Result = std::result::Result<(), Infallible>;

/// Every file of a schema, and those of imported well-known types; imports come first.
pub(crate) fn file_descriptor_set(schema: &Schema) -> Vec<u8> {
    let mut set = Vec::new();
    let uses =
        |kind: Kind| schema.records.iter().any(|record| record.fields.iter().any(|field| field.kind == kind));
    for (kind, (path, name)) in [(Kind::Time, TIMESTAMP), (Kind::Duration, DURATION)] {
        if uses(kind) {
            let moment = Record { name: name.into(), fields: vec![], least_size: 0 };
            put(&mut set, 1, |out| well_known_file(out, path, &moment));
        }
    }
    let mut is_written = vec![false; schema.records.len()];
    for index in 0..schema.records.len() {
        put_file(&mut set, schema, index, &mut is_written);
    }
    set
}

fn put_file(set: &mut Vec<u8>, schema: &Schema, index: usize, is_written: &mut [bool]) {
    if std::mem::replace(&mut is_written[index], true) {
        return;
    }
    // The depth of schemas is bounded.
    for field in &schema.records[index].fields {
        if let Kind::Record(inner) = field.kind {
            put_file(set, schema, inner, is_written);
        }
    }
    put(set, 1, |out| {
        let record = &schema.records[index];
        file_head(out, &path_of(&record.name), parts(&record.name).0, &imports(schema, record));
        put(out, 4, |out| message(out, schema, index));
        put_bytes(out, 12, b"proto3");
        Ok(())
    });
}

/// The file of `Timestamp` or `Duration`.
fn well_known_file(out: &mut Vec<u8>, path: &str, record: &Record) -> Result {
    let (package, name) = parts(&record.name);
    file_head(out, path, package, &[]);
    put(out, 4, |out| {
        put_bytes(out, 1, name.as_bytes());
        for (field_name, number, kind) in [("seconds", 1, 3), ("nanos", 2, 5)] {
            put(out, 2, |out| {
                put_bytes(out, 1, field_name.as_bytes());
                put_number(out, 3, number);
                put_number(out, 4, 1);
                put_number(out, 5, kind);
                Ok(())
            });
        }
        Ok(())
    });
    put_bytes(out, 12, b"proto3");
    Ok(())
}

fn file_head(out: &mut Vec<u8>, path: &str, package: &str, imports: &[String]) {
    put_bytes(out, 1, path.as_bytes());
    put_bytes(out, 2, package.as_bytes());
    for import in imports {
        put_bytes(out, 3, import.as_bytes());
    }
}

/// `DescriptorProto`
fn message(out: &mut Vec<u8>, schema: &Schema, index: usize) -> Result {
    let record = &schema.records[index];
    put_bytes(out, 1, parts(&record.name).1.as_bytes());
    let optional: Vec<&Field> = record.fields.iter().filter(|field| field.is_optional).collect();
    for field in &record.fields {
        let oneof = optional.iter().position(|other| other.number == field.number);
        put(out, 2, |out| field_descriptor(out, schema, field, oneof));
    }
    for enumeration in schema.enumerations.iter().filter(|enumeration| enumeration.owner == index) {
        put(out, 4, |out| enum_descriptor(out, enumeration));
    }
    // The compiler represents each optional field by its own `oneof`.
    for field in optional {
        put(out, 8, |out| {
            put_bytes(out, 1, format!("_{}", field.name).as_bytes());
            Ok(())
        });
    }
    Ok(())
}

/// `FieldDescriptorProto`
fn field_descriptor(out: &mut Vec<u8>, schema: &Schema, field: &Field, oneof: Option<usize>) -> Result {
    let is_bytes = field.is_list() && field.kind == Kind::UInt8;
    let is_repeated = field.is_list() && !is_bytes;
    put_bytes(out, 1, field.name.as_bytes());
    put_number(out, 3, field.number.into());
    put_number(out, 4, if is_repeated { 3 } else { 1 });
    let (number, type_name) = if is_bytes { (12, None) } else { type_of(schema, field.kind) };
    put_number(out, 5, number);
    if let Some(type_name) = type_name {
        put_bytes(out, 6, type_name.as_bytes());
    }
    if let Some(oneof) = oneof {
        put_number(out, 9, oneof as u64);
        put_number(out, 17, 1);
    }
    Ok(())
}

/// `EnumDescriptorProto`
fn enum_descriptor(out: &mut Vec<u8>, enumeration: &Enumeration) -> Result {
    put_bytes(out, 1, enumeration.nested_name.as_bytes());
    for (number, value) in enumeration.values.iter().enumerate() {
        put(out, 2, |out| {
            put_bytes(out, 1, value.as_bytes());
            put_number(out, 2, number as u64);
            Ok(())
        });
    }
    Ok(())
}

/// The number of the type in `FieldDescriptorProto.Type`, and its name if it has one.
fn type_of(schema: &Schema, kind: Kind) -> (u64, Option<String>) {
    match kind {
        Kind::Float64 => (1, None),
        Kind::Float32 => (2, None),
        Kind::Int64 => (3, None),
        Kind::UInt64 => (4, None),
        Kind::Int8 | Kind::Int16 | Kind::Int32 => (5, None),
        Kind::Fixed32 => (7, None),
        Kind::Bool => (8, None),
        Kind::Text { .. } | Kind::WideText { .. } => (9, None),
        Kind::UInt8 | Kind::UInt16 | Kind::UInt32 => (13, None),
        Kind::Time => (11, Some(format!(".{}", TIMESTAMP.1))),
        Kind::Duration => (11, Some(format!(".{}", DURATION.1))),
        Kind::Record(index) => (11, Some(format!(".{}", schema.records[index].name))),
        Kind::Enumeration(index) => {
            let Enumeration { owner, nested_name, .. } = &schema.enumerations[index];
            (14, Some(format!(".{}.{nested_name}", schema.records[*owner].name)))
        }
    }
}

fn put(out: &mut Vec<u8>, number: u32, write: impl FnOnce(&mut Vec<u8>) -> Result) {
    let Ok(()) = put_delimited(out, number, write);
}

fn put_number(out: &mut Vec<u8>, number: u32, value: u64) {
    put_tag(out, number, WireType::Varint);
    put_varint(out, value);
}

/// A `.proto` file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SchemaFile {
    /// The path by which it is imported: `sensor_msgs/msg/Imu.proto`.
    pub path: String,
    /// The content.
    pub text: String,
}

/// One file per record, the root's first.
pub(crate) fn schema_files(schema: &Schema) -> Vec<SchemaFile> {
    let files = schema.records.iter().enumerate();
    files
        .map(|(index, record)| SchemaFile { path: path_of(&record.name), text: text(schema, index) })
        .collect()
}

/// The files a record's file imports, in order.
pub(super) fn imports(schema: &Schema, record: &Record) -> Vec<String> {
    let path = |field: &Field| match field.kind {
        Kind::Record(index) => Some(path_of(&schema.records[index].name)),
        Kind::Time => Some(TIMESTAMP.0.to_owned()),
        Kind::Duration => Some(DURATION.0.to_owned()),
        _ => None,
    };
    let mut imports: Vec<String> = record.fields.iter().filter_map(path).collect();
    imports.sort_unstable();
    imports.dedup();
    imports
}

fn text(schema: &Schema, index: usize) -> String {
    let record = &schema.records[index];
    let (package, name) = parts(&record.name);
    let mut text = String::from("syntax = \"proto3\";\n");
    for (position, import) in imports(schema, record).iter().enumerate() {
        text.push_str(if position == 0 { "\n" } else { "" });
        text.push_str(&format!("import \"{import}\";\n"));
    }
    text.push_str(&format!("\npackage {package};\n\nmessage {name} {{\n"));
    for enumeration in schema.enumerations.iter().filter(|enumeration| enumeration.owner == index) {
        text.push_str(&format!("  enum {} {{\n", enumeration.nested_name));
        for (number, value) in enumeration.values.iter().enumerate() {
            text.push_str(&format!("    {value} = {number};\n"));
        }
        text.push_str("  }\n");
    }
    for field in &record.fields {
        let is_bytes = field.is_list() && field.kind == Kind::UInt8;
        let label = match field.shape {
            _ if is_bytes => "",
            Shape::Single if field.is_optional => "optional ",
            Shape::Single => "",
            Shape::Array(_) | Shape::Bounded(_) | Shape::Sequence => "repeated ",
        };
        let name = if is_bytes { "bytes".into() } else { type_name(schema, field.kind) };
        text.push_str(&format!("  {label}{name} {} = {};\n", field.name, field.number));
    }
    text.push_str("}\n");
    text
}

fn type_name(schema: &Schema, kind: Kind) -> String {
    match kind {
        Kind::Bool => "bool",
        Kind::Int8 | Kind::Int16 | Kind::Int32 => "int32",
        Kind::UInt8 | Kind::UInt16 | Kind::UInt32 => "uint32",
        Kind::Fixed32 => "fixed32",
        Kind::Int64 => "int64",
        Kind::UInt64 => "uint64",
        Kind::Float32 => "float",
        Kind::Float64 => "double",
        Kind::Text { .. } | Kind::WideText { .. } => "string",
        Kind::Time => TIMESTAMP.1,
        Kind::Duration => DURATION.1,
        Kind::Enumeration(index) => schema.enumerations[index].nested_name,
        // Fully qualified, so that no field or package name can shadow it.
        Kind::Record(index) => return format!(".{}", schema.records[index].name),
    }
    .into()
}
