//! The fields of a message, as in the trait `Message`.

use super::RustSource;
use downbeat_msgs_definitions::{Element, Field, MessageDefinition, Primitive, Shape};

impl RustSource<'_> {
    /// The constant `FIELDS`.
    pub(super) fn fields_constant(&self, message: &MessageDefinition) -> String {
        if message.fields.is_empty() {
            return "    const FIELDS: &'static [description::Field] = &[];\n".into();
        }
        let mut source = String::from("    const FIELDS: &'static [description::Field] = &[\n");
        for field in &message.fields {
            let rust_type = self.field_type(&field.field_type, &message.name);
            source.push_str(&format!(
                "        description::Field::of::<{rust_type}>(\"{}\"){},\n",
                field.name,
                modifiers(field)
            ));
        }
        source.push_str("    ];\n");
        source
    }
}

/// Properties that the Rust type does not express.
#[must_use]
pub fn modifiers(field: &Field) -> String {
    let mut source = String::new();
    if let Shape::Bounded(bound) = field.field_type.shape {
        source.push_str(&format!(".bounded({bound})"));
    }
    match field.field_type.element {
        Element::String { bound: Some(bound) } | Element::WString { bound: Some(bound) } => {
            source.push_str(&format!(".bounded_text({bound})"));
        }
        Element::Primitive(Primitive::Byte) => source.push_str(".byte()"),
        _ => {}
    }
    if let Some(value) = &field.default {
        source.push_str(&format!(".with_default({:?})", value.to_python_str()));
    }
    source
}
