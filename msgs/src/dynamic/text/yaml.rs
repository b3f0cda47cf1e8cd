//! Messages as printed by `ros2 topic echo`.
//!
//! # References
//! `ros2/rosidl_runtime_py` branch jazzy, `rosidl_runtime_py/convert.py` (the content), and PyYAML (the
//! format).

use downbeat_msgs_definitions::{Element, FieldType, Primitive, Shape};

use super::scalar::{Context, write_float, write_text};
use crate::dynamic::{Array, MessageRef, ValueRef};

/// How a message is formatted as YAML. The fields are named after the options of `ros2 topic echo`.
///
/// ```
/// use downbeat_msgs::dynamic::{DynamicMessage, DynamicType, YamlStyle};
/// use downbeat_msgs::sensor_msgs::msg::JointState;
///
/// let mut joints = DynamicMessage::new(&DynamicType::of::<JointState>()?);
/// joints.set("position", vec![0.25, 0.5, 0.75])?;
/// let style = YamlStyle { flow_style: true, truncate_length: Some(2), ..YamlStyle::default() };
/// let yaml = joints.to_yaml(&style);
/// assert!(yaml.contains("position: [0.25, 0.5, '...']\n"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct YamlStyle {
    /// Truncates arrays and strings to this length, followed by `...`; 128 in `ros2 topic echo`.
    pub truncate_length: Option<usize>,
    /// Prints only type and length of arrays.
    pub no_arr: bool,
    /// Prints only the length of strings.
    pub no_str: bool,
    /// Prints arrays on one line.
    pub flow_style: bool,
}

/// The message as a YAML document.
pub(super) fn to_yaml(message: MessageRef<'_>, style: &YamlStyle) -> String {
    let mut emitter = Emitter { style, out: String::new() };
    if message.is_empty() {
        emitter.out.push_str("{}\n");
    } else {
        emitter.block_mapping(message, 0, Start::Line);
    }
    emitter.out
}

struct Emitter<'a> {
    style: &'a YamlStyle,
    out: String,
}

/// The position of the first key of a mapping.
#[derive(Clone, Copy, PartialEq)]
enum Start {
    Line,
    BehindDash,
}

impl Emitter<'_> {
    fn block_mapping(&mut self, message: MessageRef<'_>, indentation: usize, start: Start) {
        for (index, (name, field_type, value)) in message.fields_with_types().enumerate() {
            if index > 0 || start == Start::Line {
                self.indent(indentation);
            }
            write_text(&mut self.out, name, Context::Block, 0);
            self.out.push(':');
            match value {
                ValueRef::Message(message) if !message.is_empty() => {
                    self.out.push('\n');
                    self.block_mapping(message, indentation + 2, Start::Line);
                }
                ValueRef::Array(array) if self.is_block(array) => {
                    self.out.push('\n');
                    self.block_sequence(field_type, array, indentation);
                }
                value => {
                    self.out.push(' ');
                    self.inline(field_type, value, Context::Block, indentation);
                    self.out.push('\n');
                }
            }
        }
    }

    fn block_sequence(&mut self, field_type: &FieldType, array: &Array, indentation: usize) {
        let (shown, is_cut) = self.shown(array);
        for value in array.iter().take(shown) {
            self.indent(indentation);
            self.out.push_str("- ");
            match value {
                ValueRef::Message(message) if !message.is_empty() => {
                    self.block_mapping(message, indentation + 2, Start::BehindDash);
                }
                value => {
                    self.inline(field_type, value, Context::Block, indentation);
                    self.out.push('\n');
                }
            }
        }
        if is_cut {
            self.indent(indentation);
            self.out.push_str("- '...'\n");
        }
    }

    /// Writes a value without line breaks except those in its strings; `indentation` is that of its
    /// surroundings.
    fn inline(&mut self, field_type: &FieldType, value: ValueRef<'_>, context: Context, indentation: usize) {
        match value {
            ValueRef::Bool(value) => self.out.push_str(if value { "true" } else { "false" }),
            ValueRef::Float32(value) => write_float(&mut self.out, value.into()),
            ValueRef::Float64(value) => write_float(&mut self.out, value),
            ValueRef::String(text) | ValueRef::WString(text) => self.text(text, context, indentation),
            // In Python a byte is a string of one character, and is printed as such.
            ValueRef::UInt8(value) if field_type.element == Element::Primitive(Primitive::Byte) => {
                let text = char::from(value).to_string();
                let text = if self.style.truncate_length == Some(0) { "..." } else { &text };
                write_text(&mut self.out, text, context, indentation + 2);
            }
            ValueRef::UInt64(value) => self.out.push_str(&value.to_string()),
            ValueRef::Message(message) => self.flow_mapping(message, indentation + 2),
            ValueRef::Array(array) if self.style.no_arr => {
                let text = abbreviation(field_type, array.len());
                write_text(&mut self.out, &text, context, indentation + 2);
            }
            ValueRef::Array(array) => self.flow_sequence(field_type, array, indentation + 2),
            integer => self.out.push_str(&integer.as_i64().unwrap_or_default().to_string()),
        }
    }

    fn flow_mapping(&mut self, message: MessageRef<'_>, indentation: usize) {
        self.out.push('{');
        for (index, (name, field_type, value)) in message.fields_with_types().enumerate() {
            self.out.push_str(if index == 0 { "" } else { ", " });
            write_text(&mut self.out, name, Context::Flow, 0);
            self.out.push_str(": ");
            self.inline(field_type, value, Context::Flow, indentation);
        }
        self.out.push('}');
    }

    fn flow_sequence(&mut self, field_type: &FieldType, array: &Array, indentation: usize) {
        let (shown, is_cut) = self.shown(array);
        self.out.push('[');
        for (index, value) in array.iter().take(shown).enumerate() {
            self.out.push_str(if index == 0 { "" } else { ", " });
            self.inline(field_type, value, Context::Flow, indentation);
        }
        if is_cut {
            self.out.push_str(if shown == 0 { "'...'" } else { ", '...'" });
        }
        self.out.push(']');
    }

    fn text(&mut self, text: &str, context: Context, indentation: usize) {
        let indentation = indentation + 2;
        if self.style.no_str {
            let abbreviation = format!("<string length: <{}>>", text.chars().count());
            return write_text(&mut self.out, &abbreviation, context, indentation);
        }
        let end = self.style.truncate_length.and_then(|length| text.char_indices().nth(length));
        match end {
            Some((end, _)) => {
                write_text(&mut self.out, &format!("{}...", &text[..end]), context, indentation)
            }
            None => write_text(&mut self.out, text, context, indentation),
        }
    }

    /// Returns whether the array is written with one line per element.
    fn is_block(&self, array: &Array) -> bool {
        !self.style.flow_style && !self.style.no_arr && !array.is_empty()
    }

    /// The number of printed elements, and whether there are more.
    fn shown(&self, array: &Array) -> (usize, bool) {
        match self.style.truncate_length {
            Some(length) if array.len() > length => (length, true),
            _ => (array.len(), false),
        }
    }

    fn indent(&mut self, indentation: usize) {
        self.out.extend(std::iter::repeat_n(' ', indentation));
    }
}

/// Type and length of an array.
pub(super) fn abbreviation(field_type: &FieldType, length: usize) -> String {
    let element = match &field_type.element {
        Element::Primitive(primitive) => idl_name(*primitive).to_owned(),
        Element::String { .. } => "string".into(),
        Element::WString { .. } => "wstring".into(),
        Element::Message(name) => name.to_string(),
    };
    match field_type.shape {
        Shape::Array(count) => format!("<array type: {element}[{count}]>"),
        Shape::Bounded(bound) => format!("<sequence type: {element}[{bound}], length: {length}>"),
        _ => format!("<sequence type: {element}, length: {length}>"),
    }
}

/// The name of a primitive in IDL, which Python uses.
fn idl_name(primitive: Primitive) -> &'static str {
    match primitive {
        Primitive::Bool => "boolean",
        Primitive::Byte => "octet",
        Primitive::Char => "uint8",
        Primitive::Float32 => "float",
        Primitive::Float64 => "double",
        other => other.as_str(),
    }
}
