//! `downbeat interface show --json`

use std::collections::BTreeSet;

use crate::msgs::definitions::{
    Constant, Element, Field, FieldType, MessageDefinition, Shape, TypeName, Value,
};
use serde::Serialize;

use super::interfaces::{Definition, Interfaces};

/// Prints each type, followed by nested types, once each.
pub(super) fn show(interfaces: &Interfaces, names: &[TypeName]) -> anyhow::Result<()> {
    let mut shown = Vec::new();
    let mut seen = BTreeSet::new();
    let mut waiting: Vec<TypeName> = names.iter().rev().cloned().collect();
    while let Some(name) = waiting.pop() {
        if !seen.insert(name.clone()) {
            continue;
        }
        let structure = Structure::of(&name, interfaces.find(&name)?);
        waiting.extend(structure.refers_to.iter().rev().cloned());
        shown.push(structure);
    }
    println!("{}", serde_json::to_string_pretty(&shown)?);
    Ok(())
}

/// A type with its fields; the fields of a service or action are its parts.
#[derive(Serialize)]
struct Structure {
    type_name: String,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    comment: Vec<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    constants: Vec<ShownConstant>,
    fields: Vec<ShownField>,
    #[serde(skip)]
    refers_to: Vec<TypeName>,
}

#[derive(Serialize)]
struct ShownField {
    name: String,
    #[serde(rename = "type")]
    field_type: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    default: Option<serde_json::Value>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    comment: Vec<String>,
}

#[derive(Serialize)]
struct ShownConstant {
    name: String,
    #[serde(rename = "type")]
    constant_type: String,
    value: serde_json::Value,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    comment: Vec<String>,
}

impl Structure {
    fn of(name: &TypeName, definition: Definition<'_>) -> Self {
        match definition {
            Definition::Message(message) => Self::of_message(message),
            Definition::Service(service) => {
                Self::of_parts(name, [("request", &service.request), ("response", &service.response)])
            }
            Definition::Action(action) => Self::of_parts(
                name,
                [("goal", &action.goal), ("result", &action.result), ("feedback", &action.feedback)],
            ),
        }
    }

    fn of_message(message: &MessageDefinition) -> Self {
        let refers_to = message.fields.iter().filter_map(|field| match &field.field_type.element {
            Element::Message(name) => Some(name.clone()),
            _ => None,
        });
        Self {
            type_name: message.name.to_string(),
            comment: message.comment.clone(),
            constants: message.constants.iter().map(ShownConstant::of).collect(),
            fields: message.fields.iter().map(ShownField::of).collect(),
            refers_to: refers_to.collect(),
        }
    }

    fn of_parts<const N: usize>(name: &TypeName, parts: [(&str, &MessageDefinition); N]) -> Self {
        let fields = parts.iter().map(|(field, part)| ShownField {
            name: (*field).to_owned(),
            field_type: part.name.to_string(),
            default: None,
            comment: Vec::new(),
        });
        Self {
            type_name: name.to_string(),
            comment: Vec::new(),
            constants: Vec::new(),
            fields: fields.collect(),
            refers_to: parts.iter().map(|(_, part)| part.name.clone()).collect(),
        }
    }
}

impl ShownField {
    fn of(field: &Field) -> Self {
        Self {
            name: field.name.clone(),
            field_type: full_type(&field.field_type),
            default: field.default.as_ref().map(json),
            comment: field.comment.clone(),
        }
    }
}

impl ShownConstant {
    fn of(constant: &Constant) -> Self {
        let constant_type = FieldType { element: constant.element.clone(), shape: Shape::Single };
        Self {
            name: constant.name.clone(),
            constant_type: full_type(&constant_type),
            value: json(&constant.value),
            comment: constant.comment.clone(),
        }
    }
}

/// The type as in a definition, with full names of messages.
fn full_type(field_type: &FieldType) -> String {
    let text = field_type.to_string();
    match &field_type.element {
        Element::Message(name) => text.replacen(&name.short(), &name.to_string(), 1),
        _ => text,
    }
}

/// Numbers that JSON cannot represent become strings.
fn json(value: &Value) -> serde_json::Value {
    match value {
        Value::Bool(value) => (*value).into(),
        Value::Integer(value) => i64::try_from(*value)
            .map(serde_json::Value::from)
            .or_else(|_| u64::try_from(*value).map(serde_json::Value::from))
            .unwrap_or_else(|_| value.to_string().into()),
        Value::Float(value) if value.is_finite() => (*value).into(),
        Value::Float(value) => value.to_string().into(),
        Value::Text(value) => value.as_str().into(),
        Value::List(values) => values.iter().map(json).collect(),
    }
}
