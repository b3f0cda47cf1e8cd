//! Views: messages whose strings and sequences borrow from the input.

use super::cdr::{decode_call, field_line};
use super::names::{identifier, primitive, struct_name};
use super::{RustSource, docs, indent};
use downbeat_msgs_definitions::{Element, Error, Field, MessageDefinition, Primitive, Shape, TypeName};

impl RustSource<'_> {
    /// The module with the views of messages of one kind and package.
    pub(super) fn views(&self, messages: &[&MessageDefinition]) -> Result<String, Error> {
        let mut source = String::from(
            "/// Views of the messages that contain strings or sequences: they borrow from the input.\n\
             pub mod view {\n",
        );
        source.push_str(&format!("    use {}::cdr;\n", self.modules.runtime));
        let mut is_empty = true;
        for message in messages {
            if let Some(view) = self.view(message)? {
                source.push_str(&indent(&view));
                is_empty = false;
            }
        }
        source.push_str("}\n");
        Ok(if is_empty { String::new() } else { source })
    }

    /// The view of a message; `None` if it has nothing to borrow.
    fn view(&self, message: &MessageDefinition) -> Result<Option<String>, Error> {
        if !self.is_borrowing(message)? {
            return Ok(None);
        }
        let name = struct_name(&message.name);
        let least = self.catalog.least_wire_size(&message.name)?;
        let mut source = docs::doc(&[], &message.name.to_string(), "");
        source.push_str(&format!("#[derive(Clone, Debug)]\npub struct {name}<'a> {{\n"));
        for field in &message.fields {
            source.push_str(&docs::doc(&[], &field.field_type.to_string(), "    "));
            source.push_str(&format!(
                "    pub {}: {},\n",
                identifier(&field.name),
                self.view_type(field, &message.name)?
            ));
        }
        source.push_str(&format!(
            "}}\n\nimpl<'a> cdr::FromReader<'a> for {name}<'a> {{\n    const FEWEST_BYTES: usize = {least};\n\n    \
             #[inline]\n    fn from_reader(reader: &mut cdr::Reader<'a>) -> cdr::Result<Self> {{\n        \
             reader.message(|reader| {{\n            Ok(Self {{\n"
        ));
        for field in &message.fields {
            let value = match field.field_type.shape {
                Shape::Array(count) if self.borrows(&field.field_type.element)? => array_call(field, count),
                _ => decode_call(field),
            };
            source.push_str(&field_line("                ", field, &value));
        }
        source.push_str("            })\n        })\n    }\n}\n");
        Ok(Some(source))
    }

    fn view_type(&self, field: &Field, owner: &TypeName) -> Result<String, Error> {
        let element = match &field.field_type.element {
            Element::Primitive(of) => primitive(*of).to_owned(),
            Element::String { .. } => "&'a str".into(),
            Element::WString { .. } => format!("{}::WString", self.modules.runtime),
            Element::Message(name) if self.is_borrowing(self.catalog.message(name)?)? => {
                format!("{}<'a>", self.view_path(name, owner))
            }
            Element::Message(name) => self.owned_path(name, owner),
        };
        Ok(match (field.field_type.shape, &field.field_type.element) {
            (Shape::Single, _) => element,
            (Shape::Array(_), of) if self.borrows(of)? => format!("cdr::Sequence<'a, {element}>"),
            (Shape::Array(count), _) => format!("[{element}; {count}]"),
            (_, Element::Primitive(Primitive::Bool)) => format!("cdr::Sequence<'a, {element}>"),
            (_, Element::Primitive(of)) if primitive(*of) == "u8" => "&'a [u8]".into(),
            (_, Element::Primitive(_)) => format!("cdr::Numbers<'a, {element}>"),
            _ => format!("cdr::Sequence<'a, {element}>"),
        })
    }

    /// Returns whether a message contains a string or sequence, directly or in a nested message. A single
    /// `wstring` is decoded, and borrows nothing.
    pub(super) fn is_borrowing(&self, message: &MessageDefinition) -> Result<bool, Error> {
        let has_none = self.every_element(message, &|element, shape| match element {
            Element::Primitive(_) | Element::Message(_) => matches!(shape, Shape::Single | Shape::Array(_)),
            Element::WString { .. } => matches!(shape, Shape::Single),
            Element::String { .. } => false,
        })?;
        Ok(!has_none)
    }

    fn borrows(&self, element: &Element) -> Result<bool, Error> {
        match element {
            Element::Primitive(_) => Ok(false),
            Element::String { .. } | Element::WString { .. } => Ok(true),
            Element::Message(name) => self.is_borrowing(self.catalog.message(name)?),
        }
    }

    fn view_path(&self, name: &TypeName, owner: &TypeName) -> String {
        let (kind, view) = (name.kind.as_str(), struct_name(name));
        if name.package == owner.package && name.kind == owner.kind {
            view
        } else if name.package == owner.package {
            format!("super::super::{kind}::view::{view}")
        } else {
            let module = from_view(self.modules.of(&name.package).into());
            format!("{module}::{}::{kind}::view::{view}", identifier(&name.package))
        }
    }

    /// The path of an owned message from the module of views.
    fn owned_path(&self, name: &TypeName, owner: &TypeName) -> String {
        let path = self.type_path(name, owner);
        if name.package == owner.package { format!("super::{path}") } else { from_view(path) }
    }
}

/// Converts a path relative to the module of the messages into one from its submodule of views.
fn from_view(path: String) -> String {
    if path.starts_with("super::") { format!("super::{path}") } else { path }
}

fn array_call(field: &Field, count: u64) -> String {
    let name = &field.name;
    match field.field_type.element {
        Element::String { bound: Some(bound) } | Element::WString { bound: Some(bound) } => {
            format!("reader.texts_array_field(\"{name}\", {count}, {bound})?")
        }
        _ => format!("reader.array_field(\"{name}\", {count})?"),
    }
}
