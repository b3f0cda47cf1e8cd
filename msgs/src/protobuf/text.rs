//! `.proto` files.

use super::{DURATION, TIMESTAMP, parts, path_of};
use crate::interchange::{Count, Field, Kind, Record, Schema};

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
        let is_bytes = field.count.is_list() && field.kind == Kind::UInt8;
        let label = match field.count {
            _ if is_bytes => "",
            Count::One => "",
            Count::Optional => "optional ",
            Count::Array(_) | Count::Bounded(_) | Count::Any => "repeated ",
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
