//! Messages as rclpy shows them: `repr(message)`, `str(value)` and the lines of `ros2 topic echo --csv`.
//!
//! # References
//! `rosidl_generator_py/resource/_msg.py.em` (`__repr__`) and `rosidl_runtime_py/convert.py`
//! (`message_to_csv`), branch jazzy.

use std::fmt::Write;

use downbeat_msgs_definitions::{Element, FieldType, Primitive, Shape};

pub use downbeat_msgs_definitions::python::{write_bytes, write_float, write_text};

use super::numpy;
use super::yaml::{YamlStyle, abbreviation};
use crate::dynamic::{Array, MessageRef, ValueRef};

impl MessageRef<'_> {
    /// The message as formatted by `repr` in Python, and so by `ros2 topic pub` and `ros2 service call`.
    ///
    /// ```
    /// use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
    /// use downbeat_msgs::std_msgs::msg::Header;
    ///
    /// let mut header = DynamicMessage::new(&DynamicType::of::<Header>()?);
    /// header.set("frame_id", "it's")?;
    /// assert_eq!(
    ///     header.as_message().to_python_repr(),
    ///     r#"std_msgs.msg.Header(stamp=builtin_interfaces.msg.Time(sec=0, nanosec=0), frame_id="it's")"#
    /// );
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn to_python_repr(self) -> String {
        let mut out = String::new();
        write_message(&mut out, self);
        out
    }

    /// The message as a line of `ros2 topic echo --csv`, without its line break. `flow_style` is ignored.
    ///
    /// As there, strings are not quoted, and commas in them are not escaped.
    #[must_use]
    pub fn to_csv(self, style: &YamlStyle) -> String {
        let mut cells = Vec::new();
        csv_of_message(&mut cells, self, style);
        cells.join(",")
    }
}

impl ValueRef<'_> {
    /// The value of a field of that type as printed by Python: the output of `ros2 topic echo --field` for a
    /// field that is not a message.
    #[must_use]
    pub fn to_python_str(self, field_type: &FieldType) -> String {
        let mut out = String::new();
        match self {
            ValueRef::String(text) | ValueRef::WString(text) => out.push_str(text),
            ValueRef::Array(array) => match (array_kind(field_type), array_code(array)) {
                (ArrayKind::Numpy, _) => out.push_str(&numpy::to_str(array)),
                (ArrayKind::Typed, Some(code)) if array.is_empty() => {
                    let _ = write!(out, "array('{code}')");
                }
                (ArrayKind::Typed, Some(code)) => {
                    let _ = write!(out, "array('{code}', ");
                    write_list(&mut out, field_type, array);
                    out.push(')');
                }
                _ => write_list(&mut out, field_type, array),
            },
            value => write_value(&mut out, field_type, value),
        }
        out
    }
}

/// The Python type in which rclpy stores an array.
#[derive(Clone, Copy, PartialEq)]
enum ArrayKind {
    /// A fixed number of numbers.
    Numpy,
    /// A sequence of numbers.
    Typed,
    /// All others.
    List,
}

fn array_kind(field_type: &FieldType) -> ArrayKind {
    let is_number = match &field_type.element {
        Element::Primitive(primitive) => !matches!(primitive, Primitive::Bool | Primitive::Byte),
        _ => false,
    };
    match field_type.shape {
        _ if !is_number => ArrayKind::List,
        Shape::Array(_) => ArrayKind::Numpy,
        _ => ArrayKind::Typed,
    }
}

/// The type code of Python's `array.array`.
fn array_code(array: &Array) -> Option<char> {
    Some(match array {
        Array::Int8(_) => 'b',
        Array::UInt8(_) => 'B',
        Array::Int16(_) => 'h',
        Array::UInt16(_) => 'H',
        Array::Int32(_) => 'i',
        Array::UInt32(_) => 'I',
        Array::Int64(_) => 'q',
        Array::UInt64(_) => 'Q',
        Array::Float32(_) => 'f',
        Array::Float64(_) => 'd',
        Array::Bool(_) | Array::String(_) | Array::WString(_) | Array::Message(_) => return None,
    })
}

fn write_message(out: &mut String, message: MessageRef<'_>) {
    let name = message.type_name();
    let _ = write!(out, "{}.{}.{}(", name.package, name.kind.as_str(), name.name);
    for (index, (field, field_type, value)) in message.fields_with_types().enumerate() {
        let _ = write!(out, "{}{field}=", if index == 0 { "" } else { ", " });
        write_value(out, field_type, value);
    }
    out.push(')');
}

/// As in `repr`, except that the generated code strips the `array('d', …)` of a sequence of numbers.
fn write_value(out: &mut String, field_type: &FieldType, value: ValueRef<'_>) {
    match value {
        ValueRef::Bool(value) => out.push_str(if value { "True" } else { "False" }),
        ValueRef::Float32(value) => write_float(out, value.into()),
        ValueRef::Float64(value) => write_float(out, value),
        ValueRef::String(text) | ValueRef::WString(text) => write_text(out, text),
        ValueRef::UInt8(value) if is_byte(field_type) => write_bytes(out, &[value]),
        ValueRef::UInt64(value) => out.push_str(&value.to_string()),
        ValueRef::Message(message) => write_message(out, message),
        ValueRef::Array(array) if array_kind(field_type) == ArrayKind::Numpy => {
            out.push_str(&numpy::to_repr(array));
        }
        ValueRef::Array(array) => write_list(out, field_type, array),
        integer => out.push_str(&integer.as_i64().unwrap_or_default().to_string()),
    }
}

fn write_list(out: &mut String, field_type: &FieldType, array: &Array) {
    out.push('[');
    for (index, value) in array.iter().enumerate() {
        out.push_str(if index == 0 { "" } else { ", " });
        write_value(out, field_type, value);
    }
    out.push(']');
}

fn is_byte(field_type: &FieldType) -> bool {
    field_type.element == Element::Primitive(Primitive::Byte)
}

fn csv_of_message(cells: &mut Vec<String>, message: MessageRef<'_>, style: &YamlStyle) {
    for (_, field_type, value) in message.fields_with_types() {
        csv_of_value(cells, field_type, value, style);
    }
}

fn csv_of_value(cells: &mut Vec<String>, field_type: &FieldType, value: ValueRef<'_>, style: &YamlStyle) {
    let mut cell = String::new();
    match value {
        ValueRef::Message(message) => return csv_of_message(cells, message, style),
        ValueRef::Array(array) if style.no_arr => cell = abbreviation(field_type, array.len()),
        ValueRef::Array(array) => {
            let shown = style.truncate_length.unwrap_or(usize::MAX);
            for value in array.iter().take(shown) {
                csv_of_value(cells, field_type, value, style);
            }
            if array.len() > shown {
                cells.push("...".into());
            }
            if !array.is_empty() {
                return;
            }
        }
        ValueRef::String(text) | ValueRef::WString(text) if style.no_str => {
            let _ = write!(cell, "<string length: <{}>>", text.chars().count());
        }
        ValueRef::String(text) | ValueRef::WString(text) => {
            let end = style.truncate_length.and_then(|length| text.char_indices().nth(length));
            cell.push_str(&text[..end.map_or(text.len(), |(end, _)| end)]);
            if end.is_some() {
                cell.push_str("...");
            }
        }
        // NumPy prints the shortest digits of a 32-bit number, Python those of the 64-bit value.
        ValueRef::Float32(value) if array_kind(field_type) == ArrayKind::Numpy => {
            let _ = write!(cell, "{value:?}");
        }
        value => write_value(&mut cell, field_type, value),
    }
    cells.push(cell);
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::dynamic::{DynamicMessage, DynamicType};

    fn message() -> DynamicMessage {
        let text = "bool on\nbyte level\nstring name\nfloat64[] gains\nuint8[2] pair\nbyte[] raw\nstring[] words\n\
                    builtin_interfaces/Time[] times\n================================================================================\n\
                    MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n";
        let of = DynamicType::from_definition_text("my_msgs/msg/All", "ros2msg", text).unwrap();
        let mut message = DynamicMessage::new(&of);
        let yaml = "{on: true, level: 7, name: \"a'b\\e[31m\", gains: [0.5, 1.0e-5], pair: [1, 2], raw: [65, 0], \
                    words: [x, 'y,z'], times: [{sec: 1}]}";
        message.fill_yaml(yaml).unwrap();
        message
    }

    #[test]
    fn a_message_is_formatted_as_by_the_generated_python() {
        assert_eq!(
            message().as_message().to_python_repr(),
            r#"my_msgs.msg.All(on=True, level=b'\x07', name="a'b\x1b[31m", gains=[0.5, 1e-05], pair=array([1, 2], dtype=uint8), raw=[b'A', b'\x00'], words=['x', 'y,z'], times=[builtin_interfaces.msg.Time(sec=1, nanosec=0)])"#
        );
    }

    #[test]
    fn a_message_is_a_line_of_cells() {
        let style = YamlStyle::default();
        assert_eq!(
            message().as_message().to_csv(&style),
            "True,b'\\x07',a'b\u{1b}[31m,0.5,1e-05,1,2,b'A',b'\\x00',x,y,z,1,0"
        );
        let short = YamlStyle { truncate_length: Some(1), no_str: true, ..style };
        assert_eq!(
            message().as_message().to_csv(&short),
            r"True,b'\x07',<string length: <8>>,0.5,...,1,...,b'A',...,<string length: <1>>,...,1,0"
        );
        let bare = YamlStyle { no_arr: true, ..style };
        assert!(
            message()
                .as_message()
                .to_csv(&bare)
                .contains("<sequence type: double, length: 2>,<array type: uint8[2]>,")
        );
    }

    #[test]
    fn a_value_is_printed_as_in_python() {
        let message = message();
        let shown: Vec<_> = message
            .as_message()
            .fields_with_types()
            .map(|(_, field_type, value)| value.to_python_str(field_type))
            .collect();
        assert_eq!(shown[..4], ["True", r"b'\x07'", "a'b\u{1b}[31m", "array('d', [0.5, 1e-05])"]);
        assert_eq!(shown[4..7], ["[1 2]", r"[b'A', b'\x00']", "['x', 'y,z']"]);
    }
}
