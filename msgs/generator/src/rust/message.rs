//! The struct of a message and its implementations.

use super::names::{identifier, primitive, struct_name};
use super::values::{constant, expression, is_zero, text_literal, zero};
use super::{RustSource, docs};
use downbeat_msgs_definitions::{Element, Error, FieldType, MessageDefinition, Primitive, Shape};

/// The longest array for which the standard library and serde implement their traits.
const LONGEST_PLAIN_ARRAY: u64 = 32;

impl RustSource<'_> {
    pub(super) fn message(&self, message: &MessageDefinition) -> Result<String, Error> {
        let mut source = self.structure(message)?;
        if !message.constants.is_empty() {
            source.push('\n');
            source.push_str(&constants(message));
        }
        if !has_derivable_default(message) {
            source.push('\n');
            source.push_str(&self.default_impl(message));
        }
        source.push('\n');
        source.push_str(&self.cdr_impl(message)?);
        source.push('\n');
        source.push_str(&self.message_impl(message)?);
        Ok(source)
    }

    fn structure(&self, message: &MessageDefinition) -> Result<String, Error> {
        let mut derives = vec!["Clone", "Debug", "PartialEq"];
        if has_derivable_default(message) {
            derives.insert(2, "Default");
        }
        if self.every_element(message, &|element, shape| {
            !matches!(element, Element::String { .. } | Element::WString { .. })
                && matches!(shape, Shape::Single | Shape::Array(_))
        })? {
            derives.insert(1, "Copy");
        }
        if self.every_element(message, &|element, _| {
            !matches!(element, Element::Primitive(Primitive::Float32 | Primitive::Float64))
        })? {
            derives.extend(["Eq", "Hash"]);
        }
        let crate_attribute = match self.modules.runtime.as_str() {
            "crate" => String::new(),
            runtime => format!("crate = \"{runtime}::serde\", "),
        };
        let name = struct_name(&message.name);
        let mut source = docs::doc(&message.comment, &message.name.to_string(), "");
        derives.extend(["serde::Serialize", "serde::Deserialize"]);
        source.push_str(&derive_attribute(&derives.join(", ")));
        source.push_str(&format!("#[serde({crate_attribute}default)]\n"));
        if message.fields.is_empty() {
            source.push_str(&format!("pub struct {name} {{}}\n"));
            return Ok(source);
        }
        source.push_str(&format!("pub struct {name} {{\n"));
        for field in &message.fields {
            source.push_str(&docs::doc(&field.comment, &field.field_type.to_string(), "    "));
            if is_byte_list(&field.field_type) {
                let array = if matches!(field.field_type.shape, Shape::Array(_)) { "::array" } else { "" };
                let runtime = &self.modules.runtime;
                source.push_str(&format!("    #[serde(with = \"{runtime}::byte_list{array}\")]\n"));
            } else if matches!(field.field_type.shape, Shape::Array(count) if count > LONGEST_PLAIN_ARRAY) {
                source.push_str(&format!("    #[serde(with = \"{}::large_array\")]\n", self.modules.runtime));
            }
            let rust_name = identifier(&field.name);
            if rust_name.ends_with('_') {
                source.push_str(&format!("    #[serde(rename = \"{}\")]\n", field.name));
            }
            source.push_str(&format!(
                "    pub {rust_name}: {},\n",
                self.field_type(&field.field_type, &message.name)
            ));
        }
        source.push_str("}\n");
        Ok(source)
    }

    fn default_impl(&self, message: &MessageDefinition) -> String {
        let default = self.prelude("Default", "::std::default::Default", &message.name);
        let mut source = format!("impl {default} for {} {{\n", struct_name(&message.name));
        source.push_str("    fn default() -> Self {\n        Self {\n");
        for field in &message.fields {
            let value = match &field.default {
                Some(value) => expression(value, &field.field_type, &self.modules.runtime),
                None => default_expression(&field.field_type, &default),
            };
            source.push_str(&format!("            {}: {value},\n", identifier(&field.name)));
        }
        source.push_str("        }\n    }\n}\n");
        source
    }

    fn message_impl(&self, message: &MessageDefinition) -> Result<String, Error> {
        let name = struct_name(&message.name);
        let mut source = format!("impl {}::Message for {name} {{\n", self.modules.runtime);
        source.push_str(&format!("    const TYPE_NAME: &'static str = \"{}\";\n", message.name));
        source.push_str(&docs::hash_line(&self.catalog.type_hash(&message.name)?));
        let definition = self.catalog.definition_text(&message.name)?;
        source.push_str(&format!("    const DEFINITION: &'static str = {};\n", text_literal(&definition)));
        source.push_str(&self.fields_constant(message));
        source.push_str("}\n");
        Ok(source)
    }

    /// Returns whether a predicate holds for every element of the message, including those of nested
    /// messages.
    pub(super) fn every_element(
        &self,
        message: &MessageDefinition,
        holds: &dyn Fn(&Element, Shape) -> bool,
    ) -> Result<bool, Error> {
        for field in &message.fields {
            let FieldType { element, shape } = &field.field_type;
            if !holds(element, *shape) {
                return Ok(false);
            }
            if let Element::Message(name) = element
                && !self.every_element(self.catalog.message(name)?, holds)?
            {
                return Ok(false);
            }
        }
        Ok(true)
    }
}

/// On one line if it fits, within two modules.
fn derive_attribute(derives: &str) -> String {
    const LONGEST: usize = 100 - 8 - "#[derive()]".len();
    if derives.len() > LONGEST {
        format!("#[derive(\n    {derives},\n)]\n")
    } else {
        format!("#[derive({derives})]\n")
    }
}

fn has_derivable_default(message: &MessageDefinition) -> bool {
    message.fields.iter().all(|field| {
        field.default.as_ref().is_none_or(is_zero)
            && !matches!(field.field_type.shape, Shape::Array(count) if count > LONGEST_PLAIN_ARRAY)
    })
}

fn is_byte_list(field_type: &FieldType) -> bool {
    matches!(field_type.element, Element::Primitive(Primitive::Byte | Primitive::Char | Primitive::UInt8))
        && field_type.shape != Shape::Single
}

fn constants(message: &MessageDefinition) -> String {
    let mut source = format!("impl {} {{\n", struct_name(&message.name));
    for item in &message.constants {
        let (ros_type, rust_type) = match &item.element {
            Element::Primitive(of) => (of.as_str(), primitive(*of)),
            Element::WString { .. } => ("wstring", "&'static str"),
            _ => ("string", "&'static str"),
        };
        source.push_str(&docs::doc(&item.comment, ros_type, "    "));
        let value = constant(&item.value, &item.element);
        source.push_str(&format!("    pub const {}: {rust_type} = {value};\n", item.name));
    }
    source.push_str("}\n");
    source
}

fn default_expression(field_type: &FieldType, default: &str) -> String {
    match (&field_type.element, field_type.shape) {
        (Element::Primitive(primitive), Shape::Single) => zero(*primitive).into(),
        (Element::Primitive(primitive), Shape::Array(count)) => format!("[{}; {count}]", zero(*primitive)),
        (_, Shape::Array(count)) if count > LONGEST_PLAIN_ARRAY => {
            format!("::std::array::from_fn(|_| {default}::default())")
        }
        _ => format!("{default}::default()"),
    }
}
