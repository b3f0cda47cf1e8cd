//! Parses the lines of one message.

use std::collections::HashSet;

use super::literal::{parse_element, parse_value, without_underscores};
use super::{Names, Source};
use crate::definition::MOST_MEMBERS;
use crate::name::{is_constant_name, is_identifier, is_package_name};
use crate::{
    Constant, Element, Error, Field, FieldType, MessageDefinition, Place, Primitive, Shape, TypeName,
};

pub(super) fn parse_message(
    name: TypeName,
    text: &str,
    source: Source<'_>,
) -> Result<MessageDefinition, Error> {
    let mut message = MessageDefinition {
        comment: leading_comment(text),
        fields: Vec::new(),
        constants: Vec::new(),
        text: text.into(),
        origin: source.origin.into(),
        name,
    };
    let mut comments: Vec<String> = Vec::new();
    let (mut field_names, mut constant_names) = (HashSet::new(), HashSet::new());
    let mut last_is_constant = false;
    for (index, line) in text.lines().enumerate() {
        let line = line.replace('\t', " ");
        let (code, comment) = match line.split_once('#') {
            Some((code, comment)) => (code.trim_end(), Some(comment.trim_start_matches('#').trim())),
            None => (line.trim_end(), None),
        };
        // The comment at the top belongs to the message, not to its first field.
        if index >= message.comment.len() {
            match comment {
                // Continues the comment of the line above.
                Some(comment) if code.is_empty() && line.starts_with(' ') => {
                    if let Some(last) = last_comment(&mut message, last_is_constant) {
                        last.push(comment.into());
                    }
                }
                Some(comment) => comments.push(comment.into()),
                None if code.is_empty() => comments.clear(),
                None => {}
            }
        }
        if code.is_empty() {
            continue;
        }
        let line = Line { source, number: source.first_line + index, code };
        if message.fields.len() + message.constants.len() == MOST_MEMBERS {
            let fault =
                format!("a message of more than {MOST_MEMBERS} fields and constants is not supported");
            return Err(line.fault(line.start(), fault));
        }
        match line.parse(&message.name.package, std::mem::take(&mut comments))? {
            Member::Field(field) => {
                last_is_constant = false;
                if !field_names.insert(field.name.clone()) {
                    return Err(
                        line.fault(line.name_at(), format!("the field `{}` is defined twice", field.name))
                    );
                }
                message.fields.push(field);
            }
            Member::Constant(constant) => {
                last_is_constant = true;
                if !constant_names.insert(constant.name.clone()) {
                    let fault = format!("the constant `{}` is defined twice", constant.name);
                    return Err(line.fault(line.name_at(), fault));
                }
                message.constants.push(constant);
            }
        }
    }
    Ok(message)
}

/// The comment of the field or constant that was read last.
fn last_comment(message: &mut MessageDefinition, is_constant: bool) -> Option<&mut Vec<String>> {
    if is_constant {
        message.constants.last_mut().map(|constant| &mut constant.comment)
    } else {
        message.fields.last_mut().map(|field| &mut field.comment)
    }
}

fn leading_comment(text: &str) -> Vec<String> {
    text.lines()
        .map_while(|line| line.strip_prefix('#'))
        .map(|line| line.trim_start_matches('#').trim().into())
        .collect()
}

enum Member {
    Field(Field),
    Constant(Constant),
}

/// One line with code on it.
struct Line<'a> {
    source: Source<'a>,
    number: usize,
    /// Without its comment and the spaces at its end.
    code: &'a str,
}

impl Line<'_> {
    fn parse(&self, package: &str, comment: Vec<String>) -> Result<Member, Error> {
        let start = self.start();
        let Some((type_text, rest)) = self.code[start..].split_once(' ') else {
            return Err(self.fault(self.code.len(), "expected a name after the type".into()));
        };
        let name_at = self.name_at();
        let rest = rest.trim_start();
        let name_end = rest.find([' ', '=']).unwrap_or(rest.len());
        let (name, rest) = rest.split_at(name_end);
        let value_text = rest.trim_start();
        let field_type = parse_type(type_text, package).map_err(|fault| self.fault(start, fault))?;

        if let Some(value_text) = value_text.strip_prefix('=') {
            let value_text = value_text.trim_start();
            let value_at = self.code.len() - value_text.len();
            if !self.may_name(name, is_constant_name) {
                return Err(self.fault(
                    name_at,
                    format!(
                        "`{name}` cannot name a constant: upper case letters, digits and single underscores, \
                         a letter first, no underscore last"
                    ),
                ));
            }
            let constant = parse_constant(field_type, name, value_text, comment)
                .map_err(|(part, fault)| self.fault([start, value_at][part], fault))?;
            return Ok(Member::Constant(constant));
        }

        if !self.may_name(name, is_package_name) {
            return Err(self.fault(
                name_at,
                format!(
                    "`{name}` cannot name a field: lower case letters, digits and single underscores, \
                     a letter first, no underscore last"
                ),
            ));
        }
        let default = match value_text {
            "" => None,
            text => Some(
                parse_value(&field_type, text)
                    .map_err(|fault| self.fault(self.code.len() - value_text.len(), fault))?,
            ),
        };
        let place = self.place(start);
        Ok(Member::Field(Field { name: name.into(), field_type, default, comment, place }))
    }

    fn may_name(&self, name: &str, is_allowed_in_files: fn(&str) -> bool) -> bool {
        match self.source.names {
            Names::OfFiles => is_allowed_in_files(name),
            Names::Any => is_identifier(name),
        }
    }

    /// The offset of the type.
    fn start(&self) -> usize {
        self.code.len() - self.code.trim_start().len()
    }

    /// The offset of the name.
    fn name_at(&self) -> usize {
        match self.code.trim_start().split_once(' ') {
            Some((_, rest)) => self.code.len() - rest.trim_start().len(),
            None => self.code.len(),
        }
    }

    fn place(&self, byte: usize) -> Place {
        let column = self.code[..byte].chars().count() + 1;
        self.source.place(self.number, column)
    }

    fn fault(&self, byte: usize, message: String) -> Error {
        Error::Syntax { place: self.place(byte), message }
    }
}

/// On failure also returns the invalid part: 0 is the type, 1 the value.
fn parse_constant(
    field_type: FieldType,
    name: &str,
    value: &str,
    comment: Vec<String>,
) -> Result<Constant, (usize, String)> {
    let element = match field_type {
        FieldType { element: Element::Message(_), .. }
        | FieldType {
            element: Element::String { bound: Some(_) } | Element::WString { bound: Some(_) },
            ..
        } => {
            return Err((
                0,
                format!("`{field_type}` cannot be the type of a constant, only primitives and strings can"),
            ));
        }
        FieldType { shape: Shape::Single, element } => element,
        _ => return Err((0, format!("`{field_type}` cannot be the type of a constant: it is an array"))),
    };
    let value = parse_element(&element, value).map_err(|fault| (1, fault))?;
    Ok(Constant { name: name.into(), element, value, comment })
}

fn parse_type(text: &str, package: &str) -> Result<FieldType, String> {
    let (element, shape) = match text.strip_suffix(']') {
        None => (text, Shape::Single),
        Some(rest) => {
            let (element, size) =
                rest.rsplit_once('[').ok_or_else(|| format!("`{text}` has a `]` without its `[`"))?;
            let shape = match size.strip_prefix("<=") {
                _ if size.is_empty() => Shape::Sequence,
                Some(bound) => Shape::Bounded(parse_count(bound, text)?),
                None => Shape::Array(parse_count(size, text)?),
            };
            (element, shape)
        }
    };
    Ok(FieldType { element: parse_element_type(element, package)?, shape })
}

fn parse_element_type(text: &str, package: &str) -> Result<Element, String> {
    if let Some(primitive) = Primitive::ALL.into_iter().find(|primitive| primitive.as_str() == text) {
        return Ok(Element::Primitive(primitive));
    }
    match text.split_once("<=") {
        Some(("string", bound)) => return Ok(Element::String { bound: Some(parse_count(bound, text)?) }),
        Some(("wstring", bound)) => return Ok(Element::WString { bound: Some(parse_count(bound, text)?) }),
        _ => {}
    }
    let (package, name) = match text {
        "string" => return Ok(Element::String { bound: None }),
        "wstring" => return Ok(Element::WString { bound: None }),
        "time" => return Err("ROS 2 has no type `time`: use `builtin_interfaces/Time`".into()),
        "duration" => return Err("ROS 2 has no type `duration`: use `builtin_interfaces/Duration`".into()),
        _ => text.split_once('/').unwrap_or((package, text)),
    };
    if let Some(name) = name.strip_prefix("msg/") {
        return Err(format!("`{text}`: within a definition the name is written `{package}/{name}`"));
    }
    // Only parts of services and actions have underscores: the full name of one is not ambiguous.
    let full = name.split_once('/').filter(|(_, name)| name.contains('_'));
    let named = full.map_or_else(|| TypeName::from_short(package, name), |_| text.parse().ok());
    named.map(Element::Message).ok_or_else(|| {
        format!("`{text}` is neither a primitive type nor a message name such as `std_msgs/Header`")
    })
}

fn parse_count(text: &str, whole: &str) -> Result<u64, String> {
    match without_underscores(text, 10).and_then(|text| text.parse::<u32>().ok()) {
        Some(count) if count > 0 => Ok(count.into()),
        _ => Err(format!("`{whole}`: the size must be a number from 1 to {}, found `{text}`", u32::MAX)),
    }
}
