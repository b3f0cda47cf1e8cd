//! Writes definitions in IDL, as `rosidl_adapter` does for files.
//!
//! The types of services have no name in the language of `.msg` files that all readers of bags understand,
//! but they have one in IDL.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use super::{RULE, dependencies_backwards};
use crate::{
    Catalog, Constant, Element, Error, FieldType, Kind, MessageDefinition, Primitive, Shape, TypeName, Value,
};

impl Catalog {
    /// The definition text of a message in `ros2idl`, with its dependencies: those of the same package and
    /// kind in the first block, since the parts of a service are in one file, each of the others in a block
    /// of its own.
    ///
    /// Comments, defaults, and constants that are texts are left out.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`] for the type itself or a message it depends on.
    ///
    /// # Examples
    /// ```
    /// use downbeat_msgs_definitions::{Catalog, DefinitionEncoding, TypeName};
    ///
    /// let mut catalog = Catalog::new();
    /// catalog.add_message("legs/msg/Leg".parse()?, "float64[<=6] angles\n", "Leg.msg")?;
    /// let name: TypeName = "legs/msg/Leg".parse()?;
    /// let text = catalog.idl_definition_text(&name)?;
    /// assert!(text.contains("sequence<double, 6> angles;"));
    /// let mut again = Catalog::new();
    /// again.add_definition_text(&name, DefinitionEncoding::Ros2Idl, &text, "bag")?;
    /// assert_eq!(again.type_hash(&name)?, catalog.type_hash(&name)?);
    /// # Ok::<(), downbeat_msgs_definitions::Error>(())
    /// ```
    pub fn idl_definition_text(&self, name: &TypeName) -> Result<String, Error> {
        let root = self.message(name)?;
        let mut seen = BTreeSet::from([name.clone()]);
        let (mut together, mut apart) = (vec![root], Vec::new());
        let mut waiting = dependencies_backwards(&[root]);
        while let Some(next) = waiting.pop() {
            if seen.insert(next.clone()) {
                let message = self.message(next)?;
                let is_part =
                    name.kind != Kind::Message && (&next.package, next.kind) == (&name.package, name.kind);
                if is_part {
                    together.push(message)
                } else {
                    apart.push(message)
                }
                waiting.extend(dependencies_backwards(&[message]));
            }
        }
        // The root is last: it refers to the others.
        together.rotate_left(1);
        let mut text = String::new();
        block(&mut text, name, &together);
        for message in apart {
            text.push('\n');
            block(&mut text, &message.name, &[message]);
        }
        Ok(text)
    }
}

fn block(text: &mut String, name: &TypeName, messages: &[&MessageDefinition]) {
    // Writing to a string does not fail.
    let _ =
        write!(text, "{RULE}\nIDL: {name}\nmodule {} {{\n  module {} {{\n", name.package, name.kind.as_str());
    let mut arrays = BTreeSet::new();
    for message in messages {
        for field in &message.fields {
            if let FieldType { element, shape: Shape::Array(count) } = &field.field_type {
                arrays.insert((element_type(element), array_name(element, *count), *count));
            }
        }
    }
    for (element, name, count) in arrays {
        let _ = writeln!(text, "    typedef {element} {name}[{count}];");
    }
    for message in messages {
        constants(text, message);
        let _ = writeln!(text, "    struct {} {{", message.name.name);
        for field in &message.fields {
            let element = element_type(&field.field_type.element);
            let field_type = match field.field_type.shape {
                Shape::Single => element,
                Shape::Array(count) => array_name(&field.field_type.element, count),
                Shape::Bounded(bound) => format!("sequence<{element}, {bound}>"),
                Shape::Sequence => format!("sequence<{element}>"),
            };
            let _ = writeln!(text, "      {field_type} {};", field.name);
        }
        if message.fields.is_empty() {
            text.push_str("      uint8 structure_needs_at_least_one_member;\n");
        }
        text.push_str("    };\n");
    }
    text.push_str("  };\n};\n");
}

fn constants(text: &mut String, message: &MessageDefinition) {
    let mut written = String::new();
    for Constant { name, element, value, .. } in &message.constants {
        let value = match value {
            Value::Bool(value) => if *value { "TRUE" } else { "FALSE" }.to_owned(),
            Value::Integer(value) => value.to_string(),
            Value::Float(value) if value.is_finite() => format!("{value:?}"),
            Value::Float(_) | Value::Text(_) | Value::List(_) => continue,
        };
        let _ = writeln!(written, "      const {} {name} = {value};", element_type(element));
    }
    if !written.is_empty() {
        let _ = write!(text, "    module {}_Constants {{\n{written}    }};\n", message.name.name);
    }
}

fn element_type(element: &Element) -> String {
    match element {
        Element::Primitive(primitive) => match primitive {
            Primitive::Bool => "boolean",
            Primitive::Byte => "octet",
            Primitive::Char => "uint8",
            Primitive::Float32 => "float",
            Primitive::Float64 => "double",
            other => other.as_str(),
        }
        .to_owned(),
        Element::String { bound } => bounded("string", *bound),
        Element::WString { bound } => bounded("wstring", *bound),
        Element::Message(name) => format!("{}::{}::{}", name.package, name.kind.as_str(), name.name),
    }
}

fn bounded(text: &str, bound: Option<u64>) -> String {
    bound.map_or_else(|| text.to_owned(), |bound| format!("{text}<{bound}>"))
}

/// The name of the typedef of an array: `double__36`, `legs__msg__Leg__2`.
fn array_name(element: &Element, count: u64) -> String {
    let element: String = element_type(element)
        .replace("::", "__")
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '_' })
        .collect();
    format!("{element}__{count}")
}
