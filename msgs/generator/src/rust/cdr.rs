//! How a message is written and read as CDR.

use super::RustSource;
use super::names::{identifier, struct_name};
use downbeat_msgs_definitions::{Element, Error, Field, MessageDefinition, Shape};

impl RustSource<'_> {
    pub(super) fn cdr_impl(&self, message: &MessageDefinition) -> Result<String, Error> {
        let name = struct_name(&message.name);
        let least = self.catalog.least_wire_size(&message.name)?;
        let mut source = format!("impl cdr::Cdr for {name} {{\n    const LEAST_SIZE: usize = {least};\n\n");
        source.push_str("    fn encode(&self, writer: &mut cdr::Writer<'_>) {\n");
        if message.fields.is_empty() {
            source.push_str("        writer.empty_message();\n");
        }
        for field in &message.fields {
            source.push_str(&format!("        writer.value(&self.{});\n", identifier(&field.name)));
        }
        source.push_str("    }\n\n    fn decode(reader: &mut cdr::Reader<'_>) -> cdr::Result<Self> {\n");
        if message.fields.is_empty() {
            source.push_str("        reader.empty_message()?;\n        Ok(Self {})\n");
        } else {
            source.push_str("        Ok(Self {\n");
            for field in &message.fields {
                source.push_str(&format!(
                    "            {}: {},\n",
                    identifier(&field.name),
                    decode_call(field)
                ));
            }
            source.push_str("        })\n");
        }
        source.push_str("    }\n}\n");
        Ok(source)
    }
}

fn decode_call(field: &Field) -> String {
    let name = &field.name;
    let text_bound = match field.field_type.element {
        Element::String { bound } | Element::WString { bound } => bound,
        _ => None,
    };
    match (field.field_type.shape, text_bound) {
        (Shape::Bounded(bound), Some(text)) => {
            format!("reader.bounded_texts_field(\"{name}\", {bound}, {text})?")
        }
        (Shape::Bounded(bound), None) => format!("reader.bounded_field(\"{name}\", {bound})?"),
        (_, Some(text)) => format!("reader.text_field(\"{name}\", {text})?"),
        (_, None) => format!("reader.field(\"{name}\")?"),
    }
}
