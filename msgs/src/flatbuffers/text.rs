//! `.fbs` files.

use crate::interchange::{Count, Kind, Schema};

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
            let of = if field.count.is_list() { format!("[{of}]") } else { of };
            let default = match field.count {
                Count::Optional if field.kind.width().is_some() => " = null".to_owned(),
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
