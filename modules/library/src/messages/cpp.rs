//! C++17.

use super::{
    Language, PREFACE, Unit, bounds, comment, definition_parts, field_name, guard, literal, path_of,
    primitive_type,
};
use downbeat_msgs::definitions::{
    Catalog, Element, Error, Field, FieldType, MessageDefinition, Shape, TypeName, Value,
};
use std::fmt::Write;

pub(super) fn header(catalog: &Catalog, file: &TypeName, unit: &Unit<'_>) -> Result<String, Error> {
    let guard = guard(file, Language::Cpp);
    let mut text = format!(
        "{PREFACE} {file}.\n#ifndef {guard}\n#define {guard}\n\n#include <array>\n#include <cmath>\n#include <cstdint>\n\
         #include <string>\n#include <vector>\n\n#include \"downbeat.hpp\"\n"
    );
    for include in &unit.includes {
        let _ = writeln!(text, "#include \"{}.hpp\"", path_of(include));
    }
    let _ = writeln!(text, "\nnamespace {}::{} {{", file.package, file.kind.as_str());
    for message in &unit.messages {
        text.push('\n');
        structure(&mut text, message);
    }
    for service in &unit.services {
        let (name, request, response) = (&service.name.name, &service.request.name, &service.response.name);
        let _ = write!(
            text,
            "\n// {}\nstruct {name} {{\n    using Request = {};\n    using Response = {};\n}};\n",
            service.name, request.name, response.name
        );
    }
    if let Some(action) = unit.action {
        let name = &action.name.name;
        let _ = write!(text, "\n// {}\nstruct {name} {{\n", action.name);
        for part in ["Goal", "Result", "Feedback", "FeedbackMessage", "SendGoal", "GetResult"] {
            let _ = writeln!(text, "    using {part} = {name}_{part};");
        }
        text.push_str(
            "    using CancelGoal = ::action_msgs::srv::CancelGoal;\n    using GoalStatusArray = ::action_msgs::msg::GoalStatusArray;\n};\n",
        );
    }
    let _ =
        writeln!(text, "\n}} // namespace {}::{}\n\nnamespace downbeat {{", file.package, file.kind.as_str());
    let carried = match &unit.definition {
        Some(definition) => {
            let _ = write!(
                text,
                "\n// The definition, which a robot may not know.\nstruct {0} {{\n    static constexpr const char *whole = \"{file}\";\n    static const char *const *definition() {{\n        static const char *const text[] = {{\n{1}}};\n        return text;\n    }}\n}};\n",
                definition_of(file),
                definition_parts(definition, "nullptr")
            );
            format!(" : {}", definition_of(file))
        }
        None => String::new(),
    };
    for message in &unit.messages {
        text.push('\n');
        interface(&mut text, message, &catalog.type_hash(&message.name)?, &carried);
    }
    for service in &unit.services {
        let hash = catalog.type_hash(&service.name)?;
        let _ = write!(
            text,
            "\ntemplate <> struct Interface<{}>{carried} {{\n    static constexpr const char *name = \"{}\";\n    static constexpr const char *hash = \"{hash}\";\n}};\n",
            qualified(&service.name),
            service.name,
        );
    }
    let _ = write!(text, "\n}} // namespace downbeat\n\n#endif\n");
    Ok(text)
}

fn qualified(name: &TypeName) -> String {
    format!("::{}::{}::{}", name.package, name.kind.as_str(), name.name)
}

/// The name of the struct in `downbeat` that has the definition.
fn definition_of(file: &TypeName) -> String {
    format!("DefinitionOf_{}", path_of(file).replace('/', "_"))
}

fn structure(text: &mut String, message: &MessageDefinition) {
    text.push_str(&comment(&message.comment, ""));
    let _ = write!(text, "// {}\nstruct {} {{\n", message.name, message.name.name);
    for constant in &message.constants {
        text.push_str(&comment(&constant.comment, "    "));
        let of = match &constant.element {
            Element::Primitive(primitive) => format!("{} ", std_type(primitive_type(*primitive))),
            Element::WString { .. } => "const char16_t *".to_owned(),
            _ => "const char *".to_owned(),
        };
        let value = literal(&constant.value, &constant.element);
        let _ = writeln!(text, "    static constexpr {of}{} = {value};", constant.name);
    }
    for field in &message.fields {
        text.push_str(&comment(&field.comment, "    "));
        let initial = initial(field);
        let _ = writeln!(text, "    {} {}{initial};", field_type(&field.field_type), field_name(field));
    }
    text.push_str("};\n");
}

fn std_type(name: &str) -> String {
    if name.ends_with("_t") { format!("::std::{name}") } else { name.to_owned() }
}

fn element_type(element: &Element) -> String {
    match element {
        Element::Primitive(primitive) => std_type(primitive_type(*primitive)),
        Element::String { .. } => "::std::string".to_owned(),
        Element::WString { .. } => "::std::u16string".to_owned(),
        Element::Message(name) => qualified(name),
    }
}

fn field_type(of: &FieldType) -> String {
    let element = element_type(&of.element);
    match of.shape {
        Shape::Single => element,
        Shape::Array(count) => format!("::std::array<{element}, {count}>"),
        Shape::Bounded(_) | Shape::Sequence => format!("::std::vector<{element}>"),
    }
}

fn initial(field: &Field) -> String {
    let of = &field.field_type;
    match (&field.default, of.shape) {
        (Some(Value::List(values)), _) => {
            let values: Vec<String> = values.iter().map(|value| literal(value, &of.element)).collect();
            format!(" = {{{}}}", values.join(", "))
        }
        (Some(value), _) => format!(" = {}", literal(value, &of.element)),
        (None, Shape::Single | Shape::Array(_)) => "{}".to_owned(),
        (None, _) => String::new(),
    }
}

fn interface(text: &mut String, message: &MessageDefinition, hash: &str, carried: &str) {
    let (name, of) = (&message.name, qualified(&message.name));
    let _ = write!(
        text,
        "template <> struct Interface<{of}>{carried} {{\n    static constexpr const char *name = \"{name}\";\n    static constexpr const char *hash = \"{hash}\";\n"
    );
    let checks = message.fields.iter().map(checks).collect::<String>();
    let unused = if message.fields.is_empty() { "" } else { "message" };
    let _ = writeln!(text, "    static void encode(cdr::Writer &writer, const {of} &{unused}) {{");
    text.push_str(&checks);
    if message.fields.is_empty() {
        text.push_str("        writer.put(std::uint8_t(0));\n");
    }
    for field in &message.fields {
        let _ = writeln!(text, "        writer.put(message.{});", field_name(field));
    }
    let _ = writeln!(text, "    }}\n    static void decode(cdr::Reader &reader, {of} &{unused}) {{");
    if message.fields.is_empty() {
        text.push_str("        std::uint8_t nothing = 0;\n        reader.get(nothing);\n");
    }
    for field in &message.fields {
        let _ = writeln!(text, "        reader.get(message.{});", field_name(field));
    }
    text.push_str(&checks);
    text.push_str("    }\n};\n");
}

/// The lines that check the bounds of a field.
fn checks(field: &Field) -> String {
    let (name, (of_text, of_sequence)) = (field_name(field), bounds(&field.field_type));
    let mut lines = String::new();
    if let Some(bound) = of_sequence {
        let _ = writeln!(
            lines,
            "        cdr::Writer::check(\"{}\", message.{name}.size(), {bound});",
            field.name
        );
    }
    match (of_text, field.field_type.shape) {
        (Some(bound), Shape::Single) => {
            let _ = writeln!(
                lines,
                "        cdr::Writer::check(\"{}\", message.{name}.size(), {bound});",
                field.name
            );
        }
        (Some(bound), _) => {
            let _ = write!(
                lines,
                "        for (const auto &text : message.{name}) {{\n            cdr::Writer::check(\"{}\", text.size(), {bound});\n        }}\n",
                field.name
            );
        }
        (None, _) => {}
    }
    lines
}
