//! Generates code that writes and reads messages as CDR.

use super::RustSource;
use super::layout::{Part, plain_layout};
use super::names::{identifier, struct_name};
use downbeat_msgs_definitions::{Element, Error, Field, MessageDefinition, Shape};

impl RustSource<'_> {
    pub(super) fn cdr_impl(&self, message: &MessageDefinition) -> Result<String, Error> {
        let mut source = match plain_layout(self.catalog, message)? {
            Some(layout) => plain_impl(message, &layout),
            None => self.general_impl(message)?,
        };
        let name = struct_name(&message.name);
        let view = if self.is_borrowing(message)? { format!("view::{name}<'a>") } else { "Self".into() };
        source.push_str(&format!("\nimpl cdr::Viewed for {name} {{\n    type View<'a> = {view};\n}}\n"));
        Ok(source)
    }

    fn general_impl(&self, message: &MessageDefinition) -> Result<String, Error> {
        let name = struct_name(&message.name);
        let least = self.catalog.least_wire_size(&message.name)?;
        let mut source = format!("impl cdr::Cdr for {name} {{\n    const LEAST_SIZE: usize = {least};\n\n");
        source.push_str("    #[inline]\n    fn end(&self, position: usize) -> usize {\n");
        for field in &message.fields {
            source.push_str(&format!(
                "        let position = self.{}.end(position);\n",
                identifier(&field.name)
            ));
        }
        source.push_str("        position\n    }\n\n    #[inline]\n    fn encode(&self, writer: &mut cdr::Writer<'_>) {\n");
        for field in &message.fields {
            source.push_str(&format!("        writer.value(&self.{});\n", identifier(&field.name)));
        }
        source.push_str(
            "    }\n\n    #[inline]\n    fn decode(reader: &mut cdr::Reader<'_>) -> cdr::Result<Self> {\n",
        );
        source.push_str("        reader.message(|reader| {\n            Ok(Self {\n");
        for field in &message.fields {
            source.push_str(&field_line("                ", field, &decode_call(field)));
        }
        source.push_str("            })\n        })\n    }\n");
        source.push_str(&self.check_bounds(message)?);
        source.push_str("}\n");
        Ok(source)
    }

    /// The method that checks bounds before writing, if there are any.
    fn check_bounds(&self, message: &MessageDefinition) -> Result<String, Error> {
        let mut checks = Vec::new();
        for field in &message.fields {
            let (name, value) = (&field.name, identifier(&field.name));
            if let Shape::Bounded(bound) = field.field_type.shape {
                checks.push(format!("cdr::check_count(\"{name}\", &self.{value}, {bound})"));
            }
            match &field.field_type.element {
                Element::String { bound: Some(bound) } | Element::WString { bound: Some(bound) } => {
                    checks.push(format!("cdr::check_text(\"{name}\", &self.{value}, {bound})"));
                }
                Element::Message(of) if self.has_bounds(self.catalog.message(of)?)? => {
                    checks.push(format!("cdr::check_field(\"{name}\", &self.{value})"));
                }
                _ => {}
            }
        }
        let Some(last) = checks.pop() else { return Ok(String::new()) };
        let mut source =
            "\n    #[inline]\n    fn check_bounds(&self) -> ::std::result::Result<(), cdr::EncodeError> {\n"
                .to_owned();
        for check in checks {
            source.push_str(&format!("        {check}?;\n"));
        }
        source.push_str(&format!("        {last}\n    }}\n"));
        Ok(source)
    }

    fn has_bounds(&self, message: &MessageDefinition) -> Result<bool, Error> {
        let has_none = self.every_element(message, &|element, shape| {
            !matches!(shape, Shape::Bounded(_))
                && !matches!(
                    element,
                    Element::String { bound: Some(_) } | Element::WString { bound: Some(_) }
                )
        })?;
        Ok(!has_none)
    }
}

/// The code that reads a field: the owned value or its view.
#[must_use]
pub fn decode_call(field: &Field) -> String {
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

pub(super) fn field_line(indentation: &str, field: &Field, value: &str) -> String {
    format!("{indentation}{}: {value},\n", identifier(&field.name))
}

/// A message with a fixed layout only implements `Plain`.
fn plain_impl(message: &MessageDefinition, layout: &super::layout::Layout) -> String {
    let name = struct_name(&message.name);
    let mut source = format!(
        "impl cdr::Plain for {name} {{\n    const ALIGNMENT: usize = {};\n    const SIZE: usize = {};\n\n",
        layout.alignment, layout.size
    );
    source.push_str("    #[inline]\n");
    source.push_str("    fn put(&self, run: &mut cdr::PlainWriter<'_>) {\n");
    for part in &layout.parts {
        source.push_str(&match part {
            Part::Padding(count) => format!("        run.skip({count});\n"),
            Part::Field(field) => format!("        run.put(&self.{});\n", identifier(&field.name)),
        });
    }
    source.push_str("    }\n\n    #[inline]\n    fn get(run: &mut cdr::PlainReader<'_>) -> Self {\n");
    let mut fields = String::new();
    let mut padding = String::new();
    for part in &layout.parts {
        match part {
            Part::Padding(count) => padding = format!("run.skip({count});"),
            Part::Field(field) if padding.is_empty() => {
                fields.push_str(&field_line("            ", field, "run.get()"));
            }
            Part::Field(field) => {
                let value = format!("{{ {} run.get() }}", std::mem::take(&mut padding));
                fields.push_str(&field_line("            ", field, &value));
            }
        }
    }
    let trailing = if padding.is_empty() { padding } else { format!("        {padding}\n") };
    source.push_str(&format!("{trailing}        Self {{\n{fields}        }}\n    }}\n}}\n\n"));
    source.push_str(&format!("impl cdr::PlainMessage for {name} {{\n"));
    source.push_str(
        "    #[inline]\n    fn decode_fields(reader: &mut cdr::Reader<'_>) -> cdr::Result<Self> {\n",
    );
    if message.fields.is_empty() {
        source.push_str("        reader.empty_message()?;\n");
    }
    source.push_str("        Ok(Self {\n");
    for field in &message.fields {
        source.push_str(&field_line("            ", field, &decode_call(field)));
    }
    source.push_str("        })\n    }\n}\n");
    source
}
