//! The lines of a definition, with the message each refers to.

use crate::msgs::definitions::{
    Constant, Element, Field, FieldType, MessageDefinition, Shape, TypeName, Value, parse_message,
};

use super::interfaces::Definition;

/// A line of a definition.
pub(super) struct Line {
    /// Without the line's end.
    pub(super) text: String,
    /// The type of its field, if that is a message.
    pub(super) message: Option<TypeName>,
}

/// The lines of the file of a definition. If there is no such file (the definition is derived from a service
/// or an action, or comes from IDL), the lines that it would have.
pub(super) fn lines(definition: Definition<'_>) -> Vec<Line> {
    let parts = definition.parts();
    lines_of_text(definition.text(), &parts).unwrap_or_else(|| written(&parts))
}

/// `None` if the text does not define these parts.
fn lines_of_text(text: &str, parts: &[&MessageDefinition]) -> Option<Vec<Line>> {
    let mut lines = Vec::new();
    let mut parts = parts.iter();
    let mut part = parts.next()?;
    let mut fields = part.fields.iter();
    for line in text.lines() {
        if line.trim_end() == SEPARATOR {
            if fields.next().is_some() {
                return None;
            }
            part = parts.next()?;
            fields = part.fields.iter();
            lines.push(Line { text: SEPARATOR.into(), message: None });
            continue;
        }
        let parsed = parse_message(part.name.clone(), line, &part.origin).ok()?;
        let message = match parsed.fields.first() {
            None => None,
            Some(found) => {
                let field = fields.next()?;
                if (&found.name, &found.field_type) != (&field.name, &field.field_type) {
                    return None;
                }
                message_of(field)
            }
        };
        lines.push(Line { text: line.into(), message });
    }
    (fields.next().is_none() && parts.next().is_none()).then_some(lines)
}

fn written(parts: &[&MessageDefinition]) -> Vec<Line> {
    let mut lines = Vec::new();
    for (index, part) in parts.iter().enumerate() {
        if index > 0 {
            lines.push(Line { text: SEPARATOR.into(), message: None });
        }
        lines.extend(comment_lines(&part.comment));
        for constant in &part.constants {
            lines.extend(comment_lines(&constant.comment));
            lines.push(Line { text: constant_line(constant), message: None });
        }
        for field in &part.fields {
            lines.extend(comment_lines(&field.comment));
            let default =
                field.default.as_ref().map(|value| format!(" {}", literal(value))).unwrap_or_default();
            let text = format!("{} {}{default}", field.field_type, field.name);
            lines.push(Line { text, message: message_of(field) });
        }
    }
    lines
}

const SEPARATOR: &str = "---";

fn message_of(field: &Field) -> Option<TypeName> {
    match &field.field_type.element {
        Element::Message(name) => Some(name.clone()),
        _ => None,
    }
}

fn comment_lines(comment: &[String]) -> impl Iterator<Item = Line> {
    comment.iter().map(|line| Line { text: format!("# {line}").trim_end().into(), message: None })
}

fn constant_line(constant: &Constant) -> String {
    let field_type = FieldType { element: constant.element.clone(), shape: Shape::Single };
    format!("{field_type} {}={}", constant.name, literal(&constant.value))
}

fn literal(value: &Value) -> String {
    match value {
        Value::Bool(value) => value.to_string(),
        Value::Integer(value) => value.to_string(),
        Value::Float(value) => format!("{value:?}"),
        Value::Text(text) => format!("\"{}\"", text.replace('"', "\\\"")),
        Value::List(values) => format!("[{}]", values.iter().map(literal).collect::<Vec<_>>().join(", ")),
    }
}
