//! `downbeat interface show`
//!
//! # References
//! `ros2interface/ros2interface/verb/show.py` of ros2/ros2cli, branch jazzy: the file line by line; each
//! field of a message type is followed by the file of that type, indented by one more tab. When hiding
//! comments, the real command leaves the `#` after a field, contrary to its own tests, and keeps indented
//! comments; here they are removed completely.

use std::collections::BTreeSet;

use anyhow::bail;
use serde::Serialize;

use super::interfaces::{Definition, Interfaces};
use super::{Registered, ShowArguments};
use downbeat_msgs::definitions::{
    Constant, Element, Field, FieldType, MessageDefinition, Shape, TypeName, Value, parse_message,
};

pub(super) fn show(arguments: &ShowArguments, registered: &Registered) -> anyhow::Result<()> {
    let interfaces = Interfaces::load(&arguments.types.source, registered)?;
    let names = interfaces.chosen(&arguments.types)?;
    if arguments.json {
        return show_json(&interfaces, &names);
    }
    let comments = match arguments {
        ShowArguments { all_comments: true, .. } => Comments::All,
        ShowArguments { no_comments: true, .. } => Comments::None,
        _ => Comments::OfTheTypeItself,
    };
    for name in &names {
        if arguments.types.all {
            println!("{}\n{name}", "=".repeat(80));
        }
        Text { interfaces: &interfaces, comments, path: Vec::new(), lines: 0 }.print(name)?;
    }
    Ok(())
}

#[derive(Clone, Copy)]
enum Comments {
    All,
    OfTheTypeItself,
    None,
}

/// The state of printing a definition.
struct Text<'a> {
    interfaces: &'a Interfaces,
    comments: Comments,
    /// From the requested type to the one being printed.
    path: Vec<TypeName>,
    /// The number of lines so far, including hidden ones.
    lines: usize,
}

/// Limits output: types with two fields of each next type double with each level.
const MOST_LINES: usize = 100_000;
const DEEPEST: usize = 100;

impl Text<'_> {
    fn print(&mut self, name: &TypeName) -> anyhow::Result<()> {
        // This bounds the depth by the number of types.
        if self.path.contains(name) {
            let path = self.path.iter().map(TypeName::to_string).collect::<Vec<_>>().join(" -> ");
            bail!("{name} contains itself: {path} -> {name}");
        }
        if self.path.len() == DEEPEST {
            bail!("{} is nested deeper than {DEEPEST} types; --json shows each type once", self.path[0]);
        }
        self.path.push(name.clone());
        let definition = self.interfaces.find(name)?;
        for line in lines(definition) {
            self.lines += 1;
            if self.lines > MOST_LINES {
                bail!("{} has more than {MOST_LINES} lines; --json shows each type once", self.path[0]);
            }
            self.print_line(&line.text);
            if let Some(message) = line.message {
                self.print(&message)?;
            }
        }
        self.path.pop();
        Ok(())
    }

    fn print_line(&self, line: &str) {
        let has_comments = match self.comments {
            Comments::All => true,
            Comments::OfTheTypeItself => self.path.len() == 1,
            Comments::None => false,
        };
        let shown = match line.split_once('#') {
            Some((code, _)) if !has_comments => code.trim(),
            _ => line.trim_end(),
        };
        if !shown.is_empty() {
            println!("{}{shown}", "\t".repeat(self.path.len() - 1));
        } else if has_comments {
            println!();
        }
    }
}

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

/// Prints each type, followed by nested types, once each.
fn show_json(interfaces: &Interfaces, names: &[TypeName]) -> anyhow::Result<()> {
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
