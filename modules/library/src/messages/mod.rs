//! C and C++ structs of ROS 2 interfaces, with functions that encode and decode them as CDR.
//!
//! One header per interface file, named and placed as rosidl does (`sensor_msgs/msg/joint_state.hpp`), and
//! the headers that they need. C structs are named as those of rosidl (`sensor_msgs__msg__JointState`); C++
//! structs are plain (`sensor_msgs::msg::JointState`), with `std::string`, `std::vector` and `std::array`.

mod c;
mod cpp;

use crate::{HEADER, HEADER_CPP};
use downbeat_msgs::definitions::{
    ActionDefinition, Catalog, Element, Error, Field, FieldType, Kind, MessageDefinition, Primitive,
    ServiceDefinition, Shape, TypeName, Value,
};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// The CDR functions of C.
const HEADER_CDR: &str = include_str!("../../include/downbeat_cdr.h");

/// Actions in C.
const HEADER_ACTION: &str = include_str!("../../include/downbeat_action.h");

/// A language that headers are written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Language {
    /// C11.
    C,
    /// C++17.
    Cpp,
}

/// A header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// Its path within the folder of headers, with `/`.
    pub path: String,
    /// Its text.
    pub text: String,
}

/// Writes the headers of these interfaces, of all that they refer to, and those of downbeat.
///
/// # Errors
/// If an interface, or one that it refers to, is not in the catalog.
pub fn generate(catalog: &Catalog, names: &[TypeName], language: Language) -> Result<Vec<Header>, Error> {
    let mut headers = vec![Header { path: "downbeat.h".to_owned(), text: HEADER.to_owned() }];
    match language {
        Language::C => {
            for (path, text) in [("downbeat_cdr.h", HEADER_CDR), ("downbeat_action.h", HEADER_ACTION)] {
                headers.push(Header { path: path.to_owned(), text: text.to_owned() });
            }
        }
        Language::Cpp => {
            headers.push(Header { path: "downbeat.hpp".to_owned(), text: HEADER_CPP.to_owned() })
        }
    }
    for (file, unit) in units(catalog, names)? {
        let path = format!("{}.{}", path_of(&file), extension(language));
        let text = match language {
            Language::C => c::header(catalog, &file, &unit)?,
            Language::Cpp => cpp::header(catalog, &file, &unit)?,
        };
        headers.push(Header { path, text });
    }
    Ok(headers)
}

/// What one header defines.
#[derive(Default)]
struct Unit<'a> {
    /// The definition text with all dependencies, unless every program knows the interface.
    definition: Option<String>,
    /// Each after those that it refers to.
    messages: Vec<&'a MessageDefinition>,
    services: Vec<&'a ServiceDefinition>,
    action: Option<&'a ActionDefinition>,
    /// The interface files of others that it refers to.
    includes: BTreeSet<TypeName>,
}

/// The interface file of a type, which for parts of services and actions is that of the whole.
fn file_of(name: &TypeName) -> TypeName {
    let stem = name.name.split('_').next().unwrap_or_default();
    TypeName::new(&name.package, name.kind, stem)
}

fn units<'a>(catalog: &'a Catalog, names: &[TypeName]) -> Result<BTreeMap<TypeName, Unit<'a>>, Error> {
    let mut wanted: Vec<TypeName> = names.iter().map(file_of).collect();
    let mut units = BTreeMap::new();
    while let Some(file) = wanted.pop() {
        if units.contains_key(&file) {
            continue;
        }
        let unit = unit(catalog, &file)?;
        wanted.extend(unit.includes.iter().cloned());
        units.insert(file, unit);
    }
    Ok(units)
}

fn unit<'a>(catalog: &'a Catalog, file: &TypeName) -> Result<Unit<'a>, Error> {
    // Events are for introspection, which the robot publishes itself.
    let is_here = |name: &TypeName| file_of(name) == *file && !name.name.ends_with("_Event");
    let mut unit = Unit::default();
    if file.kind == Kind::Message {
        unit.messages.push(catalog.message(file)?);
    } else {
        let mut left: Vec<_> = catalog.messages().filter(|message| is_here(&message.name)).collect();
        while !left.is_empty() {
            let names: Vec<&TypeName> = left.iter().map(|message| &message.name).collect();
            let is_ready = |message: &MessageDefinition| inner(message).all(|name| !names.contains(&name));
            let Some(next) = left.iter().position(|message| is_ready(message)) else { break };
            unit.messages.push(left.remove(next));
        }
        unit.services = catalog.services().filter(|service| is_here(&service.name)).collect();
        unit.action = catalog.action(file).ok();
        if unit.messages.is_empty() {
            // An error with the nearest name.
            catalog.message(file)?;
        }
    }
    let is_carried = downbeat_msgs::carried().type_hash(file).ok() == Some(catalog.type_hash(file)?);
    if !is_carried {
        unit.definition = Some(catalog.definition_text(file)?);
    }
    let others = unit.messages.iter().flat_map(|message| inner(message)).map(file_of);
    unit.includes = others.filter(|other| other != file).collect();
    if unit.action.is_some() {
        // What all actions share.
        unit.includes.insert(TypeName::new("action_msgs", Kind::Service, "CancelGoal"));
        unit.includes.insert(TypeName::new("action_msgs", Kind::Message, "GoalStatusArray"));
    }
    Ok(unit)
}

/// The messages in the fields of a message.
fn inner(message: &MessageDefinition) -> impl Iterator<Item = &TypeName> {
    message.fields.iter().filter_map(|field| match &field.field_type.element {
        Element::Message(name) => Some(name),
        _ => None,
    })
}

fn extension(language: Language) -> &'static str {
    match language {
        Language::C => "h",
        Language::Cpp => "hpp",
    }
}

/// `sensor_msgs/msg/joint_state`
fn path_of(file: &TypeName) -> String {
    format!("{}/{}/{}", file.package, file.kind.as_str(), snake_case(&file.name))
}

/// As rosidl: `UInt8MultiArray` is `u_int8_multi_array`, `TF2Error` is `tf2_error`.
fn snake_case(name: &str) -> String {
    let letters: Vec<char> = name.chars().collect();
    let mut snake = String::new();
    for (at, letter) in letters.iter().enumerate() {
        let follows_word = at > 0
            && letters.get(at - 1).is_some_and(|before| before.is_lowercase() || before.is_ascii_digit());
        let starts_word = at > 0 && letters.get(at + 1).is_some_and(|after| after.is_lowercase());
        if letter.is_uppercase() && (follows_word || starts_word) {
            snake.push('_');
        }
        snake.push(letter.to_ascii_lowercase());
    }
    snake
}

/// The macro that keeps a header from being read twice.
fn guard(file: &TypeName, language: Language) -> String {
    let path = path_of(file).replace('/', "__").to_ascii_uppercase();
    format!("DOWNBEAT__{path}_{}", extension(language).to_ascii_uppercase())
}

/// Keywords and macros of C and C++ that fields may be named like.
const KEYWORDS: &[&str] = &[
    "alignas",
    "alignof",
    "and",
    "and_eq",
    "asm",
    "auto",
    "bitand",
    "bitor",
    "bool",
    "break",
    "case",
    "catch",
    "char",
    "char16_t",
    "char32_t",
    "class",
    "compl",
    "const",
    "const_cast",
    "constexpr",
    "continue",
    "decltype",
    "default",
    "delete",
    "do",
    "double",
    "dynamic_cast",
    "else",
    "enum",
    "explicit",
    "export",
    "extern",
    "false",
    "float",
    "for",
    "friend",
    "goto",
    "if",
    "inline",
    "int",
    "long",
    "mutable",
    "namespace",
    "new",
    "noexcept",
    "not",
    "not_eq",
    "nullptr",
    "operator",
    "or",
    "or_eq",
    "private",
    "protected",
    "public",
    "register",
    "reinterpret_cast",
    "restrict",
    "return",
    "short",
    "signed",
    "sizeof",
    "static",
    "static_assert",
    "static_cast",
    "struct",
    "switch",
    "template",
    "this",
    "thread_local",
    "throw",
    "true",
    "try",
    "typedef",
    "typeid",
    "typename",
    "union",
    "unsigned",
    "using",
    "virtual",
    "void",
    "volatile",
    "wchar_t",
    "while",
    "xor",
    "xor_eq",
    "errno",
    "linux",
    "unix",
    "stdin",
    "stdout",
    "stderr",
];

/// The name of a field.
fn field_name(field: &Field) -> String {
    match KEYWORDS.contains(&field.name.as_str()) {
        true => format!("{}_", field.name),
        false => field.name.clone(),
    }
}

/// The suffix of the type in `stdint.h`, and `float32` and `float64`.
fn primitive_name(primitive: Primitive) -> &'static str {
    match primitive {
        Primitive::Byte | Primitive::Char => "uint8",
        other => other.as_str(),
    }
}

fn primitive_type(primitive: Primitive) -> &'static str {
    match primitive {
        Primitive::Bool => "bool",
        Primitive::Byte | Primitive::Char | Primitive::UInt8 => "uint8_t",
        Primitive::Int8 => "int8_t",
        Primitive::UInt16 => "uint16_t",
        Primitive::Int16 => "int16_t",
        Primitive::UInt32 => "uint32_t",
        Primitive::Int32 => "int32_t",
        Primitive::UInt64 => "uint64_t",
        Primitive::Int64 => "int64_t",
        Primitive::Float32 => "float",
        Primitive::Float64 => "double",
    }
}

/// A value as a literal, of texts those of UTF-8.
fn literal(value: &Value, element: &Element) -> String {
    match (value, element) {
        (Value::Bool(value), _) => value.to_string(),
        (Value::Integer(value), Element::Primitive(Primitive::Int64)) if *value == i128::from(i64::MIN) => {
            "(-INT64_C(9223372036854775807) - 1)".to_owned()
        }
        (Value::Integer(value), Element::Primitive(Primitive::Int64)) => format!("INT64_C({value})"),
        (Value::Integer(value), Element::Primitive(Primitive::UInt64)) => format!("UINT64_C({value})"),
        (Value::Integer(value), Element::Primitive(Primitive::UInt32)) => format!("{value}u"),
        (Value::Integer(value), Element::Primitive(Primitive::Int32)) if *value == i128::from(i32::MIN) => {
            "(-2147483647 - 1)".to_owned()
        }
        (Value::Integer(value), _) => value.to_string(),
        (Value::Float(value), _) if value.is_nan() => "NAN".to_owned(),
        (Value::Float(value), _) if value.is_infinite() => {
            if *value > 0.0 { "INFINITY" } else { "(-INFINITY)" }.to_owned()
        }
        (Value::Float(value), Element::Primitive(Primitive::Float32)) => format!("{:?}f", *value as f32),
        (Value::Float(value), _) => format!("{value:?}"),
        (Value::Text(text), Element::WString { .. }) => format!("u{}", text_literal(text, true)),
        (Value::Text(text), _) => text_literal(text, false),
        (Value::List(_), _) => String::new(),
    }
}

/// A string literal. Bytes that are not plain ASCII are octal escapes, which end after three digits; in wide
/// literals, letters are themselves.
fn text_literal(text: &str, is_wide: bool) -> String {
    let mut literal = String::from("\"");
    let plain =
        |letter: char| letter.is_ascii_graphic() && !matches!(letter, '"' | '\\' | '?') || letter == ' ';
    for letter in text.chars() {
        if plain(letter) || (is_wide && !letter.is_ascii()) {
            literal.push(letter);
        } else {
            let mut bytes = [0; 4];
            for byte in letter.encode_utf8(&mut bytes).bytes() {
                let _ = write!(literal, "\\{byte:03o}");
            }
        }
    }
    literal + "\""
}

/// The definition text as literals in a list that ends with a null pointer: a part for each line, since
/// compilers limit the length of literals.
fn definition_parts(text: &str, null: &str) -> String {
    let lines = text.split_inclusive('\n').map(|line| format!("        {},\n", text_literal(line, false)));
    lines.collect::<String>() + &format!("        {null}")
}

/// The lines of a comment, each after `//`.
fn comment(lines: &[String], indentation: &str) -> String {
    let text = lines.iter().skip_while(|line| line.is_empty());
    let mut text: Vec<&String> = text.collect();
    while text.last().is_some_and(|line| line.is_empty()) {
        text.pop();
    }
    // A backslash at the end would continue the comment.
    let line = |line: &&String| format!("{indentation}// {}", line.trim_end().trim_end_matches('\\'));
    text.iter().map(|text| line(text).trim_end().to_owned() + "\n").collect()
}

/// The bound of a string, and of a sequence.
fn bounds(of: &FieldType) -> (Option<u64>, Option<u64>) {
    let text = match of.element {
        Element::String { bound } | Element::WString { bound } => bound,
        _ => None,
    };
    let sequence = match of.shape {
        Shape::Bounded(bound) => Some(bound),
        _ => None,
    };
    (text, sequence)
}

const PREFACE: &str = "// Written by `downbeat interface generate` from the definition of";

#[cfg(test)]
mod tests {
    use super::snake_case;

    #[test]
    fn headers_are_named_as_by_rosidl() {
        for (name, snake) in [
            ("JointState", "joint_state"),
            ("PointCloud2", "point_cloud2"),
            ("UInt8MultiArray", "u_int8_multi_array"),
            ("TF2Error", "tf2_error"),
            ("TFMessage", "tf_message"),
            ("Float64", "float64"),
        ] {
            assert_eq!(snake_case(name), snake);
        }
    }
}
