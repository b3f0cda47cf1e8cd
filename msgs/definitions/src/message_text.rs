//! A message as a `.msg` file says it, for those that come from elsewhere.

use crate::{Constant, Element, Field, FieldType, MessageDefinition, Shape, Value};

/// Constants and fields, one a line. A constant or default that no `.msg` file can say (a text with `#` or with control
/// characters, which IDL can) is left out.
pub(crate) fn of(message: &MessageDefinition) -> String {
    let constants = message.constants.iter().filter_map(constant);
    constants.chain(message.fields.iter().map(field)).collect()
}

fn constant(constant: &Constant) -> Option<String> {
    let element = FieldType { element: constant.element.clone(), shape: Shape::Single };
    Some(format!("{element} {}={}\n", constant.name, literal(&constant.value)?))
}

fn field(field: &Field) -> String {
    let Field { field_type, name, default, .. } = field;
    match default.as_ref().and_then(literal) {
        Some(value) => format!("{field_type} {name} {value}\n"),
        None => format!("{field_type} {name}\n"),
    }
}

fn literal(value: &Value) -> Option<String> {
    Some(match value {
        Value::Bool(value) => value.to_string(),
        Value::Integer(value) => value.to_string(),
        Value::Float(value) => format!("{value:?}"),
        Value::Text(text) if text.contains(|c: char| c == '#' || c.is_control()) => return None,
        Value::Text(text) => {
            let quote = if text.contains('"') && !text.contains('\'') { '\'' } else { '"' };
            format!("{quote}{}{quote}", text.replace(quote, &format!("\\{quote}")))
        }
        Value::List(values) => {
            // What is within quotes in a list has no backslash but before quotes.
            let is_plain = |value: &&Value| !matches!(value, Value::Text(text) if text.contains('\\'));
            let items = values.iter().map(|value| literal(Some(value).filter(is_plain)?));
            format!("[{}]", items.collect::<Option<Vec<_>>>()?.join(", "))
        }
    })
}

/// The element a constant of a bounded string has: constants have no bounds.
pub(crate) fn without_bound(element: Element) -> Element {
    match element {
        Element::String { .. } => Element::String { bound: None },
        Element::WString { .. } => Element::WString { bound: None },
        other => other,
    }
}
