//! Writes messages that come from other sources as `.msg` text.

use crate::{Constant, Element, Field, FieldType, MessageDefinition, Shape, Value};

/// Constants and fields, one per line. A constant or default that a `.msg` file cannot express (a string with
/// `#` or control characters, which IDL permits) is left out.
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
            // In a list, backslashes occur only before quotes.
            let is_plain = |value: &&Value| !matches!(value, Value::Text(text) if text.contains('\\'));
            let items = values.iter().map(|value| literal(Some(value).filter(is_plain)?));
            format!("[{}]", items.collect::<Option<Vec<_>>>()?.join(", "))
        }
    })
}

/// Removes the bound of a string: constants have no bounds.
pub(crate) fn without_bound(element: Element) -> Element {
    match element {
        Element::String { .. } => Element::String { bound: None },
        Element::WString { .. } => Element::WString { bound: None },
        other => other,
    }
}
