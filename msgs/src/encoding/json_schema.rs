//! JSON Schema of a message.
//!
//! # References
//! - `website/docs/spec/registry.md` of foxglove/mcap: the root is an object. References are not used, since
//!   readers of MCAP files need not resolve them.

use serde_json::{Map, Value, json};

use crate::interchange::{Field, Kind, Schema, Shape};

/// The schema of the objects of a type.
pub(super) fn json_schema(title: &str, schema: &Schema) -> Vec<u8> {
    let mut root = record(schema, 0);
    root.insert("$schema".into(), json!("http://json-schema.org/draft-07/schema#"));
    root.insert("title".into(), json!(title));
    Value::Object(root).to_string().into_bytes()
}

fn record(schema: &Schema, index: usize) -> Map<String, Value> {
    let fields = &schema.records[index].fields;
    let properties: Map<String, Value> =
        fields.iter().map(|of| (of.name.clone(), Value::Object(field(schema, of)))).collect();
    let required: Vec<&str> = fields.iter().map(|field| field.name.as_str()).collect();
    let mut object = Map::new();
    object.insert("type".into(), json!("object"));
    object.insert("properties".into(), Value::Object(properties));
    object.insert("required".into(), json!(required));
    object
}

fn field(schema: &Schema, field: &Field) -> Map<String, Value> {
    let items = element(schema, field.kind);
    let (least, greatest) = match field.shape {
        Shape::Single => return items,
        Shape::Array(count) => (Some(count), Some(count)),
        Shape::Bounded(count) => (None, Some(count)),
        Shape::Sequence => (None, None),
    };
    let mut list = Map::new();
    list.insert("type".into(), json!("array"));
    list.insert("items".into(), Value::Object(items));
    for (key, count) in [("minItems", least), ("maxItems", greatest)] {
        if let Some(count) = count {
            list.insert(key.into(), json!(count));
        }
    }
    list
}

fn element(schema: &Schema, kind: Kind) -> Map<String, Value> {
    let value = match kind {
        Kind::Bool => json!({ "type": "boolean" }),
        Kind::Int8 => json!({ "type": "integer", "minimum": i8::MIN, "maximum": i8::MAX }),
        Kind::Int16 => json!({ "type": "integer", "minimum": i16::MIN, "maximum": i16::MAX }),
        Kind::Int32 => json!({ "type": "integer", "minimum": i32::MIN, "maximum": i32::MAX }),
        Kind::Int64 => json!({ "type": "integer", "minimum": i64::MIN, "maximum": i64::MAX }),
        Kind::UInt8 | Kind::Enumeration(_) => json!({ "type": "integer", "minimum": 0, "maximum": u8::MAX }),
        Kind::UInt16 => json!({ "type": "integer", "minimum": 0, "maximum": u16::MAX }),
        Kind::UInt32 | Kind::Fixed32 => json!({ "type": "integer", "minimum": 0, "maximum": u32::MAX }),
        Kind::UInt64 => json!({ "type": "integer", "minimum": 0, "maximum": u64::MAX }),
        // Numbers that are not finite are null.
        Kind::Float32 | Kind::Float64 => json!({ "type": ["number", "null"] }),
        Kind::Text { bound } | Kind::WideText { bound } => match bound {
            // A character takes at least one byte or UTF-16 code unit.
            Some(bound) => json!({ "type": "string", "maxLength": bound }),
            None => json!({ "type": "string" }),
        },
        Kind::Time | Kind::Duration => json!({
            "type": "object",
            "properties": { "sec": { "type": "integer" }, "nanosec": { "type": "integer" } },
            "required": ["sec", "nanosec"]
        }),
        Kind::Record(index) => return record(schema, index),
    };
    match value {
        Value::Object(object) => object,
        _ => Map::new(),
    }
}
